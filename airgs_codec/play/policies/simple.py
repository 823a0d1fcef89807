"""Policies that look at one number, what the throughput estimate sustains or the buffer; and those that know the trace.

The latter are yardsticks; see `bound`.
"""

from __future__ import annotations

import numpy as np

from airgs_codec.play.bound import Horizon, Slot, solve_horizon
from airgs_codec.play.ladder import Decision, select
from airgs_codec.play.policies.state import RESERVE_S, SAFETY, PlayerState, estimate_throughput, full_ladder
from airgs_codec.play.trace import Link


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


def choose_oracle_frame(state: PlayerState, link: Link) -> Decision:
    """The paper's integer programme with the true bandwidth: the best that fits the next segment's length of time."""
    first_s = state.now_s + state.request_latency_s
    budget = link.bytes_between(first_s, state.now_s + max(state.segment_s, state.request_latency_s))
    return select(full_ladder(state), budget)


def choose_oracle_lp(state: PlayerState, link: Link) -> Decision:
    """The rung that the linear programme over all that comes gives most of this segment to; it knows the trace."""
    horizon = upcoming_horizon(state, link)
    schedule = solve_horizon(horizon)
    if schedule is None:
        return select(full_ladder(state), 0.0)
    wanted = int(schedule.rungs[0].argmax())
    chosen = next((p for p in state.options if p.index == wanted), None)
    if chosen is None:
        return select(full_ladder(state), schedule.first_bytes)
    return Decision(wanted, True, f"planned for {len(horizon.slots)} segments", chosen.size_bytes)


def upcoming_horizon(state: PlayerState, link: Link) -> Horizon:
    """Return what is to come: shown without a stall from the deadline of the next segment on, at most two buffers long.

    A pipelined player requests a segment one round trip before the link is free, so that only the wait for room in
    the buffer costs a round trip. Otherwise the link is idle for a round trip before every segment; the bytes that it
    could have carried in that time are taken at the trace's mean rate.
    """
    slots = []
    first_byte_s = state.now_s + state.request_latency_s
    start_s = first_start_s = max(state.deadline_s, first_byte_s)
    for offer, _ in state.upcoming():
        end_s = start_s + offer.seconds
        release_s = max(first_byte_s, end_s - state.buffer_limit_s + link.rtt_s)
        slots.append(Slot(offer, link.bytes_between(0.0, release_s), link.bytes_between(0.0, start_s)))
        start_s = end_s
        if start_s > first_start_s + 2 * state.buffer_limit_s:
            break
    idle_bytes = 0.0 if state.pipelined else link.rtt_s * link.trace.mean_bps / 8
    return Horizon(tuple(slots), state.decoded, idle_bytes)
