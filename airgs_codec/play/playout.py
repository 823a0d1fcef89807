"""What is on the screen and what waits to be: starts and stalls of segments, display ticks, and tiles in sight.

The timeline holds the segments of a session by position. Those before `_first_waiting` have a start; the others wait
until enough media has arrived. A display tick is a moment every 1 / fps seconds from the first picture on.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.layout import locate
from airgs_codec.play.downloader import Shown, TileReady
from airgs_codec.play.offers import Offers, SegmentOffer
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.sight import View


@dataclass(slots=True, eq=False)
class Slot:
    """A segment of the timeline."""

    position: int
    seconds: float  # of play
    ready_s: float  # when it has arrived and is decoded
    offer: SegmentOffer | None = None  # of all tiles; None: lost
    rung: int = 0
    start_s: float = math.inf  # of its display; inf while it waits
    stall_s: float = 0.0  # waited for it on the screen
    tiles: dict[int, int] = field(default_factory=dict)  # by view: the rung of each that came

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + self.seconds

    @property
    def psnr(self) -> float | None:
        """dB, None of a lost segment."""
        return None if self.offer is None else self.offer.rungs[self.rung].psnr


@dataclass(slots=True, eq=False)
class Playout:
    """The timeline of a session."""

    settings: SessionSettings
    room_for_two: bool = False  # segments, however long they are: the next one is fetched while one is shown
    timeline: list[Slot] = field(default_factory=list)
    _began_s: float = math.inf  # where the first segment was forgotten: its start
    _first_waiting: int = 0
    _first_unseen: int = 0  # of the timeline: those before it were given by `started`

    @property
    def last(self) -> Slot | None:
        """The segment that was enqueued last."""
        return self.timeline[-1] if self.timeline else None

    @property
    def began_s(self) -> float:
        """Start of the first segment; inf before it has one."""
        return min(self._began_s, self.timeline[0].start_s if self.timeline else math.inf)

    @property
    def scheduled_end_s(self) -> float:
        """End of the last segment that has a start; -inf before playing begins."""
        return self.timeline[self._first_waiting - 1].end_s if self._first_waiting else -math.inf

    def buffer_end_s(self, now_s: float) -> float:
        """End of all that is buffered; where playing waits, as if it went on now."""
        waiting = self._waiting_s()
        resumes_s = now_s if waiting or not self._first_waiting else -math.inf
        return max(self.scheduled_end_s, resumes_s) + waiting

    def deadline_s(self, now_s: float) -> float:
        """When the next segment must have arrived to be shown without a stall, the time to decode it taken off."""
        return self.buffer_end_s(now_s) - self.settings.decode_frame_s

    def limit_s(self, seconds: float) -> float:
        """Most media time ahead of the playhead when a segment of some seconds has come."""
        return max(self.settings.buffer_s, 2 * seconds if self.room_for_two else 0.0)

    def make_room(self, seconds: float) -> None:
        """Resume if playing waits for more media although the buffer is too full for a segment of some seconds."""
        blocking = self._blocking(seconds)
        if blocking and blocking[0].start_s == math.inf:
            self.resume()

    def earliest_request_s(self, seconds: float) -> float:
        """Earliest request time at which a segment of some seconds fits the buffer; -inf if it fits now."""
        blocking = self._blocking(seconds)
        return blocking[0].start_s + blocking[1] if blocking else -math.inf

    def _blocking(self, seconds: float) -> tuple[Slot, float] | None:
        """The latest segment that must have begun for another to fit the buffer, and seconds to be shown of it."""
        ahead, most = seconds, self.limit_s(seconds)
        for slot in reversed(self.timeline):
            if ahead + slot.seconds > most:
                return slot, slot.seconds - max(0.0, most - ahead)
            ahead += slot.seconds
        return None

    def enqueue(self, slot: Slot, is_last: bool) -> None:
        """Append a segment that arrived, or is lost; playing begins or goes on when there is enough."""
        self.timeline.append(slot)
        if len(self.timeline) - self._first_waiting == 1 and slot.ready_s <= self.scheduled_end_s:
            slot.start_s = self.scheduled_end_s
            self._first_waiting += 1
            return
        wanted = self.settings.resume_s if self._first_waiting else self.settings.startup_s
        if is_last or self._waiting_s() >= wanted:
            self.resume()

    def forget(self, now_s: float) -> Slot | None:
        """Drop segments that are over and were given by `started`, but for the last; gives the first that is left."""
        self._began_s = self.began_s
        over = 0
        while over < self._first_unseen - 1 and self.timeline[over].end_s <= now_s:
            over += 1
        del self.timeline[:over]
        self._first_waiting, self._first_unseen = self._first_waiting - over, self._first_unseen - over
        return self.timeline[0] if self.timeline else None

    def finish(self, now_s: float) -> None:
        """Nothing will follow."""
        if self._first_waiting < len(self.timeline):
            self.resume(now_s)

    def resume(self, earliest_s: float = -math.inf) -> None:
        """Show what waits, one segment after another, from the moment all of it is ready."""
        waiting, due_s = self.timeline[self._first_waiting :], self.scheduled_end_s
        at_s = max(due_s, earliest_s, *(slot.ready_s for slot in waiting))
        waiting[0].stall_s = at_s - due_s if self._first_waiting else 0.0
        for slot in waiting:
            slot.start_s = at_s
            at_s += slot.seconds
        self._first_waiting = len(self.timeline)

    def pending(self) -> Iterator[tuple[Slot, SegmentOffer]]:
        """Segments that were not given by `started` yet, but for the lost ones: what they show can still change."""
        return ((slot, slot.offer) for slot in self.timeline[self._first_unseen :] if slot.offer is not None)

    def started(self, before_s: float = math.inf) -> Iterator[Slot]:
        """Segments that began before a moment and were not given yet: nothing can replace them any more."""
        while self._first_unseen < self._first_waiting and self.timeline[self._first_unseen].start_s < before_s:
            self._first_unseen += 1
            yield self.timeline[self._first_unseen - 1]

    def unfinished(self, at_s: float) -> list[tuple[Slot, SegmentOffer]]:
        """Segments with a start that are not over at a moment, but for lost ones, in their order."""
        found: list[tuple[Slot, SegmentOffer]] = []
        for number in range(self._first_waiting - 1, -1, -1):
            slot = self.timeline[number]
            if slot.end_s <= at_s:
                break
            found += [(slot, slot.offer)] if slot.offer is not None else []
        return found[::-1]

    def _waiting_s(self) -> float:
        return sum(slot.seconds for slot in self.timeline[self._first_waiting :])


def screen_ticks(shown: Sequence[Shown], fps: float) -> list[tuple[int, int]]:
    """For every display tick (1 / fps) from the first picture on: which entry of `shown`, which frame of it.

    While the player waits, the last frame stays.
    """
    ticks: list[tuple[int, int]] = []
    for i, entry in enumerate(shown):
        if i:
            ticks += [(i - 1, shown[i - 1].frames - 1)] * round(entry.stall_s * fps)
        ticks += [(i, frame) for frame in range(entry.frames)]
    return ticks


def tick_times(shown: Sequence[Shown], fps: float) -> NDArray[np.float64]:
    """Seconds from the first request to every display tick."""
    times: list[float] = []
    for i, entry in enumerate(shown):
        if i:
            times += [entry.start_s - entry.stall_s + tick / fps for tick in range(round(entry.stall_s * fps))]
        times += [entry.start_s + frame / fps for frame in range(entry.frames)]
    return np.array(times)


There = dict[int, int]  # tile -> rung


def tile_of(path: str) -> int | None:
    """The tile that a file of a key unit or a state is of; None of any other file."""
    what, numbers = locate(path)
    return max(0, numbers[0] - 1) if what in ("sidecar", "key", "state") else None


@dataclass(frozen=True, slots=True)
class TileFigures:
    """Figures of the tiles of one session."""

    tiles: int  # of the package
    fetched: float  # share of the tiles of all segments shown, of those that have rows
    late: int  # tiles that came after their segment had begun
    missing_s: float  # seconds of display in which a tile in sight was lacking
    bytes: tuple[int, ...]  # of every tile, keys and states that were of use, without headers


@dataclass(frozen=True, eq=False)
class TilesShown:
    """The tiles of a session, position by position."""

    offers: Offers
    view: View
    shown: tuple[Shown, ...]  # one for each position
    ready: tuple[TileReady, ...]
    bytes_by_tile: Mapping[int, int]

    @cached_property
    def _by_position(self) -> dict[int, list[TileReady]]:
        found: dict[int, list[TileReady]] = defaultdict(list)
        for event in self.ready:
            found[event.position].append(event)
        return found

    def came(self, position: int) -> list[TileReady]:
        """Return what came of the segment at a position."""
        return self._by_position.get(position, [])

    def there(self, position: int, at_s: float) -> There:
        """The tiles of the segment at a position that can be shown at a moment, each with its rung."""
        return {event.tile: event.rung for event in self.came(position) if event.ready_s <= at_s}

    @cached_property
    def tick_times(self) -> NDArray[np.float64]:
        """Seconds from the first request to every display tick."""
        return tick_times(self.shown, self.offers.fps)

    @property
    def view_times(self) -> NDArray[np.float64]:
        """Seconds from the first picture to every display tick."""
        return self.tick_times - self.tick_times[0]

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """(n, P) tiles that are in sight at a display tick and lacking; none of a lost segment."""
        ticks = screen_ticks(self.shown, self.offers.fps)
        found = np.zeros((len(ticks), self.offers.manifest.tiles), np.bool_)
        for tick, ((position, _), at_s) in enumerate(zip(ticks, self.view_times.tolist(), strict=True)):
            entry = self.shown[position]
            if entry.rung is not None:
                found[tick] = self.offers.offer(entry.segment).boxes.in_sight(self.view.at(at_s), 0.0)
                found[tick, list(self.there(position, float(self.tick_times[tick])))] = False
        return found

    @cached_property
    def figures(self) -> TileFigures:
        """Figures of the session."""
        count = self.offers.manifest.tiles
        rows = sum(int(self.offers.offer(s.segment).boxes.has_rows.sum()) for s in self.shown if s.rung is not None)
        late = [event for event in self.ready if event.ready_s > self.shown[event.position].start_s]
        return TileFigures(
            tiles=count,
            fetched=len({(event.position, event.tile) for event in self.ready}) / max(1, rows),
            late=len(late),
            missing_s=float(self.missing.any(axis=1).sum() / self.offers.fps),
            bytes=tuple(self.bytes_by_tile.get(tile, 0) for tile in range(count)),
        )
