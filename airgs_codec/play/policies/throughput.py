"""What the throughput estimate sustains, whatever is buffered."""

from __future__ import annotations

from airgs_codec.play.ladder import Decision, select
from airgs_codec.play.policies.state import SAFETY, PlayerState, estimate_throughput, full_ladder


def choose_throughput(state: PlayerState) -> Decision:
    """The best rung within SAFETY * B over the segment's own length."""
    return select(full_ladder(state), SAFETY * estimate_throughput(state.history) * state.segment_s / 8)
