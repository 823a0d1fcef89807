"""Access links over traces behind one shared link: a group of flows whose bits pass at the smaller of two rates.

Every flow has the rate of its viewer's trace, or the fair level of the shared link where that is less. The level is
max-min fair (Bertsekas and Gallager, Data Networks, 6.5.2): the same for all flows that it limits, and such that
together they fill the link. It is held for a tick; within a tick traces are integrated exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from airgs_codec.play.trace import Trace

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Traces(NamedTuple):
    """K traces in one table, each repeated for ever."""

    starts_s: FloatArray  # of all periods of all traces
    rates_bps: FloatArray  # the same
    first: IntArray  # (K + 1,) period that each begins with
    duration_s: FloatArray  # (K,)

    @staticmethod
    def of(traces: Sequence[Trace]) -> Traces:
        """The table of some traces."""
        return Traces(
            np.concatenate([t.starts_s for t in traces]),
            np.concatenate([t.rates_bps for t in traces]),
            np.cumsum([0, *(len(t.starts_s) for t in traces)]),
            np.array([t.duration_s for t in traces]),
        )


class Flows(NamedTuple):
    """N viewers, each with at most one flow."""

    trace: IntArray  # (N,) which trace a viewer has
    shift_s: FloatArray  # (N,) what to add to the time for the time in the trace
    left_bits: FloatArray  # (N,) that are at the edge and have not passed
    at_s: FloatArray  # (N,) how far a flow has been followed
    stop_s: FloatArray  # (N,) when it stands still until somebody has looked at it

    @staticmethod
    def idle(trace: IntArray, shift_s: FloatArray) -> Flows:
        """Nobody asks for anything yet."""
        count = len(trace)
        return Flows(trace, shift_s, np.zeros(count), np.zeros(count), np.full(count, np.inf))


@njit(cache=True)  # type: ignore[misc, unused-ignore]
def period(traces: Traces, trace: int, at_s: float) -> tuple[float, float]:
    """(bit/s at a time of a trace, seconds that it goes on)."""
    length = traces.duration_s[trace]
    rest = at_s % length
    low, high = traces.first[trace], traces.first[trace + 1]
    end = high
    while high - low > 1:
        middle = (low + high) // 2
        if traces.starts_s[middle] <= rest:
            low = middle
        else:
            high = middle
    until = traces.starts_s[low + 1] if low + 1 < end else length
    return traces.rates_bps[low], until - rest


@njit(cache=True)  # type: ignore[misc, unused-ignore]
def water_level(caps: FloatArray, capacity: float) -> float:
    """The max-min fair rate of flows that share a link, each with a cap of its own; infinite where all caps fit."""
    if caps.sum() <= capacity:
        return np.inf
    room = max(capacity, 0.0)
    order = np.sort(caps)
    for k in range(len(order)):
        share = room / (len(order) - k)
        if order[k] >= share:
            return share
        room -= order[k]
    return np.inf


@njit(cache=True)  # type: ignore[misc, unused-ignore]
def fair_level(flows: Flows, traces: Traces, active: IntArray, at_s: float, capacity_bps: float) -> float:
    """bit/s that a flow has at most, so that all active ones share a link fairly."""
    caps = np.empty(len(active))
    for k in range(len(active)):
        i = active[k]
        caps[k] = period(traces, flows.trace[i], at_s + flows.shift_s[i])[0]
    return water_level(caps, capacity_bps)


@njit(cache=True)  # type: ignore[misc, unused-ignore]
def follow(flows: Flows, traces: Traces, i: int, until_s: float, level_bps: float) -> float:
    """Let the bits of a flow pass until a time, or until it stops or has none left; gives how many passed."""
    stop, at, left = min(until_s, flows.stop_s[i]), flows.at_s[i], flows.left_bits[i]
    before = left
    while at < stop and left > 0:
        rate, seconds = period(traces, flows.trace[i], at + flows.shift_s[i])
        end = min(at + max(seconds, 1e-9), stop)
        rate = min(rate, level_bps)
        if rate * (end - at) >= left:
            at, left = at + left / rate, 0.0
        else:
            left -= rate * (end - at)
            at = end
    flows.at_s[i], flows.left_bits[i] = at, left
    return before - left


@njit(cache=True)  # type: ignore[misc, unused-ignore]
def follow_all(flows: Flows, traces: Traces, active: IntArray, until_s: float, level_bps: float) -> float:
    """`follow` for every active flow; gives the bits of all."""
    passed = 0.0
    for k in range(len(active)):
        passed += follow(flows, traces, active[k], until_s, level_bps)
    return passed


class SharedLink:
    """The access links of all viewers behind one link of `capacity_bps` (infinite: no such link).

    What a tick lets pass too much, since flows begin within it, the next one has less, and one that was not used up
    leaves at most a tick's worth to the next. Times are seconds of the simulation.
    """

    def __init__(self, flows: Flows, traces: Traces, capacity_bps: float, tick_s: float) -> None:
        self.flows, self.traces = flows, traces
        self.capacity_bps, self.tick_s = capacity_bps, tick_s
        self.level_bps = np.inf
        self.until_s = 0.0  # end of the tick
        self.passed_bits = 0.0  # in all
        self._room_bits = 0.0

    def tick(self, at_s: float) -> IntArray:
        """Begin the tick at a time: set the level and follow all flows to its end; gives those that have none left."""
        active = np.flatnonzero(self.flows.left_bits > 0)
        self.until_s = at_s + self.tick_s
        if np.isfinite(self.capacity_bps):
            worth = self.capacity_bps * self.tick_s
            self._room_bits = min(self._room_bits, worth) + worth
            room_bps = max(self._room_bits, 0.0) / self.tick_s
            self.level_bps = float(fair_level(self.flows, self.traces, active, at_s, room_bps))
        self._count(float(follow_all(self.flows, self.traces, active, self.until_s, self.level_bps)))
        return active[self.flows.left_bits[active] <= 0]

    def go_on(self, viewer: int) -> bool:
        """Follow one flow to the end of the tick; whether it has none left."""
        self._count(float(follow(self.flows, self.traces, viewer, self.until_s, self.level_bps)))
        return bool(self.flows.left_bits[viewer] <= 0)

    def _count(self, bits: float) -> None:
        self.passed_bits += bits
        self._room_bits -= bits
