"""Tables of numbers about parts of a sequence that is not wholly known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray


class Rows:
    """A table of numbers whose rows are made when they are asked for, since they need tables of groups, and kept."""

    def __init__(self, make: Callable[[int], NDArray[Any]]) -> None:
        self._make = make
        self._kept: dict[int, NDArray[Any]] = {}

    def __getitem__(self, place: Any) -> Any:
        row, *rest = place if isinstance(place, tuple) else (place,)
        if row not in self._kept:
            self._kept[row] = self._make(row)
        return self._kept[row][tuple(rest)] if rest else self._kept[row]
