"""What happens in a session, as values, and where batches come from: the seam between a player and a link.

Only a downloader knows time and bytes; the player learns both from what it returns, and yields events. A link is
simulated here; `http.HttpDownloader` is the other implementation. Times are seconds from the first request.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol, TypeVar

from airgs_codec.errors import FormatError
from airgs_codec.play.ladder import Decision
from airgs_codec.play.offers import Batch, Offers
from airgs_codec.play.trace import Link

CHECK_S = 0.5  # between looks at a download, and before the first one


class BatchKind(StrEnum):
    """What a batch was requested for; the values are the names in reports."""

    TABLES = "tables"  # airgs.json, pages of the index and tables of groups
    GROUP = "group"  # the next segment, with keyframes of its group
    DELTA = "delta"  # the next segment, whose keyframes are decoded
    REPLACEMENT = "replacement"  # a better rung of a buffered segment


@dataclass(frozen=True, slots=True)
class Request:
    kind: BatchKind
    position: int  # of the segment in the session
    rung: int
    batch: Batch
    sent_s: float  # no earlier than this
    latency_s: float  # from then, or from the end of the batch before if that is later, to the first byte


@dataclass(frozen=True, slots=True)
class Retry:
    """A faulty answer, after which a file was asked for again."""

    path: str
    why: str
    bytes: int  # of the answer, headers included


@dataclass(frozen=True, slots=True)
class Arrival:
    request: Request
    first_byte_s: float
    at_s: float  # of the last byte, or of giving up
    bytes: int  # that passed, headers included
    whole: tuple[str, ...]  # files that came whole and are what the tables say, in order
    refused: Mapping[str, FormatError]  # files that came and cannot be used
    abandoned: bool  # given up before the last byte
    retries: tuple[Retry, ...] = ()

    @property
    def complete(self) -> bool:
        return len(self.whole) == len(self.request.batch.files)

    @property
    def usable(self) -> tuple[str, ...]:
        """Return the files that can be used: a delta segment is dropped unless its batch is complete."""
        return self.whole if self.complete else tuple(p for p in self.whole if p not in self.request.batch.delta)


@dataclass(frozen=True, slots=True)
class Arrived:
    arrival: Arrival
    decision: Decision
    budget_bytes: float  # what the policies' rule of thumb would have spent
    throughput_bps: float  # the estimate when the batch was requested


@dataclass(frozen=True, slots=True)
class Replaced:
    position: int
    before: int  # rung
    after: int  # rung


@dataclass(frozen=True, slots=True)
class Lost:
    position: int
    at_s: float


@dataclass(frozen=True, slots=True)
class Cut:
    at_s: float
    why: str


@dataclass(frozen=True, slots=True)
class Displayed:
    """A segment's time on the screen; rung None: it was lost, the last picture stands."""

    segment: int  # in the package
    loop: int
    rung: int | None
    ready_s: float  # when it had arrived and was decoded
    start_s: float  # when its first frame was shown
    frames: int
    stall_s: float  # waited for it on the screen
    psnr: float | None  # dB; None: lost or not measured


Event = Arrived | Replaced | Lost | Cut | Displayed
Result = TypeVar("Result")
Steps = Generator[Event, None, Result]  # a part of a session, which ends with a result


@dataclass(frozen=True, slots=True)
class Partial:
    at_s: float
    elapsed_s: float  # since its first byte
    bytes: float  # so far, headers included
    expected_bytes: int


GiveUp = Callable[[Partial], bool]


class Downloader(Protocol):
    @property
    def rtt_s(self) -> float:
        """Return the seconds from a request to its first byte on an idle link."""

    @property
    def pipelines(self) -> bool:
        """Return whether a request may be sent before the previous batch has arrived."""

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        """Request a batch and wait for it. `give_up` is asked every CHECK_S whether to abandon it.

        Raises TransportError when the link fails.
        """


@dataclass(slots=True, eq=False)
class SimulatedDownloader:
    """A link that replays a trace. Time is that of the trace; no clock is read."""

    link: Link
    offers: Offers
    faults: Mapping[str, FormatError] = field(default_factory=dict)  # files that cannot be used
    pipelines: bool = True
    _free_s: float = 0.0  # when the last batch was over

    @property
    def rtt_s(self) -> float:
        return self.link.rtt_s

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        """See Downloader. Raises TransportError for a trace that ends too soon or is too slow."""
        sizes = {path: self._wire_size(path) for path in request.batch.files}
        first_s, expected = max(self._free_s, request.sent_s) + request.latency_s, sum(sizes.values())
        end_s, passed = self.link.arrival_s(expected, first_s), float(expected)
        stopped = next(filter(give_up, self._looks(first_s, end_s, expected)), None) if give_up else None
        if stopped is not None:
            end_s, passed = stopped.at_s, stopped.bytes
        self._free_s = end_s
        came = [f for f, size in sizes.items() if sum(min(size, other) for other in sizes.values()) <= passed]
        whole = tuple(path for path in came if path not in self.faults)
        refused = {path: self.faults[path] for path in came if path in self.faults}
        return Arrival(request, first_s, end_s, max(1, round(passed)), whole, refused, stopped is not None)

    def _looks(self, first_s: float, end_s: float, expected: int) -> Iterator[Partial]:
        for look in itertools.count(1):
            at_s = first_s + CHECK_S * look
            if at_s >= end_s:
                return
            yield Partial(at_s, at_s - first_s, self.link.bytes_between(first_s, at_s), expected)

    def _wire_size(self, path: str) -> int:
        """Return the bytes of a file with its headers; only the headers of a missing one."""
        missing = path in self.faults and self.faults[path].reason == "missing_file"
        return self.offers.header_bytes if missing else self.offers.wire_bytes([path])
