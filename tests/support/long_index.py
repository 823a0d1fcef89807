"""The index of a long package of which there is nothing else."""

from functools import cache
from types import SimpleNamespace
from typing import Any

from tests.faces import Spans, build_index


@cache
def long_index(count: int) -> tuple[list[Spans], dict[str, Spans]]:
    """The index of so many groups of a frame and a segment each, and its pages by their paths."""
    group: Any = SimpleNamespace(start=0, stop=1, segments=[None])
    return build_index([group] * count, [b"table %d" % number for number in range(count)])
