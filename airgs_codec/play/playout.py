"""What is on the screen and what waits to be: starts and stalls of segments, and nothing about where they come from.

The timeline holds the segments of a session by position. Those before `_first_waiting` have a start; the others wait
until enough media has arrived.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.settings import SessionSettings

NO_TILES: Mapping[int, int] = MappingProxyType({})


@dataclass(slots=True, eq=False)
class Slot:
    """A segment of the timeline."""

    position: int
    rung: int | None  # None: lost
    ready_s: float  # when it has arrived and is decoded
    start_s: float = math.inf  # of its display; inf while it waits
    stall_s: float = 0.0  # waited for it on the screen
    tiles: dict[int, int] = field(default_factory=dict)  # of a player that fetches by view: the rung of each that came


@dataclass(slots=True, eq=False)
class Playout:
    """The timeline of a session of `end` positions, so far where the package grows."""

    catalogue: Catalogue
    settings: SessionSettings
    end: int
    timeline: list[Slot] = field(default_factory=list)
    room_for_two: bool = False  # segments, however long they are: the next one is fetched while one is shown
    _first_waiting: int = 0
    _first_unseen: int = 0  # of the timeline: those before it were given by `started`

    @property
    def last(self) -> Slot | None:
        """The segment that was enqueued last."""
        return self.timeline[-1] if self.timeline else None

    @property
    def scheduled_end_s(self) -> float:
        """End of the last segment that has a start; -inf before playing begins."""
        if not self._first_waiting:
            return -math.inf
        slot = self.timeline[self._first_waiting - 1]
        return slot.start_s + self._seconds(slot)

    def buffer_end_s(self, now_s: float) -> float:
        """End of all that is buffered; where playing waits, as if it went on now."""
        waiting = self._waiting_s()
        resumes_s = now_s if waiting or not self._first_waiting else -math.inf
        return max(self.scheduled_end_s, resumes_s) + waiting

    def deadline_s(self, now_s: float) -> float:
        """When the next segment must have arrived to be shown without a stall, the time to decode it taken off."""
        return self.buffer_end_s(now_s) - self.settings.decode_frame_s

    def limit_s(self, position: int) -> float:
        """Most media time ahead of the playhead when the segment at a position has come."""
        two_s = 2 * self.catalogue.seconds_at(position) if self.room_for_two else 0.0
        return max(self.settings.buffer_s, two_s)

    def make_room(self, position: int) -> None:
        """Resume if playing waits for more media although the buffer is too full for the segment at a position."""
        blocking = self._blocking(position)
        if blocking and blocking[0].start_s == math.inf:
            self.resume()

    def earliest_request_s(self, position: int) -> float:
        """Earliest request time at which the segment fits the buffer; -inf if it fits now."""
        blocking = self._blocking(position)
        return blocking[0].start_s + blocking[1] if blocking else -math.inf

    def _blocking(self, position: int) -> tuple[Slot, float] | None:
        """The latest segment that must have begun for another to fit the buffer, and seconds to be shown of it."""
        ahead, most = self.catalogue.seconds_at(position), self.limit_s(position)
        for slot in reversed(self.timeline):
            length = self._seconds(slot)
            if ahead + length > most:
                return slot, length - max(0.0, most - ahead)
            ahead += length
        return None

    def enqueue(self, position: int, rung: int | None, arrived_s: float, tiles: Mapping[int, int] = NO_TILES) -> None:
        """Append a segment that arrived, or is lost; playing begins or goes on when there is enough."""
        ready_s = arrived_s + (0.0 if rung is None else self.settings.decode_frame_s)
        slot = Slot(position, rung, ready_s, tiles=dict(tiles))
        self.timeline.append(slot)
        if len(self.timeline) - self._first_waiting == 1 and slot.ready_s <= self.scheduled_end_s:
            slot.start_s = self.scheduled_end_s
            self._first_waiting += 1
            return
        wanted = self.settings.resume_s if self._first_waiting else self.settings.startup_s
        is_last = position == self.end - 1 and not self.catalogue.live
        if is_last or self._waiting_s() >= wanted:
            self.resume()

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
            at_s += self._seconds(slot)
        self._first_waiting = len(self.timeline)

    def pending(self) -> Iterator[Slot]:
        """Segments that were not given by `started` yet, but for the lost ones: what they show can still change."""
        return (slot for slot in self.timeline[self._first_unseen :] if slot.rung is not None)

    def replace(self, slot: Slot, rung: int) -> None:
        """Show another rung of a segment."""
        slot.rung = rung

    def started(self, before_s: float = math.inf) -> Iterator[Slot]:
        """Segments that began before a moment and were not given yet: nothing can replace them any more."""
        while self._first_unseen < self._first_waiting and self.timeline[self._first_unseen].start_s < before_s:
            self._first_unseen += 1
            yield self.timeline[self._first_unseen - 1]

    def unfinished(self, at_s: float) -> list[Slot]:
        """Segments with a start that are not over at a moment, but for lost ones, in their order."""
        found: list[Slot] = []
        for number in range(self._first_waiting - 1, -1, -1):
            slot = self.timeline[number]
            if self.end_s(slot) <= at_s:
                break
            found += [slot] if slot.rung is not None else []
        return found[::-1]

    def end_s(self, slot: Slot) -> float:
        """When a segment that has a start is over."""
        return slot.start_s + self._seconds(slot)

    def _waiting_s(self) -> float:
        return sum(self._seconds(slot) for slot in self.timeline[self._first_waiting :])

    def _seconds(self, slot: Slot) -> float:
        return self.catalogue.seconds_at(slot.position)
