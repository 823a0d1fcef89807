"""Rows a few at a time: what is worked out row by row never needs more memory than a chunk of rows takes."""

from __future__ import annotations

from collections.abc import Iterator

CHUNK = 1 << 20  # numbers of all its rows together that a chunk has at most; but it has at least LEAST rows
LEAST = 256  # rows


def row_chunks(rows: int, width: int) -> Iterator[slice]:
    """Slices that cover so many rows, each of which has `width` numbers."""
    size = max(LEAST, CHUNK // max(1, width))
    return (slice(start, min(start + size, rows)) for start in range(0, rows, size))
