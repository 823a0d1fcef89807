"""Algorithm 1 of the paper (arXiv 2512.20943) with its cases defined, and as printed; each with and without the cliff.

The cliff test (lines 1 to 11) says how far a level space is worth going down, whatever the link carries; the search
(lines 12 to 25) takes the best of what is left that fits.
"""

from __future__ import annotations

import math

from airgs_codec.play.ladder import DEFAULT_BETA, Decision, frame_budget, select, select_literal
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
