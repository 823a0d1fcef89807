"""Work on rows, a few at a time: chunks on several threads, rotations and colours of rows.

What is worked out row by row never needs more memory than a chunk of rows takes. n rows, C colour channels. Arithmetic
is in float32, within the bounds of FORMAT.md (section 5, Precision), in one order of operations: equal channels give
equal rows on every machine, however rows are cut into chunks, and whether loops are compiled or not.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._settings import available_cores
from airgs_codec.coding.rangecoder import worth_compiling
from airgs_codec.scene.gaussians import multiply

CHUNK = 1 << 20  # numbers of all its rows together that a chunk has at most; but it has at least LEAST rows
LEAST = 256  # rows
STRIP = 1 << 18  # numbers of colours that are summed up at a time: they stay in the cache of a core
Floats = NDArray[np.float32]
_SMALL_ANGLE = np.float32(1e-8)  # radians; below it sin(a/2)/a is 1/2, as in `scene.gaussians`


def row_chunks(rows: int, width: int) -> Iterator[slice]:
    """Return slices that cover `rows` rows, each of which has `width` numbers."""
    size = max(LEAST, CHUNK // max(1, width))
    return (slice(start, min(start + size, rows)) for start in range(0, rows, size))


def for_chunks(work: Callable[[slice], None], rows: int, width: int) -> None:
    """Call `work` with every chunk, several at a time where there are several: numpy lets other threads run."""
    chunks = list(row_chunks(rows, width))
    list(map(work, chunks) if len(chunks) == 1 else _pool().map(work, chunks))


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(available_cores(), thread_name_prefix="chunks")


if hasattr(os, "register_at_fork"):  # the threads of a pool stay with the parent, and a child would wait for them
    os.register_at_fork(after_in_child=_pool.cache_clear)


def consecutive(rows: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Return ascending rows (n,) as a slice where they are consecutive: reading them then copies nothing."""
    whole = len(rows) and rows[-1] - rows[0] == len(rows) - 1
    return slice(int(rows[0]), int(rows[-1]) + 1) if whole else rows


def change_rows(column: NDArray[Any], rows: NDArray[np.intp], base: NDArray[Any], changes: Floats) -> None:
    """Write rows (n,) of a column: those of `base` plus changes (k, n); quaternions are turned by rotation vectors."""
    width = base.shape[1] if base.ndim > 1 else 1
    if loop := worth_compiling(_turn if (turned := width == 4) else _add, 0):
        plain = (np.require(values, None, ["C", "W"]) for values in (base.reshape(-1, width), changes))
        loop(column.reshape(-1, width), rows, *plain)  # of others the loop would be compiled again
    else:
        values = multiply(to_quaternions(changes), base) if turned else base + changes.T.reshape(base.shape)
        column[consecutive(rows)] = values


def _add(column: NDArray[Any], rows: NDArray[np.intp], base: NDArray[Any], changes: Floats) -> None:
    for i in range(len(rows)):
        for k in range(len(changes)):
            column[rows[i], k] = base[i, k] + changes[k, i]


def _turn(column: Floats, rows: NDArray[np.intp], base: Floats, vectors: Floats) -> None:
    """Do what `to_quaternions` and `multiply` do, with series for sine and cosine: a core adds up several at once."""
    turns = np.empty((4, len(rows)), np.float32)
    for i in range(len(rows)):
        x, y, z = vectors[0, i], vectors[1, i], vectors[2, i]
        angle = np.sqrt(x * x + y * y + z * z)
        halves = np.rint(angle * (0.5 / math.pi))
        half = angle * 0.5 - halves * math.pi  # within pi / 2 of 0; of hundreds of radians less exact
        square, sine, cosine = half * half, 1.0, 1.0
        for k in range(20, 0, -2):
            sine = 1 - square * (1 / (k * (k + 1))) * sine
            cosine = 1 - square * (1 / (k * (k - 1))) * cosine
        sign = 1 - 2 * (halves - 2 * np.floor(halves * 0.5))
        factor = np.float32(sign * half * sine) / angle if angle > _SMALL_ANGLE else np.float32(0.5)
        turns[0, i], turns[1, i], turns[2, i], turns[3, i] = sign * cosine, factor * x, factor * y, factor * z
    for i in range(len(rows)):
        aw, ax, ay, az = turns[0, i], turns[1, i], turns[2, i], turns[3, i]
        bw, bx, by, bz = base[i, 0], base[i, 1], base[i, 2], base[i, 3]
        column[rows[i], 0] = aw * bw - ax * bx - ay * by - az * bz
        column[rows[i], 1] = aw * bx + ax * bw + ay * bz - az * by
        column[rows[i], 2] = aw * by - ax * bz + ay * bw + az * bx
        column[rows[i], 3] = aw * bz + ax * by - ay * bx + az * bw


def to_quaternions(vectors: Floats) -> Floats:
    """Return the unit quaternions (n, 4) of rotation vectors (3, n).

    Sines and cosines are taken in float64 and rounded: float32 ones differ from one machine to the next.
    """
    x, y, z = vectors
    angle = np.sqrt(x * x + y * y + z * z)
    half = (angle / np.float32(2)).astype(np.float64)
    factor = np.sin(half).astype(np.float32) / np.maximum(angle, _SMALL_ANGLE)
    factor[angle <= _SMALL_ANGLE] = 0.5
    return np.column_stack([np.cos(half).astype(np.float32), (factor * vectors).T])


def klt_colours(channels: Floats, transform: Floats, steps: Floats) -> Floats:
    """Return colours (C, n): the product of KLT channels (C, n) with the transform (C, C), times the steps (C,)."""
    colours = np.empty_like(channels)
    some = [k for k, channel in enumerate(channels) if channel.any()]  # the others would add 0
    size = max(1, STRIP // max(1, len(channels)))
    for start in range(0, channels.shape[1], size):
        strip = channels[:, start : start + size]
        total, part = np.zeros_like(strip), np.empty_like(strip)
        for k in some:
            total += np.multiply(transform[k][:, None], strip[k], out=part)
        np.multiply(total, steps[:, None], out=colours[:, start : start + size])
    return colours
