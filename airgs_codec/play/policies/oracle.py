"""Policies that know the trace, as yardsticks; see `bound`."""

from __future__ import annotations

from airgs_codec.play.bound import Horizon, Slot, solve_horizon
from airgs_codec.play.ladder import Decision, select
from airgs_codec.play.policies.state import PlayerState, full_ladder
from airgs_codec.play.trace import Link


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
