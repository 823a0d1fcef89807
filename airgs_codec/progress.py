"""How long work says how far it is, and how long it took."""

from __future__ import annotations

import time
from typing import Protocol


class Progress(Protocol):
    """Called as work goes on, always from the thread that started it."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """`stage`: what is being done, for people; `done` of `total` parts of it are finished (`total` at least 1)."""


def silent(stage: str, done: int, total: int) -> None:
    """The default: says nothing."""


class Stopwatch:
    """Seconds between laps."""

    def __init__(self) -> None:
        self._last = time.perf_counter()

    def lap(self) -> float:
        """Seconds since the last lap, or since the start."""
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        return seconds
