"""One connection over a trace: a request waits a round trip, then its bytes pass at the trace's rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from airgs_codec.play.trace import Trace

DEFAULT_RTT_S = 0.08  # median ping of LTE driving measurements
HEADER_BYTES = 350  # HTTP response headers a file


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Files of one batch share a round trip."""

    trace: Trace
    rtt_s: float = DEFAULT_RTT_S
    header_bytes: int = HEADER_BYTES

    def wire_bytes(self, sizes: Sequence[int]) -> int:
        """Bytes of a batch with their headers."""
        return sum(sizes) + self.header_bytes * len(sizes)

    def arrival_s(self, sizes: Sequence[int], at_s: float) -> float:
        """When the last byte of a batch requested at `at_s` is there."""
        return self.trace.arrival_s(self.wire_bytes(sizes), at_s + self.rtt_s)
