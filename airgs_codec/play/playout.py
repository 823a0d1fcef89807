"""What is on the screen and what waits to be: starts and stalls of segments, and display ticks.

The timeline holds the segments of a session by position. Those before `_first_waiting` have a start; the others wait
until enough media has arrived. A display tick is a moment every 1 / fps seconds from the first picture on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from airgs_codec.play.downloader import Shown
from airgs_codec.play.offers import SegmentOffer
from airgs_codec.play.settings import SessionSettings


@dataclass(slots=True, eq=False)
class Slot:
    position: int
    seconds: float  # of play
    ready_s: float  # when it has arrived and is decoded
    offer: SegmentOffer | None = None  # None: lost
    rung: int = 0
    start_s: float = math.inf  # of its display; inf while it waits
    stall_s: float = 0.0  # waited for it on the screen

    @property
    def end_s(self) -> float:
        return self.start_s + self.seconds

    @property
    def psnr(self) -> float | None:
        """dB, None of a lost segment."""
        return None if self.offer is None else self.offer.rungs[self.rung].psnr


@dataclass(slots=True, eq=False)
class Playout:
    settings: SessionSettings
    timeline: list[Slot] = field(default_factory=list)
    _began_s: float = math.inf  # where the first segment was forgotten: its start
    _first_waiting: int = 0
    _first_unseen: int = 0  # of the timeline: those before it were given by `started`

    @property
    def last(self) -> Slot | None:
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
        ahead, most = seconds, self.settings.buffer_s
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
