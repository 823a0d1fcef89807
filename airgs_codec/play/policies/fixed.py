"""Always the same rung, as a reference."""

from __future__ import annotations

from airgs_codec.play.ladder import Decision
from airgs_codec.play.policies.state import PlayerState


def choose_fixed(state: PlayerState, rung: int) -> Decision:
    """One rung for every segment; the smallest one where it cannot be had."""
    chosen = next((p for p in state.options if p.index == rung), None)
    chosen = chosen or min(state.options, key=lambda p: p.size_bytes)
    return Decision(chosen.index, True, "fixed", chosen.size_bytes)
