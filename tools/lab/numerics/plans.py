"""The selector at the ends of its numbers: programmes over rates, sizes and qualities.

K slots, L levels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play import bound
from airgs_codec.play.bound import Horizon, Slot, solve_horizon
from airgs_codec.play.offers import RungOffer, SegmentOffer
from tools.lab.numerics.outcome import BOUNDED, DIVERGES, EXACT, NOT_FINITE, UNFIT, Judged

SLOTS, LEVELS = 8, 4
GAP_DB = 0.01  # what docs/numerics.md says the relaxation is above the integers at most, in what was measured
TOO_LATE = "the smallest rungs come too late"


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """What is offered in K slots of a second, each a group of its own without keys."""

    sizes: NDArray[np.float64]  # (K, L) bytes, descending
    quality: NDArray[np.float64]  # (K, L) dB

    def horizon(self, capacities: NDArray[np.float64]) -> Horizon:
        """All slots, released at once, with (K,) bytes that the link has carried at their deadlines."""
        return Horizon(tuple(Slot(self._segment(k), 0.0, float(c)) for k, c in enumerate(capacities)))

    def _segment(self, k: int) -> SegmentOffer:
        rungs = tuple(
            RungOffer(0, level, float(quality), math.nan, 0, True, 0.0, (), (), int(size))
            for level, (size, quality) in enumerate(zip(self.sizes[k], self.quality[k], strict=True))
        )
        return SegmentOffer(k, 1.0, k, None, True, rungs)


def offer(kind: str, rate_bps: float) -> tuple[Offer, NDArray[np.float64]]:
    """An offer of a kind, and what a link of a rate has carried at each deadline."""
    rng = np.random.default_rng(0)
    largest = np.full(SLOTS, 1e5)
    if kind == "tiny and huge segments":
        largest = 10.0 ** rng.uniform(2, 8, SLOTS)
    if kind == "sizes grow with the rate":
        largest = np.full(SLOTS, rate_bps / 8)
    shares = np.sort(rng.uniform(0.3, 1.5, (SLOTS, LEVELS)), axis=1)[:, ::-1]
    quality = np.sort(rng.uniform(30, 45, (SLOTS, LEVELS)), axis=1)[:, ::-1]
    if kind == "equal qualities":
        quality = np.full((SLOTS, LEVELS), 40.0)
    rates = np.full(SLOTS, rate_bps / 8)
    if kind == "outages":
        rates[1::2] = 0.0
    sizes = np.maximum(1.0, np.round(largest[:, None] * shares))
    return Offer(sizes, quality), np.cumsum(rates)


KINDS = ("even segments", "tiny and huge segments", "equal qualities", "outages", "sizes grow with the rate")


def solved(kind: str, rate_bps: float) -> Judged:
    """Return how the linear and the integer programme end: gap in dB."""
    what, capacities = offer(kind, rate_bps)
    horizon = what.horizon(capacities)
    relaxed, whole = (solve_horizon(horizon, integer) for integer in (False, True))
    fits = bool((np.cumsum(what.sizes[:, -1]) <= capacities).all())
    if relaxed is None or whole is None:
        wrong = fits or (relaxed is None and whole is not None)
        return (DIVERGES, np.nan, "a plan that fits is refused") if wrong else (UNFIT, np.nan, TOO_LATE)
    chosen = whole.rungs.argmax(axis=1)
    spent = np.cumsum(what.sizes[np.arange(SLOTS), chosen])
    gap = relaxed.quality - whole.quality
    if not np.isfinite(gap):
        return NOT_FINITE, gap, ""
    if (spent > capacities * (1 + 2 * bound.ROUNDING) + 1e-3).any() or gap < -1e-6:
        return DIVERGES, gap, f"{float((spent / capacities).max()):.9f} of the capacity is spent"
    return (EXACT if gap <= GAP_DB else BOUNDED), gap, f"the relaxation is {gap:.2g} dB above the integers"


def judge_margin(margin: float, scale: float, tries: int = 12) -> Judged:
    """Share of sessions that the link just carries and that are called impossible, or dB too much, at a margin.

    Sizes are of the order of `scale` bytes; a third of the rate makes sums of floats end just under or over them.
    """
    rng = np.random.default_rng(0)
    lost, above = 0, 0.0
    for _ in range(tries):
        sizes = np.round(scale * rng.uniform(0.5, 1.5, (SLOTS, 1)))
        what = Offer(np.hstack([1.1 * sizes, sizes]), np.tile([41.0, 40.0], (SLOTS, 1)))
        rate = scale / 3
        capacities = np.add.accumulate(sizes[:, 0] / rate) * rate
        with patch.object(bound, "ROUNDING", margin):
            found = solve_horizon(what.horizon(capacities))
        if found is None:
            lost += 1
        else:
            above = max(above, found.quality - 40.0)
    if lost:
        return DIVERGES, above, f"{lost} of {tries} sessions that took place are called impossible"
    return (EXACT if above <= GAP_DB else BOUNDED), above, f"at most {above:.2g} dB too much"
