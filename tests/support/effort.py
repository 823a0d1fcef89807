"""How much work something is, by counts that are the same on every machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def few_calls(most: int) -> Iterator[None]:
    """Within the block, at most so many functions may be called by this thread, built-in ones included."""
    count = 0

    def called(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(called)
    try:
        yield
    finally:
        sys.setprofile(before)
    assert count <= most, f"{count} calls"
