"""What may change at a frame: rows and tiles."""

import numpy as np
import torch

from airgs_codec.render import cpu, render
from airgs_codec.trainer.fit.active import Resting, find_active
from tests.support.views import coloured_cloud, moved, random_parameters, ring, views_of


def case():
    g = coloured_cloud(300)
    order = np.argsort(np.linalg.norm(g.means - g.means[0], axis=1))
    g = type(g)(*(getattr(g, n)[order] for n in g.__slots__))
    after = moved(g, slice(0, 20), (0.05, 0.0, 0.0))
    cameras = ring(8, size=96)
    masks = [np.abs(render(g, c).rgb - render(after, c).rgb).max(axis=2) > 0.01 for c in cameras]
    return g, views_of(after, cameras), masks


def test_active_rows_are_those_that_make_what_moves():
    g, views, masks = case()
    active = find_active(g, views, masks)
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
    assert (redraw.rest().rgb == render(g, views[1].camera).rgb).all()
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
