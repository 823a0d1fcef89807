"""Where the coordinates of a scene begin: far from zero float32 is too coarse for Gaussians, so an origin comes off.

Positions are float64 until then. How coarse is measured against a Gaussian's own size, which is that of its second
largest axis, and at least SMALL of that of most: beside them nobody sees where what is smaller is. N Gaussians.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.gaussians import Gaussians

Origin = tuple[float, float, float]
ZERO: Origin = (0.0, 0.0, 0.0)
MOVED = 1 / 256  # of its size: a Gaussian's flank falls by 0.61 a size at most, so no pixel changes by 1/255
SMALL = 0.1
SAID = 0.01  # share of what is opaque that may move further before a line says so
RUBBLE = 0.5  # share that may move further than its own size before nothing is left to encode


def moved_share(g: Gaussians, positions: NDArray[np.floating], by: float = MOVED) -> float:
    """The share of what is opaque that float32 at (N, 3) may move by more than a Gaussian's size, times a factor."""
    a, b, c = g.log_scales.T
    x, y, z = np.abs(positions.T)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.spacing(np.maximum(np.maximum(x, y), z).astype(np.float32)) / 2
        sizes = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
        sizes = np.exp(np.maximum(sizes, np.median(sizes) + np.float32(np.log(SMALL)) if len(sizes) else 0))
        limits = np.float32(by) * sizes
    alpha = np.nan_to_num(np.where(np.isfinite(steps) & (limits > 0), g.opacities(), 0.0))
    return float(alpha[steps > limits].sum() / total) if (total := float(alpha.sum())) else 0.0


def choose_origin(g: Gaussians) -> Origin:
    """Where coordinates are to begin: at zero, unless another origin mends at least half of what float32 moves there.

    It is about the median of the Gaussians, a multiple of a power of two that is not above how far they lie from it.
    """
    if (share := moved_share(g, g.means)) <= SAID:
        return ZERO
    origin = rounded_middle(g.means)
    return origin if 2 * moved_share(g, g.means - np.array(origin)) <= share else ZERO


def rounded_middle(positions: NDArray[np.floating]) -> Origin:
    """The median of finite positions (N, 3), rounded to no more than half of what most are away from it; 0 of none."""
    positions = positions[np.isfinite(positions).all(axis=1)].astype(np.float64)
    if not len(positions):
        return ZERO
    middle = np.median(positions, axis=0)
    apart = float(np.median(np.abs(positions - middle).max(axis=1)))
    x, y, z = (np.round(middle / (step := 2.0 ** np.floor(np.log2(apart)))) * step if apart else middle).tolist()
    return x, y, z


def narrowed(g: Gaussians, origin: NDArray[np.float64], path: Path) -> Gaussians:
    """The frame of a file with its positions from an origin (3,), in float32.

    Raises SceneError where float32 holds doubles so coarsely that little is left of them.
    """
    if g.means.dtype == np.float32 and not origin.any():
        return g
    positions = g.means - origin
    if g.means.dtype != np.float32 and (share := moved_share(g, positions, 1.0)) > RUBBLE:
        raise SceneError(
            f"{path}: expected Gaussians near each other, got some so far apart that float32 moves {share:.0%} of what "
            "is opaque by more than its own size"
        )
    with np.errstate(over="ignore"):  # what becomes infinite is repaired or refused later
        return replace(g, means=positions.astype(np.float32))


def in_world(g: Gaussians, origin: ArrayLike) -> Gaussians:
    """A frame for a file of doubles: its positions from zero, float64, where they are from an origin (3,)."""
    positions: NDArray[Any] = g.means + np.asarray(origin, np.float64)
    return replace(g, means=positions)


def origin_notes(g: Gaussians, origin: Origin) -> tuple[str, ...]:
    """What people should know of the origin that was chosen by a frame as its file has it."""
    if origin == ZERO:
        return ()
    where = ", ".join(f"{value:.15g}" for value in origin)
    lost = f"float32 would move {moved_share(g, g.means):.0%} of what is opaque by more than 1/256 of its size"
    if g.means.dtype == np.float32:
        lost = lost.replace("would move", "in the files has moved") + ", which nothing brings back"
    return (f"positions are taken from the origin ({where}): {lost}",)
