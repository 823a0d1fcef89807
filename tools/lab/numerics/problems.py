"""Scenes of a few Gaussians with one property taken to its ends, and where a fit of them starts. N Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airgs_codec.render import Camera
from airgs_codec.scene.camera import look_at
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.fit.optimise import Rates
from airgs_codec.trainer.fit.trainer import MOVING_RATES

EXTENT = 5.0  # of every scene, world units; cameras are as far from the middle
SIZE = 0.3  # of a Gaussian, world units: 2 pixels
PIXELS = 32
COUNT = 6


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    target: Gaussians
    start: Gaussians
    cameras: Sequence[Camera]
    rates: Rates
    temporal: bool = False  # whether the loss of changes is added, as between frames


def blobs(count: int = COUNT, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(count, 4))
    return _gaussians(
        0.5 * rng.normal(size=(count, 3)),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        np.full((count, 3), np.log(SIZE)),
        rng.normal(size=count),
        rng.normal(size=(count, 3)),
    )


def _gaussians(*columns: NDArray[np.float64]) -> Gaussians:
    means, quaternions, log_scales, logits, colours = (column.astype(np.float32) for column in columns)
    return Gaussians(means, quaternions, log_scales, logits, colours, np.zeros((len(means), 0, 3), np.float32))


def disturbed(g: Gaussians, seed: int = 1) -> Gaussians:
    """Every attribute a little off, by what the trainer's rates can mend in a hundred iterations."""
    rng = np.random.default_rng(seed)
    shape = g.means.shape
    length = np.linalg.norm(g.quaternions.astype(np.float64), axis=1, keepdims=True)
    return _gaussians(
        g.means + 0.02 * rng.normal(size=shape),
        g.quaternions + 0.05 * length * rng.normal(size=(len(g), 4)),
        g.log_scales + 0.15 * rng.normal(size=shape),
        g.opacity_logits + 0.5 * rng.normal(size=len(g)),
        g.sh_dc + 0.2 * rng.normal(size=shape),
    )


def cameras(distance: float = EXTENT, count: int = 2) -> list[Camera]:
    found = []
    for i in range(count):
        turn = 2.1 * i
        place = distance * np.array([np.cos(turn), 0.3, np.sin(turn)]) / np.hypot(1, 0.3)
        up = np.array([0.0, -1.0, 0.0])
        found.append(look_at(place, np.zeros(3), up, size=PIXELS, fov_y=0.8, name=f"camera {i}"))
    return found


def needles(ratio: float) -> Problem:
    """Gaussians of which one axis is `ratio` times as long as the others."""
    g = blobs()
    scales = g.log_scales - np.float32(np.log(ratio)) * np.array([0, 1, 1], np.float32)
    target = replace(g, log_scales=scales)
    return Problem(target, disturbed(target), cameras(), Rates())


def distant(share: float) -> Problem:
    """Gaussians at `share` of the scene's extent from the cameras, as large in pictures as at 1 where they may be.

    The trainer holds no Gaussian larger than the extent, so that these are no larger than half of it.
    """
    g = blobs()
    target, start = (_scaled(part, share) for part in (g, disturbed(g)))
    return Problem(target, start, cameras(EXTENT * share), Rates())


def _scaled(g: Gaussians, share: float) -> Gaussians:
    sizes = np.minimum(g.log_scales + np.float32(np.log(share)), np.float32(np.log(EXTENT / 2)))
    return replace(g, means=g.means * np.float32(share), log_scales=sizes)


def moving(share: float, temporal: bool = False) -> Problem:
    """Gaussians that move by `share` of their size from one frame to the next; `temporal`: changes cost something."""
    g = blobs()
    directions = np.random.default_rng(2).normal(size=g.means.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    target = replace(g, means=g.means + (share * SIZE * directions).astype(np.float32))
    return Problem(target, g, cameras(), MOVING_RATES, temporal)


def faint_or_opaque(logit: float) -> Problem:
    g = blobs()
    start = replace(disturbed(g), opacity_logits=np.full(len(g), logit, np.float32))
    return Problem(g, start, cameras(), Rates())


def coincident(share: float) -> Problem:
    """Pairs of Gaussians that start `share` of their size apart and should be a seventh of it apart."""
    g = blobs()
    first, second = (replace(g, means=g.means + np.float32(s * SIZE * 0.07)) for s in (-1, 1))
    start = [replace(g, means=g.means + np.float32(s * SIZE * share / 2)) for s in (-1, 1)]
    target = _pair(first, replace(second, sh_dc=0.6 * second.sh_dc))
    return Problem(target, _pair(*start), cameras(), Rates())


def _pair(a: Gaussians, b: Gaussians) -> Gaussians:
    return Gaussians(*(np.concatenate([getattr(a, name), getattr(b, name)]) for name in a.__slots__))


def quaternions_of(norm: float) -> Problem:
    """Gaussians three times as long as wide whose quaternions have this length."""
    problem = needles(3.0)
    target = replace(problem.target, quaternions=problem.target.quaternions * np.float32(norm))
    return replace(problem, target=target, start=disturbed(target))


@dataclass(frozen=True, slots=True)
class Axis:
    name: str
    title: str
    make: Callable[[float], Problem]
    values: tuple[float, ...]


AXES = (
    Axis("needles", "Needles", needles, (1.0, 10.0, 1e2, 1e4, 1e6)),
    Axis(
        "distance", "Distance to the camera", distant,
        (0.001, 0.01, 0.1, 1.0, 10.0, 1e2, 1e6),
    ),
    Axis("motion", "Motion a frame", moving, (1e-4, 1e-2, 0.1, 1.0, 10.0, 100.0)),
    Axis(
        "changes", "Motion with the temporal loss", partial(moving, temporal=True),
        (1e-4, 1e-2, 0.3, 10.0),
    ),
    Axis("opacity", "Opacity", faint_or_opaque, (-30.0, -8.0, -5.5, 0.0, 4.0, 14.0, 30.0)),
    Axis("coincident", "Coincident rows", coincident, (0.0, 1e-6, 1e-3, 0.1)),
    Axis("quaternions", "Length of quaternions", quaternions_of, (1e-20, 1e-6, 1e-2, 1.0, 1e2, 1e6, 1e25)),
)  # fmt: skip
