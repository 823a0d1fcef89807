"""What a scene does not need: chosen by the error that leaving it out makes in rendered pictures. N Gaussians."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.sensitivity import CODING_VARIANCE, Sensitivity
from airgs_codec.media.metrics import mse
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.usage import Usage

PICTURES = 4  # rendered at each step of a search
PRECISION = 0.01  # of the rows
_WIDEST = 255  # changes told apart, steps


@dataclass(frozen=True, slots=True, eq=False)
class Needed:
    """Rows that are written, and what leaving the others out costs."""

    rows: NDArray[np.intp]  # ascending
    error: float  # mean squared error of pictures without the others


def importance(frames: Sequence[Gaussians], usage: Usage, s: Sensitivity) -> NDArray[np.float64]:
    """(N,) rank of a row among those that pictures could do without; 0: in no picture.

    A picture is linear in each alpha, so alpha^2 times the squared derivative is exactly the error of leaving one row
    out. Rows that stand in for each other look cheap one by one; their blending weights (max and sum) keep them.
    """
    squares = np.mean([g.opacities().astype(np.float64) ** 2 for g in frames], axis=0)
    return usage.peak * usage.total * s.opacity * squares


def in_turn(frames: Sequence[Gaussians], cameras: Sequence[Camera]) -> list[tuple[Gaussians, Camera]]:
    """At most PICTURES cameras, each with a frame, the frames in turn."""
    chosen = [cameras[i] for i in evenly_spaced(len(cameras), PICTURES)]
    return list(zip(itertools.cycle(frames), chosen, strict=False))


class Removal:
    """All but the least important rows of some frames: as many as pictures can do without."""

    def __init__(self, frames: Sequence[Gaussians], cameras: Sequence[Camera], rank: NDArray[np.float64]) -> None:
        """`rank` of `importance`."""
        self._seen = [(g, camera, render(g, camera).rgb) for g, camera in in_turn(frames, cameras)]
        self._order = np.argsort(rank, kind="stable")
        unused = int(np.count_nonzero(rank == 0))
        self._errors = {unused if unused < len(rank) else 0: 0.0}  # of leaving out so many

    def needed(self, allowed: float) -> Needed:
        """Rows without those that pictures lose at a root mean squared error `allowed`.

        The count is found by bisection to PRECISION. Rows of rank 0 are left out at any price, unless that is all.
        """
        low = max(count for count, error in self._errors.items() if error <= allowed**2)
        high = min((count for count in self._errors if count > low), default=len(self._order))
        while allowed > 0 and high - low > max(1, PRECISION * len(self._order)):
            middle = (low + high) // 2
            if self._error(middle) <= allowed**2:
                low = middle
            else:
                high = middle
        return Needed(np.sort(self._order[low:]), self._errors[low])

    def _error(self, count: int) -> float:
        kept = np.sort(self._order[count:])
        errors = [mse(render(g.take(kept), camera).rgb, full) for g, camera, full in self._seen]
        return self._errors.setdefault(count, float(np.mean(errors)))


def affordable(
    sizes: NDArray[np.float64],
    guesses: NDArray[np.float64],
    error: Callable[[NDArray[np.bool_]], float],
    price: float,
) -> tuple[NDArray[np.bool_], float]:
    """Which of (c,) things to leave out, and the error that makes in rendered pictures.

    `sizes` in bytes a frame, `guesses` of the errors, which rank the things; `error` renders without some of them. As
    many go as cost at most half of `price`, squared error a byte, together, so that the last one pays as well; none if
    the price is 0.
    """
    order = np.argsort(guesses - price * sizes, kind="stable")
    chosen, cost = np.zeros(len(sizes), bool), 0.0
    most = int(np.count_nonzero(guesses < price * sizes))
    while most:
        trial = np.isin(np.arange(len(sizes)), order[:most])
        trial_cost = error(trial)
        if trial_cost <= price / 2 * float(sizes[trial].sum()):
            return trial, trial_cost
        most //= 2
    return chosen, cost


def guess_channels(
    values: NDArray[np.float64], centres: NDArray[np.float64], weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bytes that each of the channels (T, c, n) takes, and the error if it were its centre (c,) in place; in steps.

    Bytes are the zero-order entropy of the first picture and of the changes after it: H.264 does a little better.
    The error is the mean squared one of pictures, to first order, `weights` (c, n) of a squared step. It takes rows as
    independent: neighbours that change alike make more, so it only ranks.
    """
    sizes, errors = np.empty(len(centres)), np.empty(len(centres))
    for c, weight in enumerate(weights):
        v = values[:, c] - centres[c]
        errors[c] = max(0.0, float(np.square(v).mean(axis=0) @ weight) - CODING_VARIANCE * float(weight.sum()))
        whole = np.rint(v)
        sizes[c] = _entropy_bytes(whole[:1]) + _entropy_bytes(np.diff(whole, axis=0))
    return sizes, errors


def _entropy_bytes(whole: NDArray[np.float64]) -> float:
    if not whole.size:
        return 0.0
    counts = np.bincount((np.clip(whole, -_WIDEST, _WIDEST) + _WIDEST).astype(np.intp).ravel())
    share = counts[counts > 0] / whole.size
    return float(-(share * np.log2(share)).sum()) * whole.size / 8
