"""Spacetime Gaussians, the lite model: every Gaussian moves by a polynomial, turns evenly, and appears and fades.

At the normalised time t of [0, 1], with d = t - centre (Li et al., Spacetime Gaussian Feature Splatting, CVPR 2024,
equations 5 to 8): the mean is mean + motion_1 d + motion_2 d^2 + motion_3 d^3, the quaternion is quaternion + turn d,
alpha is alpha exp(-(d / width)^2). Sizes and the colour, plain RGB without SH, stay. N Gaussians.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.clip import Bake, Clip, count_frames, rate_words
from airgs_codec.scene.formats.linear import logits_of
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.scene.ply import PlyHeader
from airgs_codec.scene.rates import DEFAULT_FPS

DEFAULT_SECONDS = Fraction(50, 30)  # no file states it; the models of the paper are trained on 50 frames of 30 fps
_KEPT = 2  # models that a process keeps


@dataclass(frozen=True, slots=True, eq=False)
class Spacetime:
    """A model of N Gaussians, all float32."""

    means: NDArray[np.float32]  # (N, 3) world units at d = 0
    motion: NDArray[np.float32]  # (N, 3, 3) of powers 1 to 3 of d, then axes
    quaternions: NDArray[np.float32]  # (N, 4) w, x, y, z at d = 0, of any length
    turns: NDArray[np.float32]  # (N, 4) of the quaternion
    log_scales: NDArray[np.float32]  # (N, 3)
    alpha: NDArray[np.float32]  # (N,) of [0, 1]
    rgb: NDArray[np.float32]  # (N, 3) of [0, 1]
    centres: NDArray[np.float32]  # (N,) normalised time
    widths: NDArray[np.float32]  # (N,) normalised time

    def at(self, t: float) -> Gaussians:
        """The frame at normalised time t. Rows keep their order; what is not finite stays so."""
        d = (np.float32(t) - self.centres)[:, None]
        first, second, third = self.motion.transpose(1, 0, 2)
        with np.errstate(all="ignore"):
            return Gaussians(
                self.means + d * (first + d * (second + d * third)),
                self.quaternions + d * self.turns,
                self.log_scales,
                logits_of(self.alpha * np.exp(-np.square(d[:, 0] / self.widths))),
                ((self.rgb - np.float32(0.5)) / np.float32(SH_C0)).astype(np.float32),
                np.zeros((len(self.means), 0, 3), np.float32),
            )


Load = Callable[[Path], Spacetime]  # reads a file; raises SceneError


def open_spacetime(path: Path, load: Load, name: str, bake: Bake) -> Clip:
    """A model baked to frames, frame i of F at t = i / F. Raises SceneError."""
    fps, seconds = bake.fps or DEFAULT_FPS, bake.seconds if bake.seconds is not None else DEFAULT_SECONDS
    frames = count_frames(path, fps, seconds)
    count = len(_model(load, path).means)
    default = " by default, no length is stated" if bake.seconds is None else ""
    note = f"{name}, {count} Gaussians baked to {frames} frames at {rate_words(fps)}: {float(seconds):.4g} s{default}"
    return Clip((PlyHeader(count, 0),) * frames, fps, functools.partial(_frame, load, frames), note)


def _frame(load: Load, frames: int, path: Path, frame: int) -> Gaussians:
    return _model(load, path).at(frame / frames)


def _model(load: Load, path: Path) -> Spacetime:
    """The model of a file as it is now."""
    try:
        return _kept(load, path, path.stat().st_mtime_ns)
    except OSError as error:
        raise SceneError(f"{path}: cannot read: {error.strerror}") from error


@functools.lru_cache(maxsize=_KEPT)
def _kept(load: Load, path: Path, _written: int) -> Spacetime:
    return load(path)
