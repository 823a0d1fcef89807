"""Algorithm 1 of the paper (arXiv 2512.20943) with its cases defined, and as printed; each with and without the cliff.

The cliff test (lines 1 to 11) says how far a level space is worth going down, whatever the link carries; the search
(lines 12 to 25) takes the best of what is left that fits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from airgs_codec.errors import ConfigError
from airgs_codec.play.ladder import DEFAULT_BETA, Decision, Option, select
from airgs_codec.play.policies.state import (
    PlayerState,
    before_cliff,
    budget_bytes,
    estimate_throughput,
    full_ladder,
)


def choose_paper(state: PlayerState) -> Decision:
    """Algorithm 1 over the measured sizes and qualities of this very segment."""
    return choose_paper_no_cliff(before_cliff(state))


def choose_paper_no_cliff(state: PlayerState) -> Decision:
    """The search of Algorithm 1 alone: the best rung that fits."""
    return select(full_ladder(state), budget_bytes(state))


def choose_paper_literal(state: PlayerState, beta: float = DEFAULT_BETA) -> Decision:
    """Algorithm 1 as printed: C = B / R over the segment, no buffer, round trip or safety; undefined: the last level.

    Its levels are the rungs with the finest keys, whole group keys in the sizes.
    """
    levels = [p for p in state.options if state.offer.rungs[p.index].quality == 0] or list(state.options)
    budget = frame_budget(estimate_throughput(state.history), 1 / state.segment_s)
    answer = select_literal(levels, budget, beta)
    chosen = levels[-1 if answer is None else answer]
    reason = "Algorithm 1 leaves it undefined" if answer is None else f"Algorithm 1 for {budget:.0f} B"
    return Decision(chosen.index, chosen.size_bytes <= budget, reason, chosen.size_bytes)


def choose_paper_literal_no_cliff(state: PlayerState) -> Decision:
    """The same where no drop is a cliff."""
    return choose_paper_literal(state, math.inf)


def select_literal(options: Sequence[Option], budget_bytes: float, beta: float = DEFAULT_BETA) -> int | None:
    """Algorithm 1 as it is printed, over options in the order of their levels; None where it leaves p undefined.

    A step is q[i] - q[i-1], negative where quality falls. Divisions are IEEE: 0 / 0 is no number and never above beta,
    and a fall after a step of 0 is -infinity, so that the cliff is missed there. When nothing fits, the answer is the
    cliff's level, whatever its size; see `ladder` for what `select` does. Raises ConfigError without options.
    """
    if not options:
        raise ConfigError("Algorithm 1: expected at least one level, got none")
    rungs, answer = [0], None
    previous = options[1].quality - options[0].quality if len(options) > 1 else 0.0
    for i in range(1, len(options)):
        drop = options[i].quality - options[i - 1].quality
        if _ratio(drop, previous) > beta:
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


def _ratio(a: float, b: float) -> float:
    if b:
        return a / b
    return math.nan if a == 0 or math.isnan(a) else math.copysign(math.inf, a)


def frame_budget(bandwidth_bps: float, fps: float) -> float:
    """Bytes a frame may have: the paper's C = B / R with its units.

    A bandwidth that is negative or no number counts as 0 (12). Raises ConfigError unless fps > 0.
    """
    if not fps > 0:
        raise ConfigError(f"frame rate: expected more than 0, got {fps}")
    return bandwidth_bps / (8 * fps) if bandwidth_bps > 0 else 0.0
