"""Where batches come from: the seam between a player and a link, simulated or real.

A downloader alone knows time and bytes; the player learns both from what it returns. `http.HttpDownloader` is the
other implementation.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from airgs_codec.errors import FormatError
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.events import Arrival, Event, Request
from airgs_codec.play.link import Link

CHECK_S = 0.5  # a download is looked at so often, and given so long before the first look


@dataclass(frozen=True, slots=True)
class Partial:
    """A download under way."""

    at_s: float
    elapsed_s: float  # since its first byte
    bytes: float  # so far, headers included
    expected_bytes: int


GiveUp = Callable[[Partial], bool]


class Connection(Protocol):
    """What a player knows of the way that batches come by."""

    @property
    def rtt_s(self) -> float:
        """Seconds from a request to its first byte on an idle link."""

    @property
    def pipelines(self) -> bool:
        """Whether a request may be sent before the batch before it has arrived."""


class Downloader(Connection, Protocol):
    """Fetches one batch after another."""

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        """Request a batch and wait for it. `give_up` is asked every CHECK_S whether to abandon it.

        Raises TransportError when the link fails.
        """


@dataclass(frozen=True, slots=True)
class Wanted:
    """A batch that a player waits for; `give_up` is to be asked every CHECK_S whether to abandon it."""

    request: Request
    give_up: GiveUp | None


Result = TypeVar("Result")
Fetching = Generator[Event | Wanted, Arrival | None, Result]  # steps that end with a result
Steps = Fetching[None]


def answer(steps: Steps, downloader: Downloader) -> Iterator[Event]:
    """The events of a player whose batches a downloader fetches."""
    arrival: Arrival | None = None
    while True:
        try:
            step = steps.send(arrival)
        except StopIteration:
            return
        if isinstance(step, Wanted):
            arrival = downloader.fetch(step.request, step.give_up)
        else:
            arrival = None
            yield step


@dataclass(slots=True, eq=False)
class SimulatedDownloader:
    """A link that replays a trace. Time is that of the trace; no clock is read."""

    link: Link
    catalogue: Catalogue
    faults: Mapping[str, FormatError] = field(default_factory=dict)  # files that cannot be used
    pipelines: bool = True
    _free_s: float = 0.0  # when the last batch was over

    @property
    def rtt_s(self) -> float:
        """Round trip of the link in seconds."""
        return self.link.rtt_s

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        """See Downloader. Raises TransportError for a trace that ends too soon or is too slow."""
        files = request.batch.files
        sizes = [self._wire_size(path) for path in files]
        first_s, expected = max(self._free_s, request.sent_s) + request.latency_s, sum(sizes)
        end_s, passed = self.link.passed_s(expected, first_s), float(expected)
        stopped = next(filter(give_up, self._looks(first_s, end_s, expected)), None) if give_up else None
        if stopped is not None:
            end_s, passed = stopped.at_s, stopped.bytes
        self._free_s = end_s
        came = [f for f, size in zip(files, sizes, strict=True) if sum(min(size, other) for other in sizes) <= passed]
        return Arrival(
            request=request,
            first_byte_s=first_s,
            at_s=end_s,
            bytes=max(1, round(passed)),
            whole=tuple(path for path in came if path not in self.faults),
            refused={path: self.faults[path] for path in came if path in self.faults},
            abandoned=stopped is not None,
        )

    def _looks(self, first_s: float, end_s: float, expected: int) -> Iterator[Partial]:
        for look in itertools.count(1):
            at_s = first_s + CHECK_S * look
            if at_s >= end_s:
                return
            yield Partial(at_s, at_s - first_s, self.link.bytes_between(first_s, at_s), expected)

    def _wire_size(self, path: str) -> int:
        """Bytes of a file with its headers; of a missing one the headers alone."""
        missing = path in self.faults and self.faults[path].reason == "missing_file"
        return self.catalogue.wire_bytes([0 if missing else self.catalogue.file_bytes(path)])
