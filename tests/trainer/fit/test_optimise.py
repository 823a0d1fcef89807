"""The loop that fits, the order of views, and pictures of half the size."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.errors import TrainingError
from airgs_codec.render import cpu, look_at
from airgs_codec.render.cpu import Redraw
from airgs_codec.scene.camera import with_pixels
from airgs_codec.trainer.data.pictures import Pictures, Target, View
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.losses import photometric
from airgs_codec.trainer.fit.optimise import (
    Deck,
    Losses,
    Schedule,
    can_be_halved,
    drawn,
    halve,
    optimise,
)
from airgs_codec.trainer.fit.parameters import InMotion, from_gaussians, render, with_motion
from airgs_codec.trainer.fit.variables import PerGaussian
from tests.support.views import coloured_cloud, moved, ring, views_of


def test_a_loss_that_is_not_finite_ends_the_fit_with_the_view():
    g = coloured_cloud(20)
    views = views_of(g, ring(2))
    views[0].target.rgb[:] = views[1].target.rgb[:] = np.nan
    variables = PerGaussian(from_gaussians(g), 5.0)
    with pytest.raises(TrainingError, match="iteration 1 in view cam0"):
        optimise(variables, views, Schedule("fit", 5, lambda done: 0), np.random.default_rng(0))


def test_a_fit_is_the_same_whatever_is_kept_in_memory(moving):
    scene = open_scene(moving)
    fitted = []
    for size in (1 << 30, 1):
        pictures = Pictures(scene, picture_bytes=size, target_bytes=size)
        variables = PerGaussian(from_gaussians(coloured_cloud(30)), 5.0)
        optimise(variables, pictures.train(0), Schedule("fit", 12, lambda done: 0), np.random.default_rng(0))
        fitted.append(variables.detached())
        assert size > 1 or pictures.nbytes < 48 * 48 * (3 + 36) + 1  # one of each
    assert all(torch.equal(fitted[0][name], fitted[1][name]) for name in fitted[0])


def test_a_deck_deals_every_view_before_any_comes_again():
    deck = Deck(7, np.random.default_rng(0))
    dealt = []
    for _ in range(14):
        dealt += deck.take(3)
    assert [sorted(dealt[i : i + 7]) for i in range(0, 42, 7)] == [list(range(7))] * 6


def test_losses_that_are_looked_at_seldom_still_name_the_first_fault():
    views, losses = views_of(coloured_cloud(5), ring(2)), Losses(50)
    for iteration in range(1, 50):
        losses.add(iteration, views, torch.tensor(math.nan if iteration in (7, 30) else 1.0), last=False)
    with pytest.raises(TrainingError, match="iteration 7 in view cam00, cam01"):
        losses.add(50, views, torch.tensor(1.0), last=False)
    late = Losses(50)
    with pytest.raises(TrainingError, match="iteration 3 in view cam01"):
        late.add(3, views[1:], torch.tensor(math.inf), last=True)


def test_an_iteration_of_several_pictures_follows_the_mean_of_their_losses():
    """One step over all views is the step of the averaged gradients, whatever their order."""
    g = coloured_cloud(30)
    views = views_of(moved(g, slice(0, 10), (0.1, 0, 0)), ring(3))
    together, by_hand = (PerGaussian(from_gaussians(g), 5.0) for _ in range(2))
    optimise(together, views, Schedule("fit", 1, lambda done: 0, views=3), np.random.default_rng(0))
    parts = [render(by_hand.current(), v.camera, 0)[0] for v in views]
    sum(photometric(rgb, v.target) / 3 for rgb, v in zip(parts, views, strict=True)).backward()
    by_hand.step(1, 1)
    for name, value in together.detached().items():
        torch.testing.assert_close(value, by_hand.detached()[name], atol=1e-4, rtol=1e-3)
    assert not torch.equal(together.detached()["means"], from_gaussians(g)["means"])


def test_each_of_several_pictures_shows_the_time_it_was_taken_at():
    g, motion = coloured_cloud(30), np.full((30, 3), 0.1, np.float32)
    views = [replace(v, after=after) for v, after in zip(views_of(g, ring(3)), (0.0, -0.5, 0.25), strict=True)]
    pictures = drawn(PerGaussian(with_motion(from_gaussians(g), views, motion), 5.0), views, 0)
    for view, (rgb, _) in zip(views, pictures, strict=True):
        shown = render(from_gaussians(InMotion(g, motion).at(view.after)), view.camera, 0)[0]
        torch.testing.assert_close(rgb, shown, atol=1e-5, rtol=0)
    assert halve(views[1]).after == -0.5


CAMERA = look_at(np.array([0.3, 0.2, -4.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]), size=75, fov_y=0.9, name="odd")


SCENE = replace(coloured_cloud(60), log_scales=np.full((60, 3), np.log(0.25), np.float32))


def test_a_halved_camera_sees_what_its_halved_picture_shows() -> None:
    seen = cpu.render(SCENE, CAMERA).rgb
    half = halve(View(CAMERA, Target(seen, np.zeros(seen.shape[:2], np.float32))))
    assert half.target.rgb.shape == (38, 38, 3)
    assert half.target.clear is not None and half.target.clear.shape == (38, 38)
    drawn = cpu.render(SCENE, half.camera).rgb
    error, beside = (np.abs(picture - half.target.rgb).mean() for picture in (drawn, np.roll(drawn, 1, axis=1)))
    assert error < 0.2 * beside


def test_pictures_that_are_small_on_either_side_are_not_halved() -> None:
    views = [
        View(with_pixels(CAMERA, *size), Target(np.zeros((1, 1, 3), np.float32))) for size in ((160, 200), (159, 400))
    ]
    assert can_be_halved(views[:1]) and not can_be_halved(views)


def test_tiles_are_drawn_again_where_one_of_four_was() -> None:
    whole = cpu.render(SCENE, CAMERA)
    tiles = np.zeros((5, 5), np.bool_)
    tiles[1, 4] = tiles[4, 0] = True
    redraw = Redraw(tiles, lambda: whole, np.ones(len(SCENE), np.bool_))
    half = halve(View(CAMERA, Target(whole.rgb), redraw)).redraw
    assert half is not None
    assert np.argwhere(half.tiles).tolist() == [[0, 2], [2, 0]]
    assert half.rest().rgb.shape == (38, 38, 3) and half.rest().transmittance.shape == (38, 38)
