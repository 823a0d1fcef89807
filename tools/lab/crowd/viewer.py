"""One viewer of a crowd: a real player, the batch that it waits for, and what was on the screen in the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from airgs_codec.play.downloader import (
    CHECK_S,
    Arrival,
    Arrived,
    BatchKind,
    Event,
    GiveUp,
    Partial,
    Request,
    Shown,
    Wanted,
)
from airgs_codec.play.fetcher import SHORTEST_S
from airgs_codec.play.player import play_steps
from airgs_codec.play.policies.state import Policy
from airgs_codec.play.settings import SessionSettings
from tools.lab.crowd.programme import Visit


class Rtt(NamedTuple):
    """What a player knows of a simulated link."""

    rtt_s: float
    pipelines: bool = True


@dataclass(frozen=True, slots=True)
class Seen:
    """Figures of a viewer's session; PSNR in dB as `SessionMetrics` has it."""

    viewer: int
    policy: str
    trace: str
    late: bool  # whether the viewer began at the beginning of the programme
    join_s: float
    startup_s: float
    played_s: float
    stalls: int
    stall_s: float
    psnr_mean: float
    psnr_p5: float
    wire_bytes: int  # with headers
    requests: int  # files asked for
    replaced: int
    abandoned: int

    @property
    def bitrate_bps(self) -> float:
        """Bits with headers for a second of media."""
        return 8 * self.wire_bytes / self.played_s

    @property
    def session_s(self) -> float:
        """From the first request to the last picture."""
        return self.startup_s + self.played_s + self.stall_s


@dataclass(slots=True, eq=False)
class Batch:
    """The files of a request on their way. Times are those of the viewer's session."""

    request: Request
    give_up: GiveUp | None
    first_s: float  # of the first byte, where the edge has the files
    sizes: Mapping[str, int]  # bytes with headers, in the order of the request
    rest: dict[str, float] = field(default_factory=dict)  # bytes of files at the edge that have not passed
    away: int = 0  # files that are not at the edge yet
    looks: int = 0
    came_bytes: float = 0.0  # that were at the edge so far
    shared_bytes: float = 0.0  # of them, what `rest` knows to have passed

    @property
    def expected_bytes(self) -> int:
        """Bytes of all files with headers."""
        return sum(self.sizes.values())

    @property
    def look_s(self) -> float:
        """Return when the player looks at the download next."""
        return self.first_s + CHECK_S * (self.looks + 1)

    def add(self, path: str, passed_bytes: float) -> None:
        """A file is at the edge, when so many bytes of the batch have passed."""
        self._share(passed_bytes)
        self.rest[path] = self.sizes[path]
        self.came_bytes += self.sizes[path]

    def _share(self, passed_bytes: float) -> None:
        """Spread what has passed since the last time over the files that were there, in equal parts."""
        new, self.shared_bytes = passed_bytes - self.shared_bytes, passed_bytes
        if new <= 0:
            return
        open_files = sorted((size, path) for path, size in self.rest.items() if size > 0)
        for number, (size, path) in enumerate(open_files):
            part = min(size, new / (len(open_files) - number))
            self.rest[path] = size - part if size - part > 1e-6 else 0.0
            new -= part

    def is_given_up(self, passed_bytes: float) -> bool:
        """Ask the player at `look_s` whether to abandon the batch."""
        at_s = self.look_s
        self.looks += 1
        partial = Partial(at_s, at_s - self.first_s, passed_bytes, self.expected_bytes)
        return self.give_up is not None and self.give_up(partial)

    def end(self, at_s: float, passed_bytes: float, abandoned: bool) -> Arrival:
        """Return what came of the batch."""
        whole = tuple(self.sizes)
        if abandoned:
            self._share(passed_bytes)
            whole = tuple(path for path in self.sizes if self.rest.get(path, 1.0) <= 0)
        size = max(1, round(passed_bytes))
        return Arrival(self.request, self.first_s, at_s, size, whole, {}, abandoned)


class Viewer:
    """A player that waits for one batch at a time."""

    def __init__(self, visit: Visit, policy: Policy, settings: SessionSettings, rtt_s: float) -> None:
        self.visit = visit
        self.batch: Batch | None = None
        self._free_s = 0.0  # when the last batch was over
        self._steps = play_steps(visit, Rtt(rtt_s), policy, settings)
        self._shown: list[Shown] = []
        self._bytes, self._requests, self._replaced, self._abandoned = 0, 0, 0, 0

    def next_batch(self, arrival: Arrival | None = None) -> Batch | None:
        """Go on to the next request, which is now `batch`; None when the session is over."""
        if arrival is not None:
            self._free_s = arrival.at_s
        step = next(self._steps, None) if arrival is None else self._send(arrival)
        while step is not None and not isinstance(step, Wanted):
            self._note(step)
            step = next(self._steps, None)
        self.batch = None if step is None else self._asked(step)
        return self.batch

    def _send(self, arrival: Arrival) -> Event | Wanted | None:
        try:
            return self._steps.send(arrival)
        except StopIteration:
            return None

    def _asked(self, wanted: Wanted) -> Batch:
        request, c = wanted.request, self.visit
        sizes = {path: c.header_bytes + c.file_bytes(path) for path in request.batch.files}
        self._requests += len(sizes)
        return Batch(request, wanted.give_up, max(self._free_s, request.sent_s) + request.latency_s, sizes)

    def _note(self, event: Event) -> None:
        if isinstance(event, Shown):
            self._shown.append(event)
        elif isinstance(event, Arrived):
            self._bytes += event.arrival.bytes
            self._replaced += event.arrival.request.kind is BatchKind.REPLACEMENT
            self._abandoned += event.arrival.abandoned

    def seen(self, number: int, policy: str, trace: str, late: bool, join_s: float) -> Seen:
        """Figures of the session, when it is over."""
        shown, fps = self._shown, self.visit.fps
        frozen = [*(round(s.stall_s * fps) for s in shown[1:]), 0]  # ticks that the last frame of each stays longer
        ticks = np.repeat(
            [s.psnr or 0.0 for s in shown], [s.frames + more for s, more in zip(shown, frozen, strict=True)]
        )
        stalls = [s.stall_s for s in shown if s.stall_s > SHORTEST_S]
        return Seen(
            viewer=number,
            policy=policy,
            trace=trace,
            late=late,
            join_s=join_s,
            startup_s=shown[0].start_s,
            played_s=sum(s.frames for s in shown) / fps,
            stalls=len(stalls),
            stall_s=float(sum(stalls)),
            psnr_mean=float(ticks.mean()),
            psnr_p5=float(np.percentile(ticks, 5)),
            wire_bytes=self._bytes,
            requests=self._requests,
            replaced=self._replaced,
            abandoned=self._abandoned,
        )
