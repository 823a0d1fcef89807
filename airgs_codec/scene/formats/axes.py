"""Which way is up in the coordinates of a file, where its format specifies it or the file says it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Axes:
    """The direction that points up, and how long a unit is."""

    up: tuple[float, ...]  # (3,)
    metres: float | None = None  # None: nothing says it
