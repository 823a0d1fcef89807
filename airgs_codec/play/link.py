"""One connection over a trace: a request waits a round trip, then its bytes pass at the trace's rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.play.trace import Trace

DEFAULT_RTT_S = 0.08  # median ping of LTE driving measurements
LONGEST_S = 86_400.0  # of one batch: a stall is counted in frames, and those of years fill the memory


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Files of one batch are requested together: they share a round trip, and then the link in equal parts.

    Raises ConfigError for a round trip that is negative, infinite or no number.
    """

    trace: Trace
    rtt_s: float = DEFAULT_RTT_S

    def __post_init__(self) -> None:
        if not 0 <= self.rtt_s < math.inf:
            raise ConfigError(f"round trip: expected 0 s or more, got {self.rtt_s:g}")

    @staticmethod
    def over(trace: Trace, rtt_s: float | None = None) -> Link:
        """A link with the round trip that is given, else the trace's own, else DEFAULT_RTT_S."""
        known = trace.rtt_s if rtt_s is None else rtt_s
        return Link(trace, DEFAULT_RTT_S if known is None else known)

    def arrival_s(self, wire_bytes: float, at_s: float) -> float:
        """When the last byte of a batch arrives that is requested at `at_s`. Raises TransportError as `passed_s`."""
        return self.passed_s(wire_bytes, at_s + self.rtt_s)

    def passed_s(self, wire_bytes: float, first_s: float) -> float:
        """When the last byte of a batch has passed whose first one passes at `first_s`.

        Raises TransportError for a trace that ends too soon, and for a batch that takes longer than LONGEST_S.
        """
        end_s = self.trace.arrival_s(wire_bytes, first_s)
        if not end_s - first_s <= LONGEST_S:
            took = f"{wire_bytes:.0f} bytes would take {end_s - first_s:.3g} s"
            raise TransportError(f"{self.trace.name}: {took}, expected at most {LONGEST_S:g} s")
        return end_s

    def bytes_between(self, start_s: float, stop_s: float) -> float:
        """How many bytes can pass from one moment to another."""
        return max(0.0, self.trace.bits_until(stop_s) - self.trace.bits_until(start_s)) / 8
