"""How long work says how far it is: one callback, everywhere."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called as work goes on, always from the thread that started it."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """`stage`: what is being done, for people; `done` of `total` parts of it are finished (`total` at least 1)."""


def silent(stage: str, done: int, total: int) -> None:
    """The default: says nothing."""
