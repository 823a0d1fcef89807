"""Rows are added where the loss or what has appeared asks for them, and removed where they show nothing."""

import math

import numpy as np
import pytest
import torch

from airgs_codec.render import cpu
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.trainer.fit.active import Resting, find_active
from airgs_codec.trainer.fit.grow import (
    Densifier,
    Growth,
    find_wrong,
    is_visible,
    residual_seeds,
    split_or_clone,
    strongest,
)
from airgs_codec.trainer.fit.losses import photometric
from airgs_codec.trainer.fit.parameters import render
from tests.faces import from_gaussians
from tests.support.views import BALL, appeared, coloured_cloud, joined, moved, random_parameters, ring, views_of


def test_growth_ends_at_the_budget_and_never_passes_it():
    growth = Growth(budget=1000, start=0.1, stop=0.6, every=10)
    counts = [growth.target(300, done) for done in np.linspace(0, 1, 101)]
    assert counts[0] == 300 and counts[-1] == 1000
    assert counts == sorted(counts)
    assert growth.target(1200, 0.5) == 1200
    assert not growth.due(20, 1000) and growth.due(300, 1000) and not growth.due(305, 1000)
    assert not growth.due(700, 1000)


def test_growing_adds_what_was_asked_and_leaves_kept_rows_in_place():
    p = random_parameters(50)
    parents = strongest(torch.linspace(0, 1, 50), 20)
    keep, added = split_or_clone(p, parents, parents, fixed=40, rng=np.random.default_rng(0))
    assert keep[:40].all() and not keep[40:].any()  # splits of kept rows leave the parent
    assert int(keep.sum()) + len(added["means"]) == 70
    sizes = p["log_scales"][-1]
    assert torch.allclose(added["log_scales"][-1], sizes - math.log(1.6))
    spread = (added["means"][-1] - p["means"][-1]).norm()
    assert 0 < spread < 6 * p["log_scales"][-1].max().exp()


def test_rows_without_a_gradient_are_never_parents():
    assert not strongest(torch.zeros(9), 5).any()
    assert strongest(torch.tensor([0.0, 2.0, 1.0]), 5).tolist() == [False, True, True]
    assert not strongest(torch.ones(3), -4).any()  # above the target already


def test_nothing_is_added_before_a_gradient_was_seen():
    densifier = Densifier(Growth(20), 9, np.random.default_rng(0))
    keep, added = densifier.grow(random_parameters(9), extent=1.0, fixed=0, done=0.5)
    assert added is None and keep.all()


def test_what_is_faint_goes_but_for_kept_rows():
    p = random_parameters(6)
    p["opacity_logits"] = torch.tensor([-9.0, 3.0, -9.0, 3.0, -9.0, 3.0])
    assert is_visible(p, fixed=3).tolist() == [True, True, True, True, False, True]


def test_absolute_gradients_are_largest_where_the_picture_is_wrong():
    g = coloured_cloud()
    views = views_of(moved(g, slice(0, 1), (0.0, 0.0, 0.3)), ring(4))
    total = torch.zeros(len(g))
    for view in views:
        absgrad = AbsGrad()
        p = {n: t.requires_grad_() for n, t in from_gaussians(g).items()}
        photometric(render(p, view.camera, 0, absgrad)[0], view.target).backward()
        gradients, seen = absgrad.read()
        assert (gradients[~seen] == 0).all()
        total += gradients
    near = np.linalg.norm(g.means - g.means[0], axis=1) < 0.5
    assert near[int(total.argmax())]


def test_absolute_gradients_cannot_be_read_before_the_backward_pass():
    with pytest.raises(RuntimeError, match="backward"):
        AbsGrad().read()


def test_seeds_lie_in_what_appeared():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))
    seeds = residual_seeds(old, views, find_wrong(old, views), 120, 1.0, np.random.default_rng(0))
    assert 0 < len(seeds) <= 120
    # The ball can be seen to 0.45 from its centre (0.24 + 3 sigma of 0.07), and a pixel is 0.1 wide there.
    assert np.linalg.norm(seeds.means - BALL, axis=1).max() < 0.6
    few = views_of(joined(old, appeared()), ring(3))
    for most in (1, 120):
        seeds = residual_seeds(old, few, find_wrong(old, few), most, 1.0, np.random.default_rng(0))
        assert seeds is None or 0 < len(seeds) <= most
    same = views_of(old, ring(8))
    assert residual_seeds(old, same, find_wrong(old, same), 120, 1.0, np.random.default_rng(0)) is None


def case():
    g = coloured_cloud(300)
    order = np.argsort(np.linalg.norm(g.means - g.means[0], axis=1))
    g = type(g)(*(getattr(g, n)[order] for n in g.__slots__))
    after = moved(g, slice(0, 20), (0.05, 0.0, 0.0))
    cameras = ring(8, size=96)
    masks = [np.abs(cpu.render(g, c).rgb - cpu.render(after, c).rgb).max(axis=2) > 0.01 for c in cameras]
    return g, views_of(after, cameras), masks


def test_active_rows_are_those_that_make_what_moves():
    active = find_active(*case())
    assert np.isin(np.arange(20), active.rows).mean() > 0.9
    assert len(active.rows) < 100


def test_tiles_hold_all_that_moves_and_views_without_any_are_left_out():
    g, views, masks = case()
    masks[0][:] = False
    masks = [m if i in (0, 1) else np.zeros_like(m) for i, m in enumerate(masks)]
    active = find_active(g, views[:2], masks[:2])
    drawn = {v.camera.name: v.redraw for v in active.views}
    redraw = drawn[views[1].camera.name]
    pixels = np.repeat(np.repeat(redraw.tiles, cpu.TILE, axis=0), cpu.TILE, axis=1)[:96, :96]
    assert pixels[masks[1]].all() and not redraw.tiles.all()
    assert (redraw.rest().rgb == cpu.render(g, views[1].camera).rgb).all()
    nothing = find_active(g, views, [np.zeros_like(m) for m in masks[:1]] * len(views))
    assert not len(nothing.rows) and not nothing.views


def test_weights_are_those_of_the_contribution():
    g, views, masks = case()
    w = cpu.weights(cpu.activate(g), views[0].camera, masks[0])
    whole = cpu.measure_contribution(g, views[0].camera).total
    np.testing.assert_allclose(np.bincount(w.ids, w.total, len(g)), whole, rtol=1e-4, atol=1e-4)
    assert (w.inside <= w.total + 1e-4).all()
    assert w.inside.sum() < 0.9 * w.total.sum()


def test_rows_are_joined_and_picked_again():
    rows = random_parameters(10)
    resting = Resting(rows, torch.tensor([2, 5, 7]))
    fitted = {name: value[:5] + 1 for name, value in random_parameters(5, seed=1).items()}
    whole = resting.joined(fitted)
    for name, value in whole.items():
        assert len(value) == 12
        assert torch.equal(resting.picked(value), fitted[name])
        still = [0, 1, 3, 4, 6, 8, 9]
        assert torch.equal(value[still], rows[name][still])
