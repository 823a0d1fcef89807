"""Algorithm 1 of the paper (arXiv 2512.20943) with its cases defined, and as printed."""

from __future__ import annotations

from airgs_codec.play.ladder import Decision, frame_budget, select, select_literal
from airgs_codec.play.policies.state import PlayerState, budget_bytes, estimate_throughput, full_ladder


def choose_paper(state: PlayerState) -> Decision:
    """Algorithm 1 over the measured sizes and qualities of this very segment."""
    return select(full_ladder(state), budget_bytes(state))


def choose_paper_literal(state: PlayerState) -> Decision:
    """Algorithm 1 as printed: C = B / R over the segment, no buffer, round trip or safety; undefined: the last level.

    Its levels are the rungs with the finest keys, whole group keys in the sizes.
    """
    levels = [p for p in state.options if p.index < len(state.catalogue.manifest.levels)] or list(state.options)
    budget = frame_budget(estimate_throughput(state.history), 1 / state.segment_s)
    answer = select_literal(levels, budget)
    chosen = levels[-1 if answer is None else answer]
    reason = "Algorithm 1 leaves it undefined" if answer is None else f"Algorithm 1 for {budget:.0f} B"
    return Decision(chosen.index, chosen.size_bytes <= budget, reason, chosen.size_bytes)
