"""The selector at the ends of its numbers: programmes over rates, sizes and qualities, and whole sessions.

K slots, L levels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.package import open_package
from airgs_codec.play import bound
from airgs_codec.play.bound import Slot, solve_horizon
from airgs_codec.play.offers import Offers, RungOffer, SegmentOffer
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.session import session_bound, simulate
from airgs_codec.play.trace import Link, Trace
from tools.lab.numerics.outcome import BOUNDED, DIVERGES, EXACT, NOT_FINITE, UNFIT, Case, Judged, grid

PACKAGE = Path(__file__).parents[3] / "manifests" / "valid" / "moving"
SLOTS, LEVELS = 8, 4
GAP_DB = 0.01  # what docs/numerics.md says the relaxation is above the integers at most, in what was measured
POLICIES = ("robust-mpc", "bola", "throughput", "paper", "oracle-lp")
TOO_LATE = "the smallest rungs come too late"


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """What is offered in K slots of a second, each a group of its own without keyframes."""

    sizes: NDArray[np.float64]  # (K, L) bytes, descending
    quality: NDArray[np.float64]  # (K, L) dB

    def horizon(self, capacities: NDArray[np.float64]) -> list[Slot]:
        """All slots, released at once, with (K,) bytes that the link has carried at their deadlines."""
        return [Slot(self._segment(k), 0.0, float(c)) for k, c in enumerate(capacities)]

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
    relaxed, whole = (solve_horizon(horizon, integer=integer) for integer in (False, True))
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


def play_once(policy: str, rate_bps: float) -> Judged:
    """A session of 30 loops over a link of a constant rate: seconds of stall. Raises TransportError."""
    trace = Trace("const", np.zeros(1), np.array([rate_bps]), 1000.0)
    log = simulate(Offers.of(open_package(PACKAGE)), Link(trace), policy, SessionSettings(loops=30))
    m = log.metrics
    limit = session_bound(log)
    if not np.isfinite([log.mean_quality, m.stall_s]).all() or limit is None:
        return NOT_FINITE, m.stall_s, ""
    if log.mean_quality > limit + 1e-6:
        return DIVERGES, m.stall_s, f"{log.mean_quality:.6f} dB, above the bound of {limit:.6f} dB"
    if m.stall_s <= 0:
        return EXACT, 0.0, ""
    return BOUNDED, m.stall_s, f"waits {m.stall_s:.3g} s for {len(log.shown)} segments and shows all of them"


MARGINS = (0.0, 1e-15, 1e-12, 1e-9, bound.ROUNDING, 1e-5, 1e-3, 1e-2)
SCALES = ("1e2", "1e5", "1e8", "1e11")


def cases() -> list[Case]:
    return [
        Case(
            part="selector", name="selector-programmes", title="Programmes over rates", own=("programme", ""),
            points=grid(["programme"], KINDS, [10.0**e for e in (-3, 0, 2, 4, 5, 5.5, 6, 7, 9, 12, 15)]),
            judge=lambda panel, kind, rate: solved(kind, rate),
        ),
        Case(
            part="selector", name="selector-margin", title="Margin of capacities", own=("as it is", ""),
            points=grid(["as it is"], SCALES, [bound.ROUNDING]) + grid(["margins tried"], SCALES, MARGINS),
            judge=lambda panel, scale, margin: judge_margin(margin, float(scale)),
        ),
        Case(
            part="selector", name="selector-sessions", title="Sessions over rates", own=("session", ""),
            points=grid(["session"], POLICIES, [10.0**e for e in (-30, -9, -3, 2, 3, 4, 5, 6, 9, 12, 15, 18, 30)]),
            judge=lambda panel, policy, rate: play_once(policy, rate),
        ),
    ]  # fmt: skip
