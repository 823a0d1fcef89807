"""One connection over a trace: a request waits a round trip, then its bytes pass at the trace's rate."""

from __future__ import annotations

from dataclasses import dataclass

from airgs_codec.play.trace import Trace

DEFAULT_RTT_S = 0.08  # median ping of LTE driving measurements


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Files of one batch are requested together: they share a round trip and arrive one after another."""

    trace: Trace
    rtt_s: float = DEFAULT_RTT_S

    @staticmethod
    def over(trace: Trace, rtt_s: float | None = None) -> Link:
        """With the round trip that is given, else the trace's own, else DEFAULT_RTT_S."""
        known = trace.rtt_s if rtt_s is None else rtt_s
        return Link(trace, DEFAULT_RTT_S if known is None else known)

    def arrival_s(self, wire_bytes: float, at_s: float) -> float:
        """When the last byte of a batch requested at `at_s` is there."""
        return self.trace.arrival_s(wire_bytes, at_s + self.rtt_s)

    def bytes_between(self, start_s: float, stop_s: float) -> float:
        """What can pass from one moment to another."""
        return max(0.0, self.trace.bits_until(stop_s) - self.trace.bits_until(start_s)) / 8
