"""The loop that fits, the order of views, and pictures of half the size."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.render import cpu
from airgs_codec.trainer.fit.losses import mean_psnr, photometric
from airgs_codec.trainer.fit.optimise import Deck, Losses, Schedule, can_be_halved, drawn, halve, optimise
from airgs_codec.trainer.fit.parameters import render, to_gaussians, with_motion
from airgs_codec.trainer.fit.variables import PerGaussian
from tests.faces import (
    Adam,
    Gaussians,
    InMotion,
    Pictures,
    Redraw,
    Target,
    TrainingError,
    View,
    from_gaussians,
    look_at,
    open_scene,
    with_pixels,
)
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


def test_a_halved_camera_sees_what_its_halved_picture_shows():
    seen = cpu.render(SCENE, CAMERA).rgb
    half = halve(View(CAMERA, Target(seen, np.zeros(seen.shape[:2], np.float32))))
    assert half.target.rgb.shape == (38, 38, 3)
    assert half.target.clear is not None and half.target.clear.shape == (38, 38)
    drawn = cpu.render(SCENE, half.camera).rgb
    error, beside = (np.abs(picture - half.target.rgb).mean() for picture in (drawn, np.roll(drawn, 1, axis=1)))
    assert error < 0.2 * beside


def test_pictures_that_are_small_on_either_side_are_not_halved():
    target = Target(np.zeros((1, 1, 3), np.float32))
    views = [View(with_pixels(CAMERA, *size), target) for size in ((160, 200), (159, 400))]
    assert can_be_halved(views[:1]) and not can_be_halved(views)


def test_tiles_are_drawn_again_where_one_of_four_was():
    whole = cpu.render(SCENE, CAMERA)
    tiles = np.zeros((5, 5), np.bool_)
    tiles[1, 4] = tiles[4, 0] = True
    redraw = Redraw(tiles, lambda: whole, np.ones(len(SCENE), np.bool_))
    half = halve(View(CAMERA, Target(whole.rgb), redraw)).redraw
    assert half is not None
    assert np.argwhere(half.tiles).tolist() == [[0, 2], [2, 0]]
    assert half.rest().rgb.shape == (38, 38, 3) and half.rest().transmittance.shape == (38, 38)


CAMERAS = ring(2, size=32)


def fitted(start: Gaussians, target: Gaussians, iterations: int = 30) -> tuple[Gaussians, float]:
    """The end of a fit, and by how many dB it is nearer to the target."""
    views = views_of(target, CAMERAS)
    variables = PerGaussian(from_gaussians(start), 5.0)
    optimise(variables, views, Schedule("fit", iterations, lambda done: 0), np.random.default_rng(0))
    after = to_gaussians(variables.detached())
    assert all(np.isfinite(getattr(after, name)).all() for name in after.__slots__)
    return after, mean_psnr(after, views) - mean_psnr(start, views)


def stretched(ratio) -> Gaussians:
    """Blobs one axis of which is `ratio` times as long as the others."""
    g = coloured_cloud(6)
    short = np.log(0.4) - np.log(ratio) * np.array([0, 1, 1])
    turns = np.random.default_rng(0).normal(size=(6, 4)).astype(np.float32)
    return replace(g, log_scales=np.tile(short, (6, 1)).astype(np.float32), quaternions=turns)


@pytest.mark.parametrize("ratio", [1e3, 1e6])
def test_needles_train(ratio):
    target = stretched(ratio)
    start = replace(target, sh_dc=target.sh_dc + 0.3, means=target.means + np.float32(0.02))
    assert fitted(start, target)[1] > 2


@pytest.mark.parametrize("norm", [1e-20, 1e-6, 1e15, 1e25])
def test_quaternions_of_any_length_train(norm):
    g = stretched(3.0)
    target = replace(g, quaternions=g.quaternions * np.float32(norm))
    after, gain = fitted(replace(target, sh_dc=target.sh_dc + 0.3), target)
    assert gain > 2
    if norm == 1e-20:  # the identity, which has no gradient
        np.testing.assert_array_equal(after.quaternions, target.quaternions)


@pytest.mark.parametrize("norm", [1e-9, 1e18, 1e20, 1e38])
def test_long_and_short_quaternions_are_drawn_as_unit_ones(norm):
    g = stretched(30.0)
    unit = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    shown = [cpu.render(replace(g, quaternions=q), CAMERAS[0]).rgb for q in (unit, unit * np.float32(norm))]
    assert shown[0].max() > 0.1
    np.testing.assert_allclose(shown[1], shown[0], atol=1e-4)


def test_what_is_too_faint_to_be_drawn_stays_as_it_is():
    g = coloured_cloud(6)
    after, _ = fitted(replace(g, opacity_logits=np.full(6, -14.0, np.float32)), g)
    np.testing.assert_array_equal(after.opacity_logits, np.full(6, -14.0, np.float32))
    np.testing.assert_array_equal(after.means, g.means)


def test_rows_in_one_place_part():
    g = coloured_cloud(4)
    twice = g.take(np.tile(np.arange(4), 2))
    apart = replace(twice, means=twice.means + np.repeat([[-0.03], [0.03]], 4, axis=0).astype(np.float32))
    target = replace(apart, sh_dc=np.concatenate([g.sh_dc, -g.sh_dc]), opacity_logits=np.zeros(8, np.float32))
    after, gain = fitted(replace(twice, opacity_logits=np.zeros(8, np.float32)), target)
    assert gain > 2
    assert np.abs(after.sh_dc[:4] - after.sh_dc[4:]).max() > 0.01


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("opacity_logits", [100, -100, 20, -20, 0, 50, -50, 5, -5, 1]),
        ("log_scales", -30),
        ("log_scales", 8),
        ("quaternions", 0),
    ],
)
def test_extreme_rows_stay_finite_in_a_fit(column, value):
    g = coloured_cloud(40)
    extreme = getattr(g, column).copy()
    extreme[:10] = value
    assert fitted(replace(g, **{column: extreme}), g)[0].log_scales.max() <= np.log(5.0) + 1e-5


def test_the_size_of_gradients_does_not_matter_to_steps():
    """Down to 1e-10, far below those of pictures; with the usual epsilon of 1e-8 such rows would hardly move."""
    moved = []
    for size in (1e-2, 1e-10):
        adam = Adam({"means": torch.zeros(1)}, {"means": 0.1})
        for _ in range(5):
            adam.parameters["means"].grad = torch.tensor([size])
            adam.step()
        moved.append(float(-adam.parameters["means"].detach()))
    assert moved[1] == pytest.approx(moved[0], rel=0.02)
