"""Reports of progress, and how long work took."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol


class Progress(Protocol):
    """Called as work goes on, always from the thread that started it."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Report that `done` of `total` parts of a stage are finished, `total` at least 1.

        What follows a colon in `stage` names the part and changes while the stage goes on.
        """


def name_of(stage: str) -> str:
    return stage.partition(":")[0]


def about(*seconds: float) -> str:
    """Return a rough time in words; two values are a range."""
    unit, name = (1, "s") if max(seconds) < 120 else (60, "minutes") if max(seconds) < 7200 else (3600, "hours")
    return f"about {' to '.join(f'{max(1, s / unit):.0f}' for s in seconds)} {name}"


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


def as_reporter(progress: Progress | type) -> Progress:
    """Return a function of what `progress=` takes: a class, such as tqdm.auto.tqdm, shows a bar for each stage."""
    return Bars(progress) if isinstance(progress, type) else progress


class Bars:
    """A bar of `kind`, which is called as tqdm is, for each stage."""

    def __init__(self, kind: Callable[..., Any]) -> None:
        self._kind, self._stage = kind, ""
        self._bar: Any = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        if self._bar is None or name_of(stage) != self._stage:
            self.close()
            self._stage, self._bar = name_of(stage), self._kind(total=total, initial=done, desc=stage)
        self._bar.set_description(stage, refresh=False)
        self._bar.total = total
        self._bar.update(done - self._bar.n)
        if done == total:
            self.close()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
        self._bar = None


class Stopwatch:
    def __init__(self) -> None:
        self._last = time.perf_counter()

    def lap(self) -> float:
        """Return the seconds since the last lap, or since the start."""
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        return seconds
