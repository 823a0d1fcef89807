"""Frames that are read or made as they are asked for, since those of a group may not fit into memory together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
