"""Rows are added where the loss or what has appeared asks for them, and removed where they show nothing or hang before
viewers; what cameras see from near, what stands behind all else, and what rests stays."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.render import cpu, cuda
from airgs_codec.trainer.fit import grow, losses
from airgs_codec.trainer.fit.optimise import Resting
from airgs_codec.trainer.fit.trainer import find_active
from tests import faces
from tests.faces import CPU, Trainer, fit_first, from_gaussians, from_points, join_rows, look_at, render, scene_extent
from tests.support.views import BALL, appeared, coloured_cloud, joined, moved, random_parameters, ring, views_of


def test_growth_ends_at_the_budget_and_never_passes_it():
    growth = grow.Growth(budget=1000, start=0.1, stop=0.6, every=10)
    counts = [growth.target(300, done) for done in np.linspace(0, 1, 101)]
    assert counts[0] == 300 and counts[-1] == 1000 and counts == sorted(counts)
    assert growth.target(1200, 0.5) == 1200
    assert [i for i in (20, 300, 305, 700) if growth.due(i, 1000)] == [300]


def test_3dgs_adds_all_rows_above_its_threshold_and_no_others():
    growth = grow.growth_of_3dgs(1000, pictures=1)
    assert [i for i in range(1, 30001) if growth.due(i, 30000)] == list(range(500, 15001, 100))
    assert growth.removes(29900, 30000) and not growth.removes(29950, 30000)  # faint rows go throughout
    gradients = torch.tensor([3e-4, 1e-4, 1.9e-4, 2.1e-4, 0.0])
    p = random_parameters(5)
    p["log_scales"][:] = np.log(0.009)  # no larger than 0.01 of the extent: clones
    for budget, parents in ((1000, [0, 3]), (6, [0])):
        densifier = grow.Densifier(grow.growth_of_3dgs(budget, pictures=1), 5, np.random.default_rng(0))
        keep, added = densifier.grow(p, extent=1.0, fixed=0, done=0.5)
        assert added is None and keep.all()  # before a gradient was seen
        densifier.collect(cuda.AbsGrad([lambda signed: (gradients, torch.ones(5))]))
        keep, added = densifier.grow(p, extent=1.0, fixed=0, done=0.2)
        assert keep.all() and all(torch.equal(added[name], value[parents]) for name, value in p.items())


def test_growing_adds_what_was_asked_and_leaves_kept_rows_in_place():
    p = random_parameters(50)
    parents = grow.strongest(torch.linspace(0, 1, 50), 20)
    keep, added = grow.split_or_clone(p, parents, parents, fixed=40, rng=np.random.default_rng(0))
    assert keep[:40].all() and not keep[40:].any()  # splits of kept rows leave the parent
    assert int(keep.sum()) + len(added["means"]) == 70
    assert torch.allclose(added["log_scales"][-1], p["log_scales"][-1] - math.log(1.6))
    spread = (added["means"][-1] - p["means"][-1]).norm()
    assert 0 < spread < 6 * p["log_scales"][-1].max().exp()


def test_rows_without_a_gradient_are_never_parents_and_what_is_faint_goes_but_for_kept_rows():
    for score, count, chosen in (
        ([0, 0, 0], 5, []), ([0, 2, 1], 5, [1, 2]), ([3, 2, 1], 2, [0, 1]), ([1, 1, 1], -4, []),  # -4: above the target
    ):  # fmt: skip
        assert grow.strongest(torch.tensor(score).float(), count).nonzero()[:, 0].tolist() == chosen
    faint = {"opacity_logits": torch.tensor([-9.0, 3.0, -9.0, 3.0, -9.0, 3.0])}
    assert grow.is_visible(random_parameters(6) | faint, fixed=3).tolist() == [True, True, True, True, False, True]


def test_absolute_gradients_are_largest_where_the_picture_is_wrong():
    with pytest.raises(RuntimeError, match="backward"):
        cuda.AbsGrad().read()
    g = coloured_cloud()
    views = views_of(moved(g, slice(0, 1), (0.0, 0.0, 0.3)), ring(4))
    total = torch.zeros(len(g))
    for view in views:
        absgrad = cuda.AbsGrad()
        p = {n: t.requires_grad_() for n, t in from_gaussians(g).items()}
        losses.photometric(losses.render_views(p, [view.camera], 0, absgrad)[0], [view.target]).backward()
        gradients, seen = absgrad.read()
        assert (gradients[seen == 0] == 0).all()
        total += gradients
    near = np.linalg.norm(g.means - g.means[0], axis=1) < 0.5
    assert near[int(total.argmax())]


def test_seeds_lie_in_what_appeared():
    old, new = coloured_cloud(), joined(coloured_cloud(), appeared())

    def seeds(views, most=120):
        return grow.residual_seeds(old, views, grow.find_wrong(old, views), most, 1.0, np.random.default_rng(0))

    found = seeds(views_of(new, ring(8)))
    assert 0 < len(found) <= 120
    # The ball can be seen to 0.45 from its centre (0.24 + 3 sigma of 0.07), and a pixel is 0.1 wide there.
    assert np.linalg.norm(found.means - BALL, axis=1).max() < 0.6
    for most in (1, 120):
        few = seeds(views_of(new, ring(3)), most)
        assert few is None or 0 < len(few) <= most
    assert seeds(views_of(old, ring(8))) is None


@pytest.fixture(scope="module")
def moving():
    g = coloured_cloud(300)
    g = g.take(np.argsort(np.linalg.norm(g.means - g.means[0], axis=1)))
    after, cameras = moved(g, slice(0, 20), (0.05, 0.0, 0.0)), ring(8, size=96)
    masks = [np.abs(cpu.render(g, c).rgb - cpu.render(after, c).rgb).max(axis=2) > 0.01 for c in cameras]
    return g, views_of(after, cameras), masks


def test_rows_that_make_what_moves_are_active_in_tiles_that_hold_all_of_it_and_views_without_any_are_left_out(moving):
    g, views, masks = moving
    rows, _ = find_active(*moving)
    assert np.isin(np.arange(20), rows).mean() > 0.9 and len(rows) < 100
    still, name = np.zeros_like(masks[0]), views[1].camera.name
    [shown] = (v for v in find_active(g, views[:2], [still, masks[1]])[1] if v.camera.name == name)
    pixels = np.repeat(np.repeat(shown.redraw.tiles, cpu.TILE, axis=0), cpu.TILE, axis=1)[:96, :96]
    assert pixels[masks[1]].all() and not shown.redraw.tiles.all()
    assert (shown.redraw.rest().rgb == cpu.render(g, views[1].camera).rgb).all()
    nothing, unseen = find_active(g, views, [still] * len(views))
    assert not len(nothing) and not unseen


def test_weights_are_those_of_the_contribution(moving):
    g, views, masks = moving
    w = CPU.load(g).weights(views[0].camera, masks[0])
    whole = cpu.measure_contribution(g, views[0].camera).total
    np.testing.assert_allclose(np.bincount(w.ids, w.total, len(g)), whole, rtol=1e-4, atol=1e-4)
    assert (w.inside <= w.total + 1e-4).all()
    assert w.inside.sum() < 0.9 * w.total.sum()


def test_rows_are_joined_and_picked_again():
    rows, still = random_parameters(10), [0, 1, 3, 4, 6, 8, 9]
    resting = Resting(rows, torch.tensor([2, 5, 7]))
    fitted = random_parameters(5, seed=1)
    for name, value in resting.joined(fitted).items():
        assert len(value) == 12 and torch.equal(resting.picked(value), fitted[name])
        assert torch.equal(value[still], rows[name][still])


FREE = (0.1, 0.1, 2.3)  # behind the two near cameras, before the two far ones


def seen_from(x, z, to):
    place, target, up = (np.array(v, np.float64) for v in ((x, 0, z), (x / 2, 0, to), (0, -1, 0)))
    return replace(look_at(place, target, up, size=64, fov_y=1.0, name="c"), near=0.02)


CAMERAS = [seen_from(*c) for c in ((-1.5, -3, 4), (1.5, -3, 4), (0, 2.9, 4), (0.3, 2.9, 4), (1.5, 3.4, 3.4))]


def balls(places, colour, size, opacity=0.95):
    places = np.array(places, np.float32)
    g = from_points(places, np.full((len(places), 3), colour, np.float32), 0, opacity, 1.0)
    return replace(g, log_scales=np.full_like(g.log_scales, np.log(size)))


@pytest.fixture(scope="module")
def room():
    """A wall, a rod before the near cameras, and a last camera right before the wall that looks away from it."""
    x, y = np.meshgrid(np.linspace(-4, 4, 50), np.linspace(-4, 4, 50))
    wall = balls(np.stack([x.ravel(), y.ravel(), np.full(2500, 4.0)], axis=1), 0.5, 0.1)
    colours = 0.4 * np.sin(3 * wall.means[:, :1] + np.array([0, 1, 2])) * np.cos(2 * wall.means[:, 1:2])
    rod = balls([(0.15, y, 3.5) for y in np.linspace(-0.2, 0.2, 20)], 0.9, 0.01)
    return join_rows([replace(wall, sh_dc=colours.astype(np.float32)), rod])


@pytest.mark.parametrize(("far", "opacity"), [((0, 1), 0.5), ((0,), 0.95)])
def test_a_floater_before_a_held_out_camera_goes_and_what_is_there_stays(room, far, opacity):
    cameras, held_out = [CAMERAS[i] for i in (*far, 2, 3, 4)], seen_from(0.1, 2.0, 4)
    shown = join_rows([room, balls([FREE], 0.1, 0.05, opacity)])
    gone = grow.in_open_space(shown, cameras)
    assert gone[-1] and not gone[2500:-1].any()
    assert len(far) == 1 or not gone[:2500].any(), "a wall that several see stays, however near viewers come to it"
    kept = shown.take(np.flatnonzero(~gone))
    expected, before, after = (render(g, held_out).rgb[16:48, 16:48] for g in (room, shown, kept))
    assert np.abs(before - expected).mean() > 10 * np.abs(after - expected).mean()


def test_a_fit_removes_it_and_says_how_many(room):
    cloud = np.concatenate([room.means, np.random.default_rng(0).normal(FREE, 0.05, (30, 3)).astype(np.float32)])
    trainer = Trainer(faces.TrainSettings(budget=2600, sh_degree=0, first_iterations=20), scene_extent(CAMERAS))
    found = fit_first(trainer, faces.FrameViews(0, views_of(room, CAMERAS)), faces.Points(cloud, None))
    assert found.cleared >= 10
    assert (np.linalg.norm(found.gaussians.means - FREE, axis=1) < 0.3).sum() < 15
