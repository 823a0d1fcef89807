"""Policies that know the trace, as yardsticks; see `bound`."""

from __future__ import annotations

from airgs_codec.play.bound import Horizon, solve_horizon
from airgs_codec.play.ladder import Decision, select
from airgs_codec.play.link import Link
from airgs_codec.play.policies.state import PlayerState, full_ladder


def choose_oracle_frame(state: PlayerState, link: Link) -> Decision:
    """The paper's integer programme with the true bandwidth: the best that fits the next segment's length of time."""
    first_s = state.now_s + state.request_latency_s
    budget = link.bytes_between(first_s, state.now_s + max(state.segment_s, state.request_latency_s))
    return select(full_ladder(state), budget)


def choose_oracle_lp(state: PlayerState, link: Link) -> Decision:
    """The rung that the linear programme over all that comes gives most of this segment to.

    It knows the trace; the round trip of every segment is taken off the capacity at the trace's mean rate.
    """
    deadline = max(state.deadline_s, state.now_s + state.request_latency_s)
    held = dict(state.decoded_tiers)
    horizon = Horizon.ahead(state.catalogue, link, state.position, state.end, held, deadline, state)
    plan = solve_horizon(horizon)
    if plan is None:
        return select(full_ladder(state), 0.0)
    wanted = int(plan.rungs[0].argmax())
    chosen = next((p for p in state.options if p.index == wanted), None)
    if chosen is None:
        return select(full_ladder(state), plan.first_bytes)
    return Decision(wanted, True, f"planned for {len(horizon.units)} segments", chosen.size_bytes)
