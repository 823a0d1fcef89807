"""Gaussians that move by themselves: every one moves, may turn, and appears and fades.

At the normalised time t of [0, 1], with d = t - centre, the mean is mean + motion_1 d + ... + motion_P d^P, the
quaternion is quaternion + turn d, and alpha is alpha exp(-(d / width)^2). Sizes and colours stay. N Gaussians; frame i
of F that are written is at t = i / (F - 1).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.files import reading
from airgs_codec.scene.formats.form import Clip, FrameHeader, rate_words
from airgs_codec.scene.gaussians import LEAST_SHARE, SH_C0, Gaussians, logits_of, mean_frame

LONGEST = 16.0  # of deviations in time: alpha then stays within 1/512 over all of it
_DEVIATIONS = np.geomspace(0.02, LONGEST, 32)  # that are tried, then others around the best
_FINER = tuple(np.geomspace(1 / reach, reach, 9) for reach in (1.24, 1.06, 1.015))
MOST_OFF = 0.02  # share of rows, of a file that is said to move evenly
_FURTHEST = 2.0  # that the middle of a row's time may be from when it is seen: places are as exact as it is near
_FAINTEST = 1 / 255  # alpha from which it counts where a row is
_CACHED = 2  # models of a process


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """A model of N Gaussians, all float32."""

    rest: Gaussians  # as at d = 0, whatever its opacities
    motion: NDArray[np.float32]  # (N, P, 3) of powers 1 to P of d, then axes
    alpha: NDArray[np.float32]  # (N,) of [0, 1]
    centres: NDArray[np.float32]  # (N,) normalised time
    widths: NDArray[np.float32]  # (N,) normalised time
    turns: NDArray[np.float32] | None = None  # (N, 4) of the quaternion
    least_alpha: float = 0.0

    def at(self, t: float) -> Gaussians:
        """The frame at normalised time t. Rows keep their order; what is not finite stays so."""
        d = (np.float32(t) - self.centres)[:, None]
        shift = np.zeros_like(self.rest.means)
        with np.errstate(all="ignore"):
            for power in range(self.motion.shape[1])[::-1]:
                shift = d * (self.motion[:, power] + shift)
            alpha = np.maximum(self.alpha * np.exp(-np.square(d[:, 0] / self.widths)), np.float32(self.least_alpha))
            quaternions = self.rest.quaternions if self.turns is None else self.rest.quaternions + d * self.turns
            means = self.rest.means + shift
        return replace(self.rest, means=means, quaternions=quaternions, opacity_logits=logits_of(alpha))


Load = Callable[[Path], Moving]  # reads a file; raises SceneError, OSError


def moving_clip(load: Load, path: Path, frames: int, fps: Fraction, intervals: int) -> Clip:
    """A model as frames, number i of them at t = i / intervals; the note is to be written. Raises SceneError."""
    rest = _model(load, path).rest
    header = FrameHeader(len(rest), rest.sh_degree)
    return Clip((header,) * frames, fps, functools.partial(_frame, load, intervals), "")


def baked_note(name: str, clip: Clip, seconds: Fraction, stated: bool) -> str:
    """What was read, and how it became frames."""
    count, frames = clip.headers[0].count, len(clip.headers)
    default = "" if stated else " by default, no length is stated"
    return (
        f"{name}, {count} Gaussians baked to {frames} frames at {rate_words(clip.fps)}: {float(seconds):.4g} s{default}"
    )


def _frame(load: Load, intervals: int, path: Path, frame: int) -> Gaussians:
    return _model(load, path).at(frame / intervals)


def _model(load: Load, path: Path) -> Moving:
    """The model of a file as it is now."""
    with reading(path):
        return _cached(load, path, path.stat().st_mtime_ns)


@functools.lru_cache(maxsize=_CACHED)
def _cached(load: Load, path: Path, _written: int) -> Moving:
    return load(path)


@dataclass(frozen=True, slots=True, eq=False)
class Even:
    """The even motion that is nearest to frames, P = 1 and no turns, and the share of their rows that are off it."""

    moving: Moving
    off: float


def even_motion(frames: Sequence[Gaussians]) -> Even | None:
    """What moves and fades as frames do, by least squares in which a row counts as it is seen; None: of other rows.

    A row of a frame is off if it is half its size beside its place, its alpha, its colour or the logarithm of a size is
    0.05, 0.05 or 0.2 another, or it is turned by 0.2 radians.
    """
    if len({(len(g), g.sh_degree) for g in frames}) > 1:
        return None
    times = np.linspace(0, 1, len(frames)) if len(frames) > 1 else np.zeros(1)
    alphas = np.stack([g.opacities() for g in frames]).astype(np.float64)
    places = np.stack([g.means for g in frames])
    weights = np.square(alphas) + LEAST_SHARE  # so that what is never seen has a place
    weights /= weights.sum(axis=0)
    middle = np.einsum("fn,f->n", weights, times)
    late = times[:, None] - middle
    variance = np.einsum("fn,fn,fn->n", weights, late, late)
    moves = np.einsum("fn,fn,fnc->nc", weights, late, places)
    speed = np.divide(moves, variance[:, None], out=np.zeros_like(moves), where=variance[:, None] > 0)
    alpha, centres, deviations = _fading(alphas, weights, late)
    means = np.einsum("fn,fnc->nc", weights, places) + speed * centres[:, None]
    rest = replace(mean_frame(frames), means=means.astype(np.float32))
    motion, widths = speed.astype(np.float32)[:, None], (deviations * np.sqrt(2)).astype(np.float32)
    moving = Moving(rest, motion, alpha.astype(np.float32), (centres + middle).astype(np.float32), widths)
    off = [_is_off(moving.at(t), g).mean() for t, g in zip(times, frames, strict=True)]
    return Even(moving, float(np.mean(off)))


def _fading(
    alphas: NDArray[np.float64], weights: NDArray[np.float64], late: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """(N,) largest alpha, its time and the deviation that are nearest to alphas (F, N); times are as in `late`."""
    logs = np.log(np.maximum(alphas, np.finfo(np.float32).tiny), dtype=np.float64)
    variance = np.einsum("fn,fn,fn->n", weights, late, late)
    least, best = np.full(alphas.shape[1], np.inf), np.ones((3, alphas.shape[1]))
    for factors in (_DEVIATIONS, *_FINER):
        for deviation in factors[:, None] * best[2]:
            curve = np.square(late / deviation) / 2
            level = np.einsum("fn,fn->n", weights, logs + curve)
            slope = np.einsum("fn,fn,fn->n", weights, late, logs + curve)
            slope = np.divide(slope, variance, out=np.zeros_like(slope), where=variance > 0)
            centre = np.clip(slope * deviation**2, -_FURTHEST, _FURTHEST)
            peak = np.minimum(0, level + np.square(centre / deviation) / 2)
            error = np.square(np.exp(peak - np.square((late - centre) / deviation) / 2) - alphas).sum(axis=0)
            better = error <= least  # of those that are as good, the longest
            least[better] = error[better]
            best[:, better] = np.stack([np.exp(peak), centre, deviation])[:, better]
    return tuple(best)


def _is_off(shown: Gaussians, g: Gaussians) -> NDArray[np.bool_]:
    """(N,) the rows of a frame that are somewhere else than they should be, as `even_motion` says."""
    alpha, wanted = shown.opacities(), g.opacities()
    size = np.exp(g.log_scales.mean(axis=1))
    turn = np.abs(np.einsum("nc,nc->n", shown.quaternions, g.quaternions))
    turn /= np.linalg.norm(shown.quaternions, axis=1) * np.linalg.norm(g.quaternions, axis=1)
    beside = np.linalg.norm(shown.means - g.means, axis=1) > size / 2
    beside |= np.abs(shown.log_scales - g.log_scales).max(axis=1) > 0.2
    beside |= np.abs(shown.sh_dc - g.sh_dc).max(axis=1) * SH_C0 > 0.05
    beside |= turn < np.cos(0.1)  # of half the angle
    return (beside & (np.maximum(alpha, wanted) > _FAINTEST)) | (np.abs(alpha - wanted) > 0.05)
