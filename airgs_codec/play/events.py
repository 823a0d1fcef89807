"""What happens in a session, as values: requests, arrivals, and the events that a player yields.

Times are seconds from the first request.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from airgs_codec.errors import FormatError
from airgs_codec.play.ladder import Decision


class BatchKind(StrEnum):
    """What a batch was requested for; the values are the names in reports."""

    TABLES = "tables"  # airgs.json, pages of the index and tables of groups
    GROUP = "group"  # the next segment, with keys of its group
    STATE = "state"  # the next segment, whose keys are decoded
    REPLACEMENT = "replacement"  # a better rung of a buffered segment
    REPAIR = "repair"  # a tile that a buffered segment, or the one on the screen, lacks


@dataclass(frozen=True, slots=True)
class Batch:
    """Paths of the files that are requested together, in the order in which they arrive."""

    keys: tuple[str, ...] = ()
    state: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[str, ...]:
        """All paths: key units in their order, then the state segment, then tables for what comes next."""
        return self.keys + self.state + self.tables


@dataclass(frozen=True, slots=True)
class Request:
    """A batch of files to be fetched together."""

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
    """What came of a request."""

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
        """Whether every file can be used."""
        return len(self.whole) == len(self.request.batch.files)

    @property
    def kept(self) -> tuple[str, ...]:
        """The files that are of use: a state segment whose batch is not complete is dropped."""
        return self.whole if self.complete else tuple(p for p in self.whole if p not in self.request.batch.state)


@dataclass(frozen=True, slots=True)
class Arrived:
    """A batch arrived, whole or not."""

    arrival: Arrival
    decision: Decision
    budget_bytes: float  # what the policies' rule of thumb would have spent
    throughput_bps: float  # the estimate when the batch was requested


@dataclass(frozen=True, slots=True)
class Replaced:
    """A replacement took the place of a buffered segment."""

    position: int
    before: int  # rung
    after: int  # rung


@dataclass(frozen=True, slots=True)
class TileReady:
    """A tile of a segment can be shown, of a player that fetches by view."""

    position: int
    tile: int
    rung: int
    ready_s: float  # when it had arrived and was decoded


@dataclass(frozen=True, slots=True)
class Lost:
    """No rung of a segment can be had."""

    position: int
    at_s: float


@dataclass(frozen=True, slots=True)
class Cut:
    """A session ends before its package says so."""

    at_s: float
    why: str


@dataclass(frozen=True, slots=True)
class Shown:
    """A segment's time on the screen; rung None: it was lost, the last picture stands."""

    segment: int  # in the package
    loop: int
    rung: int | None
    ready_s: float  # when it had arrived and was decoded
    start_s: float  # when its first frame was shown
    frames: int
    stall_s: float  # waited for it on the screen
    psnr: float | None  # dB; None: lost or not measured


Event = Arrived | Replaced | TileReady | Lost | Cut | Shown
