"""The player: what it has, what it waits for, when each segment is shown. It chooses nothing; see `session`."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.link import Link
from airgs_codec.play.policy import Download

MISSING = "missing"  # what is wrong with a file that is not there
SHORTEST_S = 1e-9  # a download that rounds to no time still has a rate


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Rules of the player."""

    policy: str = "paper"
    buffer_s: float = 10.0  # most media time ahead of the playhead
    startup_s: float = 1.0  # media at hand before playing begins; one segment at least
    resume_s: float = 0.5  # the same after a stall
    decode_frame_s: float = 0.004  # time to decode and apply a frame
    replace: bool = True  # buffered segments by better ones
    abandon: bool = True
    ahead: bool = True  # ask for the next segment a round trip before the last batch is there, knowing so much less
    loops: int | None = None  # default: see Catalogue.loops


@dataclass(frozen=True, slots=True)
class Fetch:
    """One batch on the wire."""

    kind: str  # manifests, group (keys and state), state, better (a replacement)
    position: int  # of the segment in the session
    rung: int
    bytes: int  # with headers; of an abandoned batch, what had passed
    wasted: int  # of them: abandoned, too late or replaced later
    request_s: float
    arrival_s: float
    budget_bytes: float
    throughput_bps: float  # the estimate at the request
    fits: bool
    reason: str


@dataclass(slots=True)
class Buffered:
    """A segment at hand or on the screen."""

    position: int
    rung: int | None  # None: lost
    ready_s: float
    fetch: int = -1  # which batch brought it
    start_s: float = math.inf  # unknown while the player waits for more
    stall_s: float = 0.0


