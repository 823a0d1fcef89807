"""Rows a few at a time: what is worked out row by row never needs more memory than a chunk of rows takes."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

from airgs_codec._settings import available_cores

CHUNK = 1 << 20  # numbers of all its rows together that a chunk has at most; but it has at least LEAST rows
LEAST = 256  # rows


def row_chunks(rows: int, width: int) -> Iterator[slice]:
    """Slices that cover so many rows, each of which has `width` numbers."""
    size = max(LEAST, CHUNK // max(1, width))
    return (slice(start, min(start + size, rows)) for start in range(0, rows, size))


def for_chunks(work: Callable[[slice], None], rows: int, width: int) -> None:
    """Call `work` with every chunk, several at a time where there are several: numpy lets other threads run."""
    chunks = list(row_chunks(rows, width))
    if len(chunks) == 1:
        work(chunks[0])
        return
    for _ in _pool().map(work, chunks):
        pass


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(available_cores(), thread_name_prefix="chunks")


if hasattr(os, "register_at_fork"):  # the threads of a pool stay with the parent, and a child would wait for them
    os.register_at_fork(after_in_child=_pool.cache_clear)
