"""Policies that look at one number: always the same rung, what the throughput estimate sustains, or the buffer."""

from __future__ import annotations

import numpy as np

from airgs_codec.play.ladder import Decision, select
from airgs_codec.play.policies.state import RESERVE_S, SAFETY, PlayerState, estimate_throughput, full_ladder


def choose_fixed(state: PlayerState, rung: int) -> Decision:
    """One rung for every segment; the smallest one where it cannot be had."""
    chosen = next((p for p in state.options if p.index == rung), None)
    chosen = chosen or min(state.options, key=lambda p: p.size_bytes)
    return Decision(chosen.index, True, "fixed", chosen.size_bytes)


def choose_throughput(state: PlayerState) -> Decision:
    """The best rung within SAFETY * B over the segment's own length, whatever is buffered."""
    return select(full_ladder(state), SAFETY * estimate_throughput(state.history) * state.segment_s / 8)


def choose_bola(state: PlayerState) -> Decision:
    """Choose the rung with the largest (V (u + g) - Q) / size: BOLA-BASIC (Spiteri et al., INFOCOM 2016).

    Utilities come from measured quality, sizes are those of each segment.
    u is quality in dB above the smallest rung (its unit cancels), Q the buffer in seconds. V and g are such that the
    smallest rung is left at RESERVE_S (a third of a smaller buffer) and the best one scores nothing when the buffer is
    full.
    """
    rungs = full_ladder(state).options
    if len(rungs) == 1:
        return Decision(rungs[0].index, True, "one rung", rungs[0].size_bytes)
    utility = [p.quality - rungs[-1].quality for p in rungs]
    smallest = rungs[-1].size_bytes
    limit = max(state.buffer_limit_s - state.segment_s, state.segment_s)
    reserve = min(RESERVE_S, limit / 3)
    bend = max(u * smallest / (p.size_bytes - smallest) for u, p in zip(utility, rungs[:-1], strict=False))
    v = (limit - reserve) / (utility[0] + bend)
    g = bend + reserve / v
    scores = [(v * (u + g) - state.buffer_s) / max(1, p.size_bytes) for u, p in zip(utility, rungs, strict=True)]
    chosen = rungs[int(np.argmax(scores))]  # the largest where all are under 0
    return Decision(chosen.index, True, f"buffer {state.buffer_s:.2f} s", chosen.size_bytes)
