"""Frames that are read or made as they are asked for, since those of a group may not fit into memory together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import overload

from airgs_codec.scene.gaussians import Gaussians


class LazyFrames(Sequence[Gaussians]):
    """Frames of a sequence, of which only the one that was asked for last is kept."""

    def __init__(self, make: Callable[[int], Gaussians], numbers: Sequence[int]) -> None:
        """`make` gives the frame of any of the `numbers`, which stand in the order of the frames."""
        self._make, self._numbers = make, numbers
        self._last: tuple[int, Gaussians] | None = None

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, place: int) -> Gaussians: ...

    @overload
    def __getitem__(self, place: slice) -> LazyFrames: ...

    def __getitem__(self, place: int | slice) -> Gaussians | LazyFrames:
        if isinstance(place, slice):
            return LazyFrames(self._make, self._numbers[place])
        number, last = self._numbers[place], self._last
        if last is None or last[0] != number:
            last = number, self._make(number)
            self._last = last
        return last[1]


class HeldFrames:
    """Frames that were read, as many as some bytes hold; the one that was asked for longest ago goes first.

    A copy in another process holds none.
    """

    def __init__(self, most: int) -> None:
        """`most`: bytes that all frames together may take."""
        self.most = most
        self._frames: dict[int, Gaussians] = {}  # the one that was asked for last stands last
        self._bytes = 0
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[HeldFrames], tuple[int]]:
        return HeldFrames, (0,)

    def __contains__(self, number: int) -> bool:
        return number in self._frames

    def get(self, number: int, read: Callable[[int], Gaussians]) -> Gaussians:
        """Return a frame, which `read` gives where it is not held."""
        with self._lock:
            frame = self._frames.pop(number, None)
            if frame is not None:
                self._frames[number] = frame
                return frame
        frame = read(number)
        with self._lock:
            if number not in self._frames and _bytes_of(frame) <= self.most:
                self._frames[number] = frame
                self._bytes += _bytes_of(frame)
            while self._bytes > self.most:
                self._bytes -= _bytes_of(self._frames.pop(next(iter(self._frames))))
        return frame

    def clear(self) -> None:
        """Let go of all frames."""
        with self._lock:
            self._frames.clear()
            self._bytes = 0


def _bytes_of(frame: Gaussians) -> int:
    return sum(getattr(frame, field.name).nbytes for field in fields(frame))
