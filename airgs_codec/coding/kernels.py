"""Work on rows, a few at a time: chunks on several threads, rotations and colours of rows.

What is worked out row by row never needs more memory than a chunk of rows takes. n rows, C colour channels. Arithmetic
is in float32, within the bounds of FORMAT.md (section 5, Precision), in one order of operations: equal channels give
equal rows on every machine, however rows are cut into chunks.
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


def add_codes(values: Floats, samples: NDArray[np.uint8], bases: NDArray[np.int32], zero: int, unit: np.float32) -> None:
    """Add to values (n,) their codes times a unit: the sum of sample, base and zero; `bases` (0,): all are 0."""
    compiled = worth_compiling(_add_codes, 0)
    if compiled:
        compiled(values, samples, bases, np.int32(zero), unit)
    else:
        codes = np.add(samples, zero, dtype=np.int32)
        values += (codes + bases if len(bases) else codes).astype(np.float32) * unit


def _add_codes(
    values: Floats, samples: NDArray[np.uint8], bases: NDArray[np.int32], zero: np.int32, unit: np.float32
) -> None:
    if len(bases):
        for i in range(len(values)):
            values[i] += np.float32(np.int32(np.int32(samples[i]) + zero) + bases[i]) * unit
    else:
        for i in range(len(values)):
            values[i] += np.float32(np.int32(np.int32(samples[i]) + zero)) * unit


def change_rows(column: NDArray[Any], rows: NDArray[np.intp], base: NDArray[Any], changes: Floats) -> None:
    """Write rows (n,) of a column: those of `base` plus changes (k, n), or turned by them where they are quaternions."""
    compiled = worth_compiling(_turn if len(changes) == 4 else _add, 0)
    if compiled:
        compiled(column.reshape(-1, len(changes)), rows, base.reshape(-1, len(changes)), changes)
    else:
        values = multiply(changes.T, base) if len(changes) == 4 else base + changes.T.reshape(base.shape)
        column[consecutive(rows)] = values


def _add(column: NDArray[Any], rows: NDArray[np.intp], base: NDArray[Any], changes: Floats) -> None:
    for i in range(len(rows)):
        for k in range(len(changes)):
            column[rows[i], k] = base[i, k] + changes[k, i]


def _turn(column: Floats, rows: NDArray[np.intp], base: Floats, changes: Floats) -> None:
    for i in range(len(rows)):
        aw, ax, ay, az = changes[0, i], changes[1, i], changes[2, i], changes[3, i]
        bw, bx, by, bz = base[i, 0], base[i, 1], base[i, 2], base[i, 3]
        column[rows[i], 0] = aw * bw - ax * bx - ay * by - az * bz
        column[rows[i], 1] = aw * bx + ax * bw + ay * bz - az * by
        column[rows[i], 2] = aw * by - ax * bz + ay * bw + az * bx
        column[rows[i], 3] = aw * bz + ax * by - ay * bx + az * bw


def to_quaternions(vectors: Floats) -> Floats:
    """Return the unit quaternions (4, n) of rotation vectors (3, n).

    Sines and cosines are taken in float64 and rounded: float32 ones differ from one machine to the next.
    """
    if compiled := worth_compiling(_to_quaternions, 0):
        compiled(vectors, quaternions := np.empty((4, vectors.shape[1]), np.float32))
        return quaternions
    x, y, z = vectors
    angle = np.sqrt(x * x + y * y + z * z)
    half = (angle / np.float32(2)).astype(np.float64)
    factor = np.sin(half).astype(np.float32) / np.maximum(angle, _SMALL_ANGLE)
    factor[angle <= _SMALL_ANGLE] = 0.5
    return np.stack([np.cos(half).astype(np.float32), *(factor * vectors)])


def _to_quaternions(vectors: Floats, quaternions: Floats) -> None:
    """Fill `quaternions`, with series of sines and cosines, which machines have vectors for, of angles in -pi/2..pi/2."""
    for i in range(vectors.shape[1]):
        x, y, z = vectors[0, i], vectors[1, i], vectors[2, i]
        angle = np.sqrt(x * x + y * y + z * z)
        turns = np.rint(angle * (0.5 / math.pi))
        half = angle * 0.5 - turns * math.pi
        square, sine, cosine = half * half, 1.0, 1.0
        for k in range(20, 0, -2):
            sine = 1 - square * (1 / (k * (k + 1))) * sine
            cosine = 1 - square * (1 / (k * (k - 1))) * cosine
        sign = 1 - 2 * (turns - 2 * np.floor(turns * 0.5))
        factor = np.float32(sign * half * sine) / max(angle, _SMALL_ANGLE) if angle > _SMALL_ANGLE else np.float32(0.5)
        quaternions[0, i] = sign * cosine
        quaternions[1, i], quaternions[2, i], quaternions[3, i] = factor * x, factor * y, factor * z


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
