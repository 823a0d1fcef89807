"""What hangs before viewers goes; what cameras see from near, and what stands behind all else, stays."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.trainer.fit.grow import in_open_space
from airgs_codec.trainer.fit.losses import ExposureModel, matched_psnr, mean_psnr
from tests.faces import (
    FrameViews,
    Points,
    Target,
    Trainer,
    TrainSettings,
    fit_first,
    from_points,
    join_rows,
    look_at,
    render,
    scene_extent,
)
from tests.support.views import coloured_cloud, ring, views_of

FREE = (0.1, 0.1, 2.3)  # behind the two near cameras, before the two far ones


def seen_from(x, z, to):
    place, target, up = (np.array(v, np.float64) for v in ((x, 0, z), (x / 2, 0, to), (0, -1, 0)))
    camera = look_at(place, target, up, size=64, fov_y=1.0, name="c")
    return replace(camera, near=0.02)


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
    return [replace(wall, sh_dc=colours.astype(np.float32)), rod]


@pytest.mark.parametrize(("far", "opacity"), [((0, 1), 0.5), ((0,), 0.95)])
def test_a_floater_before_a_held_out_camera_goes_and_what_is_there_stays(room, far, opacity):
    truth = join_rows(room)
    cameras, held_out = [CAMERAS[i] for i in (*far, 2, 3, 4)], seen_from(0.1, 2.0, 4)
    shown = join_rows([truth, balls([FREE], 0.1, 0.05, opacity)])
    gone = in_open_space(shown, cameras)
    assert gone[-1] and not gone[2500:-1].any()
    assert len(far) == 1 or not gone[:2500].any(), "a wall that several see stays, however near viewers come to it"
    kept = shown.take(np.flatnonzero(~gone))
    expected, before, after = (render(g, held_out).rgb[16:48, 16:48] for g in (truth, shown, kept))
    assert np.abs(before - expected).mean() > 10 * np.abs(after - expected).mean()


def test_a_fit_removes_it_and_says_how_many(room):
    truth = join_rows(room)
    cloud = np.concatenate([truth.means, np.random.default_rng(0).normal(FREE, 0.05, (30, 3))])
    trainer = Trainer(TrainSettings(budget=2600, sh_degree=0, first_iterations=20), scene_extent(CAMERAS))
    found = fit_first(trainer, FrameViews(0, views_of(truth, CAMERAS)), Points(cloud.astype(np.float32), None))
    assert found.cleared >= 10
    assert (np.linalg.norm(found.gaussians.means - FREE, axis=1) < 0.3).sum() < 15


@pytest.mark.parametrize(("sides", "differs"), [((1.05, 1.05), True), ((1.05, 0.95), False)])
def test_exposure_is_one_only_where_both_halves_of_pictures_ask_for_it(sides, differs):
    gains = np.repeat(sides, 8).astype(np.float32)[None, :, None]
    grey = torch.full((8, 16, 3), 0.5)
    model = ExposureModel(2, "cpu", looks=60)
    for i in range(60):
        target = grey.numpy() * (gains if i % 2 else 2 - gains)
        (model.apply(grey, i % 2) - torch.from_numpy(target)).abs().mean().backward()
        model.step()
    assert model.differs == differs


def test_gains_of_a_picture_are_matched_only_where_its_halves_agree():
    g = coloured_cloud()
    view = views_of(g, ring(1))[0]
    for gain in (np.full(48, 0.7), np.repeat((0.7, 1.0), 24)):
        dark = replace(view, picture=Target(view.target.rgb * gain.astype(np.float32)[None, :, None]))
        better = matched_psnr(g, [dark]) - mean_psnr(g, [dark])
        assert better > 20 if gain[-1] < 1 else better == 0