@dataclass(slots=True, eq=False)
class Player:
    """State of one session; time only goes on in `receive` and where `now_s` is set."""

    catalogue: Catalogue
    link: Link
    settings: SessionSettings
    end: int  # positions of the session
    faults: Mapping[str, str]
    trip_s: float  # of the round trip of the next batch, what is left when the one before is there
    now_s: float = 0.0
    downloads: list[tuple[float, Download]] = field(default_factory=list)  # with their arrivals
    fetches: list[Fetch] = field(default_factory=list)
    line: list[Buffered] = field(default_factory=list)  # by position
    first_waiting: int = 0  # of `line`: those from here on have no start yet
    keys: dict[tuple[int, int], dict[int, int]] = field(default_factory=dict)  # (loop, group) -> quality -> tiers
    once: set[str] = field(default_factory=set)  # init segments at hand
    bytes_by_kind: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    given_up: tuple[int, int] = (-1, 0)  # position and size: nothing as large is asked for there again
    bad: set[str] = field(default_factory=set)  # files found missing or corrupt

    def index(self, position: int) -> int:
        """Of the segment in the package."""
        return position % len(self.catalogue.seconds)

    def seconds(self, position: int) -> float:
        """Of play."""
        return self.catalogue.seconds[self.index(position)]

    def group(self, position: int) -> tuple[int, int]:
        """(loop, group) that a position belongs to."""
        loop, index = divmod(position, len(self.catalogue.seconds))
        return loop, self.catalogue.manifest.segments[index].group

    def held(self, position: int) -> dict[int, int]:
        """Key quality -> tiers at hand of the group there."""
        return self.keys.setdefault(self.group(position), {})

    def quality(self, segment: Buffered) -> float | None:
        """dB, None of a lost segment."""
        if segment.rung is None:
            return None
        return float(self.catalogue.quality[self.index(segment.position), segment.rung])

    @property
    def asked_s(self) -> float:
        """When the next batch is requested."""
        return self.now_s - (self.link.rtt_s - self.trip_s)

    @property
    def history(self) -> tuple[Download, ...]:
        """The last downloads that are over when the next batch is requested, oldest first."""
        return tuple(download for arrival, download in self.downloads[-24:] if arrival <= self.asked_s + SHORTEST_S)

    def due_s(self) -> float:
        """When the segments that have a start are over; the distant past before there are any."""
        if not self.first_waiting:
            return -math.inf
        last = self.line[self.first_waiting - 1]
        return last.start_s + self.seconds(last.position)

    def end_s(self) -> float:
        """When what is at hand will have been shown; while it waits, as if it went on now."""
        waiting = sum(self.seconds(s.position) for s in self.line[self.first_waiting :])
        return max(self.due_s(), self.now_s if waiting or not self.first_waiting else -math.inf) + waiting

    def room_s(self, position: int) -> float:
        """When the segment fits the buffer: media ahead of the playhead and the segment <= buffer_s; past if now."""
        ahead = self.seconds(position)
        for segment in reversed(self.line):
            length = self.seconds(segment.position)
            if ahead + length > self.settings.buffer_s:
                if segment.start_s == math.inf:  # it waits to resume with a full buffer: it need not
                    self.resume()
                return segment.start_s + length - max(0.0, self.settings.buffer_s - ahead)
            ahead += length
        return -math.inf

    def files(self, position: int, rung: int) -> list[str]:
        """What a rung of a segment still needs, each init segment before the first of its files."""
        c = self.catalogue
        files = c.files(self.index(position), rung, self.held(position))
        folders = {path.rpartition("/")[0] for path in files}
        inits = [p for p in c.manifest.init_files(*c.rungs[rung]) if p.rpartition("/")[0] in folders]
        return [path for path in inits if path not in self.once] + files

    def wire_sizes(self, files: list[str]) -> list[int]:
        """Bytes of files with their headers; of a missing one the header alone."""
        sizes = [0 if self.faults.get(f) == MISSING else self.catalogue.manifest.files[f].bytes for f in files]
        return [self.catalogue.wire_bytes([size]) for size in sizes]

    def wait(self, wire: int, stop_s: float | None = None) -> float:
        """Request so many bytes and let time pass until the last of them, or until `stop_s`; gives what passed."""
        first = self.now_s + self.trip_s
        self.now_s = self.link.trace.arrival_s(wire, first) if stop_s is None else stop_s
        passed = float(wire) if stop_s is None else self.link.bytes_between(first, stop_s)
        self.downloads.append((self.now_s, Download(max(1, round(passed)), max(self.now_s - first, SHORTEST_S))))
        return passed

    def receive(self, position: int, rung: int, files: list[str], stop_s: float | None = None) -> tuple[int, list[str]]:
        """Request a batch; gives its bytes on the wire, and the files of it that are at hand afterwards.

        Those came whole and are what they should be; a state without the rest of its batch is of no use and is
        dropped. With `stop_s` the batch is given up then.
        """
        manifest = self.catalogue.manifest
        sizes = self.wire_sizes(files)
        passed = self.wait(sum(sizes), stop_s)
        came = [f for f, end in zip(files, itertools.accumulate(sizes), strict=True) if end <= passed]
        for path in came:
            if path in self.faults:
                self.bad.add(path)
                self.lost.append(f"{path} at {self.now_s:.2f} s: {self.faults[path]}")
        whole = [path for path in came if path not in self.faults]
        if len(whole) < len(files):
            whole = [path for path in whole if path.startswith("key/") or path.endswith("init.mp4")]
        for path in whole:
            kind = "init" if path.endswith("init.mp4") else "sidecars" if path.endswith(".bin") else path.split("/")[0]
            self.bytes_by_kind[kind] += manifest.files[path].bytes
        self.once.update(path for path in whole if path.endswith("init.mp4"))
        held, (quality, level) = self.held(position), self.catalogue.rungs[rung]
        while (tier := held.get(quality, 0)) < manifest.levels[level].tiers:
            if not set(manifest.key_files(self.group(position)[1], tier, quality)) <= set(whole):
                break
            held[quality] = tier + 1
        self._use_keys(position, quality)
        return self.downloads[-1][1].bytes, whole

    def _use_keys(self, position: int, quality: int) -> None:
        """Show what is buffered of a group with its best keys, where they are decoded in time."""
        c, held = self.catalogue, self.held(position)
        ready_s = self.now_s + self.settings.decode_frame_s
        for segment in self.line:
            if segment.rung is None or self.group(segment.position) != self.group(position):
                continue
            q, j = c.rungs[segment.rung]
            if quality < q and segment.start_s >= ready_s and held.get(quality, 0) >= c.manifest.levels[j].tiers:
                segment.rung = c.rungs.index((quality, j))

    def line_up(self, position: int, rung: int | None) -> None:
        """A segment is at hand, or lost; playing begins or goes on when enough is."""
        ready = self.now_s + (self.settings.decode_frame_s if rung is not None else 0.0)
        segment = Buffered(position, rung, ready, len(self.fetches) - 1)
        self.line.append(segment)
        waiting = self.line[self.first_waiting :]
        if len(waiting) == 1 and ready <= self.due_s():
            segment.start_s = self.due_s()
            self.first_waiting += 1
            return
        wanted = self.settings.resume_s if self.first_waiting else self.settings.startup_s
        if position == self.end - 1 or sum(self.seconds(s.position) for s in waiting) >= wanted:
            self.resume()

    def resume(self) -> None:
        """Show what waits, one segment after another, from the moment all of it was ready."""
        waiting, due = self.line[self.first_waiting :], self.due_s()
        at = max(due, *(segment.ready_s for segment in waiting))
        waiting[0].stall_s = at - due if self.first_waiting else 0.0
        for segment in waiting:
            segment.start_s = at
            at += self.seconds(segment.position)
        self.first_waiting = len(self.line)
