"""The paper's level selection (arXiv 2512.20943, Algorithm 1), with its undefined cases defined, and as printed.

Where Algorithm 1 divides by zero, returns a level that does not fit or leaves its answer undefined, comments name the
case: first drop zero (1, 2), tiny (3), quality that rises when pruning (4), slow slides (5), the first level (6),
nothing fits (7, 8), sizes that do not fall (9), one level or none (10), NaN and infinite quality (11), bad budgets
(12), units (13: everything here is bytes), the level that sends nothing (14: not in a ladder), keyframes (15: chosen
over the buffer, see session), level 0 (16: no different from the others).
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.media.metrics import PSNR_CAP

DEFAULT_BETA = 2.0  # the paper's cliff multiplier
CLIFF_DB = 3.0  # drop from the best level to the next that is a cliff
EPS_DB = 0.25  # least mean drop: with DEFAULT_BETA, half a dB per 10 % is no cliff (a player fetches nothing for less)


@dataclass(frozen=True, slots=True)
class Option:
    """One of the things that can be chosen: its size in bytes on the wire and the quality that it shows."""

    index: int  # in the caller's list, such as a level or a rung
    size_bytes: int
    quality: float  # dB
    saved: float  # share of the best level's bytes that its level saves, 0..1; 0 where that is unknown


@dataclass(frozen=True, slots=True)
class Decision:
    index: int  # of the option
    fits: bool = True  # whether it is within the budget
    reason: str = ""  # in words, for people
    size_bytes: int = 0


def build_ladder(options: Iterable[Option], beta: float = DEFAULT_BETA) -> tuple[Option, ...]:
    """Return the options whose size and quality both fall strictly, from the best to the last before the cliff.

    Pareto filter, then the cliff test. The paper's levels are 10 % of the updates apart. Those of packages are not, and
    save by coarser steps as well; so drops are counted per 10 % of the bytes saved, over at least one such step from
    level to level. A level is past the cliff when its drop exceeds `beta` times the mean of the earlier drops (at least
    EPS_DB), or, for the first level, CLIFF_DB; no drop is a cliff where beta is inf. O(n log n).
    Raises ConfigError: no options (10), beta <= 1 (6), a size or quality that is no number (11).
    """
    if not beta > 1:
        raise ConfigError(f"cliff multiplier: expected more than 1, got {beta}")
    checked: list[Option] = []
    for p in options:
        if math.isnan(p.quality) or p.size_bytes < 0:
            raise ConfigError(f"level {p.index}: expected a size and a quality, got {p}")
        checked.append(Option(p.index, p.size_bytes, min(p.quality, PSNR_CAP), p.saved))
    if not checked:
        raise ConfigError("ladder: expected at least one level, got none")
    front: list[Option] = []  # those that no other beats or equals at fewer bytes, best first (4, 9)
    for option in sorted(checked, key=lambda p: (p.size_bytes, -p.quality, p.index)):
        if not front or option.quality > front[-1].quality:
            front.append(option)
    front.reverse()
    if beta == math.inf:
        return tuple(front)
    ladder = front[:1]
    steps = 0.0  # of 10 %, from the best level to the last one chosen
    for previous, option in itertools.pairwise(front):
        tenths = max(1.0, 10 * (option.saved - previous.saved))
        drop = (previous.quality - option.quality) / tenths
        mean = max(EPS_DB, (front[0].quality - previous.quality) / steps) if steps else None
        if drop > CLIFF_DB if mean is None else drop / mean > beta:
            break
        ladder.append(option)
        steps += tenths
    return tuple(ladder)


def select(ladder: Sequence[Option], budget_bytes: float) -> Decision:
    """Choose the best level of a ladder that fits; if none does, the smallest, with fits=False (7, 8). O(log n).

    A budget that is negative or no number counts as 0 (12).
    """
    budget = budget_bytes if budget_bytes > 0 else 0.0
    at = bisect_left(ladder, -budget, key=lambda p: -p.size_bytes)
    if at == len(ladder):
        last = ladder[-1]
        return Decision(last.index, False, f"nothing fits {budget:.0f} B, taking the smallest", last.size_bytes)
    chosen = ladder[at]
    return Decision(chosen.index, True, f"{chosen.size_bytes} B fit {budget:.0f} B", chosen.size_bytes)


def saved_shares(sizes: Sequence[float]) -> list[float]:
    """Return the share of the first level's bytes that each level saves; 0 where it saves none."""
    best = sizes[0]
    return [max(0.0, 1 - size / best) if best > 0 else 0.0 for size in sizes]


def select_literal(options: Sequence[Option], budget_bytes: float, beta: float = DEFAULT_BETA) -> int | None:
    """Run Algorithm 1 as printed, over options in the order of their levels; None where it leaves p undefined.

    A step is q[i] - q[i-1], negative where quality falls. Divisions are IEEE: 0 / 0 is no number and never above beta,
    and a fall after a step of 0 is -infinity, so that this cliff is missed. When nothing fits, the answer is the
    cliff's level, whatever its size, unlike in `select`. Raises ConfigError without options.
    """
    if not options:
        raise ConfigError("Algorithm 1: expected at least one level, got none")
    rungs, answer = [0], None
    previous = options[1].quality - options[0].quality if len(options) > 1 else 0.0
    for i in range(1, len(options)):
        drop = options[i].quality - options[i - 1].quality
        with np.errstate(all="ignore"):
            is_cliff = np.divide(drop, previous) > beta
        if is_cliff:
            answer = i
            break
        rungs.append(i)
        previous = drop
    low, high = 0, len(rungs) - 1
    while low <= high:
        middle = (low + high) // 2
        if options[rungs[middle]].size_bytes <= budget_bytes:
            answer, high = rungs[middle], middle - 1
        else:
            low = middle + 1
    return answer


def frame_budget(bandwidth_bps: float, fps: float) -> float:
    """Return the bytes that a frame may have: the paper's C = B / R with its units.

    A bandwidth that is negative or no number counts as 0 (12). Raises ConfigError unless fps > 0.
    """
    if not fps > 0:
        raise ConfigError(f"frame rate: expected more than 0, got {fps}")
    return bandwidth_bps / (8 * fps) if bandwidth_bps > 0 else 0.0
