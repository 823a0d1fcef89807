"""Work on rows, a few at a time: chunks on several threads, memory of frames, rotations and colours of rows.

What is worked out row by row never needs more memory than a chunk of rows takes. n rows, C colour channels. Arithmetic
is in float32, within the bounds of FORMAT.md (section 5, Precision), in one order of operations: equal channels give
equal rows on every machine, however rows are cut into chunks.

Loops over rows run where numba is loaded already, as it is once there were many numbers (`rangecoder`); numpy gives the
same bits without them.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from airgs_codec._settings import available_cores
from airgs_codec.coding.rangecoder import Loop, worth_compiling

CHUNK = 1 << 20  # numbers of all its rows together that a chunk has at most; but it has at least LEAST rows
LEAST = 256  # rows
Floats = NDArray[np.float32]
# Means, which are float64 in a base, log-scales, rotations and colours.
Columns = tuple[NDArray[np.floating], Floats, Floats, Floats]

_SMALL_ANGLE = np.float32(1e-8)  # radians; below it sin(a/2)/a is 1/2, as in `scene.gaussians`
_STRIP = 1 << 18  # numbers that colours are summed up in at a time: they stay in the cache of a core


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


class FrameMemory:
    """Gives out arrays, each anew once the one who got it has let go of it and of all views of it.

    Fresh memory of the size of a large frame comes from the system, which clears it page by page: a third of the time
    of a decoded frame of a million Gaussians.
    """

    def __init__(self) -> None:
        self._arrays: list[NDArray[Any]] = []

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> NDArray[Any]:
        for array, held in zip(self._arrays, _references(self._arrays), strict=True):
            if array.shape == shape and array.dtype == dtype and held <= _OURS:
                return array
        self._arrays.append(np.empty(shape, dtype))
        return self._arrays[-1]


def _references(arrays: list[NDArray[Any]]) -> list[int]:
    """How often each array is held, by whatever this version of Python counts here besides."""
    return [sys.getrefcount(array) for array in arrays]


_OURS = _references([np.empty(0, np.float32)])[0]  # of an array that nobody has but the list


def consecutive(rows: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Ascending rows (n,), n > 0, as a slice where they follow one another: reading them then copies nothing."""
    first, last = int(rows[0]), int(rows[-1])
    return slice(first, last + 1) if last - first == len(rows) - 1 else rows


def is_compiled() -> bool:
    """Whether `add_deltas` runs as machine code, as it does where numba is loaded."""
    return worth_compiling(_add_deltas, 0) is not None


def add_deltas(changes: Columns, base: Columns, rows: NDArray[np.intp], out: Columns) -> None:
    """Write to some rows (n,), n > 0, of `out` those of `base` with (c, n) changes; of rotations those are vectors.

    Where changes of rotations or colours have no channels, these columns are not touched.
    """
    vectors = changes[2]
    turns = _half_turns(vectors) if len(vectors) else (vectors.ravel(), vectors.ravel())
    loop: Loop = worth_compiling(_add_deltas, 0) or _add_deltas
    loop(changes, turns, base, rows, out)


def _add_deltas(
    changes: Columns, turns: tuple[Floats, Floats], base: Columns, rows: NDArray[np.intp], out: Columns
) -> None:
    (moves, sizes, vectors, dyes), (cosine, factor) = changes, turns
    (old_means, old_scales, old_turns, old_colours), (means, scales, quaternions, colours) = base, out
    for i in range(len(rows)):
        row = np.uintp(rows[i])
        for axis in range(3):
            means[row, axis] = old_means[row, axis] + moves[axis, i]
            scales[row, axis] = old_scales[row, axis] + sizes[axis, i]
        if len(vectors):
            aw, ax, ay, az = cosine[i], factor[i] * vectors[0, i], factor[i] * vectors[1, i], factor[i] * vectors[2, i]
            bw, bx, by, bz = old_turns[row, 0], old_turns[row, 1], old_turns[row, 2], old_turns[row, 3]
            quaternions[row, 0] = aw * bw - ax * bx - ay * by - az * bz
            quaternions[row, 1] = aw * bx + ax * bw + ay * bz - az * by
            quaternions[row, 2] = aw * by - ax * bz + ay * bw + az * bx
            quaternions[row, 3] = aw * bz + ax * by - ay * bx + az * bw
        for channel in range(len(dyes)):
            colours[row, channel] = old_colours[row, channel] + dyes[channel, i]


def to_quaternions(vectors: Floats) -> Floats:
    """Rotation vectors (3, n) -> unit quaternions (n, 4)."""
    cosine, factor = _half_turns(vectors)
    quaternions = np.empty((len(cosine), 4), np.float32)
    quaternions[:, 0] = cosine
    quaternions[:, 1:] = (factor * vectors).T
    return quaternions


def _half_turns(vectors: Floats) -> tuple[Floats, Floats]:
    """The cosines (n,) of half the angles of rotation vectors (3, n), and their sines over the angles.

    Both are taken in float64 and rounded: float32 ones differ from one machine to the next.
    """
    x, y, z = vectors
    angle = np.sqrt(x * x + y * y + z * z)
    half = (angle / np.float32(2)).astype(np.float64)
    factor = np.sin(half).astype(np.float32) / np.maximum(angle, _SMALL_ANGLE)
    factor[angle <= _SMALL_ANGLE] = 0.5
    return np.cos(half).astype(np.float32), factor


def klt_colours(channels: Floats, transform: Floats, steps: Floats) -> Floats:
    """(C, n) KLT channels -> (C, n) colours: their product with the transform (C, C), times the steps (C,)."""
    width, rows = channels.shape
    colours = np.empty((width, rows), np.float32)
    some = [k for k in range(width) if channels[k].any()]  # the others would add 0
    size = max(1, _STRIP // max(1, width))
    for start in range(0, rows, size):
        strip = channels[:, start : start + size]
        total, part = np.zeros(strip.shape, np.float32), np.empty(strip.shape, np.float32)
        for k in some:
            total += np.multiply(transform[k][:, None], strip[k], out=part)
        np.multiply(total, steps[:, None], out=colours[:, start : start + size])
    return colours
