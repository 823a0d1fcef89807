"""The rules of a player, and what is on the screen and what waits to be: starts and stalls of segments.

The timeline holds the segments of a session by position. Those before `_first_waiting` have a start; the others wait
until enough media has arrived.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from airgs_codec._settings import documented, setting
from airgs_codec.errors import ConfigError
from airgs_codec.play.offers import SegmentOffer

LEAST_S = 1e-3  # of a buffer: no frame is shorter


@documented
@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Rules of the player. Raises ConfigError for rules that cannot work."""

    buffer_s: float = setting(10.0, "most media time ahead of the playhead, in seconds")
    startup_s: float = setting(1.0, "media time in seconds to buffer before playing begins, one segment at least")
    resume_s: float = setting(0.5, "media time in seconds to buffer before playing goes on after a stall")
    decode_frame_s: float = setting(0.004, "time to decode and apply one frame")
    replace: bool = setting(True, "fetch better rungs for segments that are buffered")
    abandon: bool = setting(True, "give up a download that would come too late")
    pipelined: bool = setting(True, "request a segment a round trip before the batch before it ends, knowing less")
    loops: int | None = setting(None, "times the sequence is played; by default about 30 s of play")
    budget: int | None = setting(None, "most Gaussians that are fetched and shown of a group; by default any number")

    def __post_init__(self) -> None:
        times = {"start-up": self.startup_s, "resume": self.resume_s, "decoding": self.decode_frame_s}
        for name, value in {"buffer": self.buffer_s, **times}.items():
            least = LEAST_S if name == "buffer" else 0
            if not least <= value < math.inf:
                raise ConfigError(f"{name}: expected {least:g} s or more, got {value:g}")
        for name, count in {"budget": self.budget, "loops": self.loops}.items():
            if count is not None and count < 1:
                raise ConfigError(f"{name}: expected at least 1, got {count}")


@dataclass(slots=True, eq=False)
class TimelineEntry:
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
        return None if self.offer is None else self.offer.rungs[self.rung].psnr


@dataclass(slots=True, eq=False)
class Playout:
    settings: SessionSettings
    timeline: list[TimelineEntry] = field(default_factory=list)
    _first_waiting: int = 0
    _first_unseen: int = 0  # of the timeline: those before it were given by `started`

    @property
    def scheduled_end_s(self) -> float:
        """Return the end of the last segment that has a start; -inf before playing begins."""
        return self.timeline[self._first_waiting - 1].end_s if self._first_waiting else -math.inf

    def deadline_s(self, now_s: float) -> float:
        """Return when the next segment must have arrived to be decoded and shown without a stall.

        That is when the buffer runs dry; during a stall, assuming that playback resumes now.
        """
        waiting = self._waiting_s()
        resumes_s = now_s if waiting or not self._first_waiting else -math.inf
        return max(self.scheduled_end_s, resumes_s) + waiting - self.settings.decode_frame_s

    def make_room(self, seconds: float) -> float:
        """Return the earliest time to request a segment of this length so that it fits the buffer; -inf for now.

        Playback resumes if it waits for more media than the buffer has room for.
        """
        ahead, most = seconds, self.settings.buffer_s
        for slot in reversed(self.timeline):
            if ahead + slot.seconds > most:
                if slot.start_s == math.inf:
                    self.resume()
                return slot.start_s + (slot.seconds - max(0.0, most - ahead))
            ahead += slot.seconds
        return -math.inf

    def enqueue(self, slot: TimelineEntry, is_last: bool) -> None:
        """Append a segment that arrived, or is lost; playing begins or goes on when there is enough."""
        self.timeline.append(slot)
        if len(self.timeline) - self._first_waiting == 1 and slot.ready_s <= self.scheduled_end_s:
            slot.start_s = self.scheduled_end_s
            self._first_waiting += 1
            return
        wanted = self.settings.resume_s if self._first_waiting else self.settings.startup_s
        if is_last or self._waiting_s() >= wanted:
            self.resume()

    def forget(self, now_s: float) -> TimelineEntry | None:
        """Drop segments that are over and were yielded by `started`, except the last; returns the first one left."""
        over = 0
        while over < self._first_unseen - 1 and self.timeline[over].end_s <= now_s:
            over += 1
        del self.timeline[:over]
        self._first_waiting, self._first_unseen = self._first_waiting - over, self._first_unseen - over
        return self.timeline[0] if self.timeline else None

    def resume(self, earliest_s: float = -math.inf) -> None:
        """Show what waits, if anything, one segment after another, from the moment all of it is ready."""
        waiting, due_s = self.timeline[self._first_waiting :], self.scheduled_end_s
        at_s = max([due_s, earliest_s, *(slot.ready_s for slot in waiting)])
        if waiting and self._first_waiting:
            waiting[0].stall_s = at_s - due_s
        for slot in waiting:
            slot.start_s = at_s
            at_s += slot.seconds
        self._first_waiting = len(self.timeline)

    def pending(self) -> Iterator[tuple[TimelineEntry, SegmentOffer]]:
        """Yield the segments that can still be changed: neither lost nor yielded by `started` yet."""
        return ((slot, slot.offer) for slot in self.timeline[self._first_unseen :] if slot.offer is not None)

    def started(self, before_s: float = math.inf) -> Iterator[TimelineEntry]:
        """Yield segments that have begun since the last call; they can no longer be replaced."""
        while self._first_unseen < self._first_waiting and self.timeline[self._first_unseen].start_s < before_s:
            self._first_unseen += 1
            yield self.timeline[self._first_unseen - 1]

    def _waiting_s(self) -> float:
        return sum(slot.seconds for slot in self.timeline[self._first_waiting :])
