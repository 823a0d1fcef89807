"""Policies that look at one number: always the same rung, or what the throughput estimate sustains."""

from __future__ import annotations

from airgs_codec.play.ladder import Decision, select
from airgs_codec.play.policies.state import SAFETY, PlayerState, estimate_throughput, full_ladder


def choose_fixed(state: PlayerState, rung: int) -> Decision:
    """One rung for every segment; the smallest one where it cannot be had."""
    chosen = next((p for p in state.options if p.index == rung), None)
    chosen = chosen or min(state.options, key=lambda p: p.size_bytes)
    return Decision(chosen.index, True, "fixed", chosen.size_bytes)


def choose_throughput(state: PlayerState) -> Decision:
    """The best rung within SAFETY * B over the segment's own length, whatever is buffered."""
    return select(full_ladder(state), SAFETY * estimate_throughput(state.history) * state.segment_s / 8)
