"""Fits at the edges that docs/results/stiff.md names: needles, faint rows, coincident rows, lengths of quaternions."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.render import render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.parameters import Adam, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.variables import PerGaussian
from tests.support.views import coloured_cloud, ring, views_of

CAMERAS = ring(2, size=32)


def fitted(start: Gaussians, target: Gaussians, iterations: int = 30) -> tuple[Gaussians, float]:
    """The end of a fit, and by how many dB it is nearer to the target."""
    views = views_of(target, CAMERAS)
    variables = PerGaussian(from_gaussians(start), 5.0)
    optimise(variables, views, Schedule("fit", iterations, lambda done: 0), np.random.default_rng(0))
    after = to_gaussians(variables.detached())
    assert all(np.isfinite(getattr(after, name)).all() for name in after.__slots__)
    return after, mean_psnr(after, views) - mean_psnr(start, views)


def stretched(ratio: float) -> Gaussians:
    """Blobs one axis of which is `ratio` times as long as the others."""
    g = coloured_cloud(6)
    short = np.log(0.4) - np.log(ratio) * np.array([0, 1, 1])
    turns = np.random.default_rng(0).normal(size=(6, 4)).astype(np.float32)
    return replace(g, log_scales=np.tile(short, (6, 1)).astype(np.float32), quaternions=turns)


@pytest.mark.parametrize("ratio", [1e3, 1e6])
def test_needles_train(ratio: float) -> None:
    target = stretched(ratio)
    start = replace(target, sh_dc=target.sh_dc + 0.3, means=target.means + np.float32(0.02))
    assert fitted(start, target)[1] > 2


@pytest.mark.parametrize("norm", [1e-20, 1e-6, 1e15, 1e25])
def test_quaternions_of_any_length_train(norm: float) -> None:
    g = stretched(3.0)
    target = replace(g, quaternions=g.quaternions * np.float32(norm))
    after, gain = fitted(replace(target, sh_dc=target.sh_dc + 0.3), target)
    assert gain > 2
    if norm == 1e-20:  # the identity, which has no gradient
        np.testing.assert_array_equal(after.quaternions, target.quaternions)


@pytest.mark.parametrize("norm", [1e-9, 1e18, 1e20, 1e38])
def test_long_and_short_quaternions_are_drawn_as_unit_ones(norm: float) -> None:
    g = stretched(30.0)
    unit = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    shown = [render(replace(g, quaternions=q), CAMERAS[0]).rgb for q in (unit, unit * np.float32(norm))]
    assert shown[0].max() > 0.1
    np.testing.assert_allclose(shown[1], shown[0], atol=1e-4)


def test_what_is_too_faint_to_be_drawn_stays_as_it_is() -> None:
    g = coloured_cloud(6)
    after, _ = fitted(replace(g, opacity_logits=np.full(6, -14.0, np.float32)), g)
    np.testing.assert_array_equal(after.opacity_logits, np.full(6, -14.0, np.float32))
    np.testing.assert_array_equal(after.means, g.means)


def test_rows_in_one_place_part() -> None:
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
def test_extreme_rows_stay_finite_in_a_fit(column: str, value: object) -> None:
    g = coloured_cloud(40)
    extreme = getattr(g, column).copy()
    extreme[:10] = value
    assert fitted(replace(g, **{column: extreme}), g)[0].log_scales.max() <= np.log(5.0) + 1e-5


def test_the_size_of_gradients_does_not_matter_to_steps() -> None:
    """Down to 1e-10, far below those of pictures; with the usual epsilon of 1e-8 such rows would hardly move."""
    moved = []
    for size in (1e-2, 1e-10):
        adam = Adam({"means": torch.zeros(1)}, {"means": 0.1})
        for _ in range(5):
            adam.parameters["means"].grad = torch.tensor([size])
            adam.step()
        moved.append(float(-adam.parameters["means"].detach()))
    assert moved[1] == pytest.approx(moved[0], rel=0.02)
