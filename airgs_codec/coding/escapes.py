"""Escapes: changes of a channel's base value, so that what is left fits 8 bits (FORMAT.md §6).

T frames, P planes, N rows; code - centre = luma - 128 + UNIT * base. A sample has base 0 until an escape changes it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_some

UNIT = 128  # codes that a base of 1 stands for
# Those in force, (N,) of each plane; None for a plane before its first jump.
Bases = Sequence[NDArray[np.int32] | None] | NDArray[np.int32]
# |luma - 128| never exceeds it as encoded. Decoded luma must stay within 16 and 235, which leaves 11 levels for the
# error of the video codec: at the QP of deltas 10 is the largest met in noise of every kind, 6 in real scenes.
LIMIT = 96


def split(codes: NDArray[np.int32]) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Return luma samples around 128 and bases, both (T, P, N), of (T, P, N) codes less their centres.

    A base stays as long as some value serves all frames since its last jump, so that no choice needs fewer jumps.
    """
    jumping = (codes > LIMIT).any(axis=0) | (codes < -LIMIT).any(axis=0)
    bases = np.zeros_like(codes)
    bases[:, jumping] = _choose_bases(codes[:, jumping])
    return (codes - UNIT * bases + 128).astype(np.uint8), bases


def _choose_bases(codes: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the bases (T, n) of (T, n) codes; those of a row that has no code beyond LIMIT would be 0."""
    low, high = -((LIMIT - codes) // UNIT), (codes + LIMIT) // UNIT  # bases that serve one frame
    first = np.zeros(codes.shape, np.bool_)  # does a new base start here
    base = least = most = np.zeros(codes.shape[1:], np.int32)
    for t in range(len(codes)):
        least, most = np.maximum(least, low[t]), np.minimum(most, high[t])
        first[t] = least > most
        least, most = np.where(first[t], low[t], least), np.where(first[t], high[t], most)
        low[t], high[t] = least, most
    for t in range(len(codes) - 2, -1, -1):  # the last frame of a run has the bases that serve all of it
        low[t], high[t] = np.where(first[t + 1], (low[t], high[t]), (low[t + 1], high[t + 1]))
    bases = np.empty_like(codes)
    for t in range(len(codes)):
        base = np.where(first[t], np.clip(base, low[t], high[t]), base)
        bases[t] = base
    return bases


@dataclass(frozen=True, slots=True, eq=False)
class Escapes:
    """The E jumps of the bases of a segment."""

    shape: tuple[int, ...]  # T, P, N
    index: NDArray[np.int64]  # (E,) ascending flat indices into the shape
    jumps: NDArray[np.int32]  # (E,)

    @staticmethod
    def of(bases: NDArray[np.int32]) -> Escapes:
        if not bases.any():
            return Escapes(bases.shape, np.empty(0, np.int64), np.empty(0, np.int32))
        jumps = np.diff(bases, axis=0, prepend=np.zeros_like(bases[:1])).ravel()
        index = np.flatnonzero(jumps)
        return Escapes(bases.shape, index, jumps[index])

    @staticmethod
    def join(planes: Sequence[Escapes]) -> Escapes:
        """Return the jumps of several planes, at least one, each of which has the same T and N."""
        frames, _, rows = planes[0].shape
        area = rows * len(planes)
        index = np.concatenate([e.index // rows * area + p * rows + e.index % rows for p, e in enumerate(planes)])
        order = np.argsort(index)
        jumps = np.concatenate([part.jumps for part in planes])
        return Escapes((frames, len(planes), rows), index[order], jumps[order])

    def columns(self) -> list[Column]:
        """Return the columns of a file: how many jumps, gaps of flat indices, sizes in zigzag coding."""
        values = self.jumps.astype(np.int64)
        zigzag = (values << 1) ^ (values >> 63)
        return [(np.array([len(self.index)]), 0), (np.diff(self.index, prepend=0), 0), (zigzag, 1)]

    def bases(self, frame: int) -> NDArray[np.int32]:
        """Return the bases (P, N) in force at a frame, counted from the start of the segment."""
        bases = np.zeros(self.shape[1:], np.int32)
        upto = np.searchsorted(self.index, (frame + 1) * bases.size)
        np.add.at(bases.reshape(-1), self.index[:upto] % max(1, bases.size), self.jumps[:upto])
        return bases

    def running(self) -> Iterator[Bases]:
        """Yield the bases of one frame after the other, the same arrays every time."""
        frames, planes, rows = self.shape
        starts = np.arange(frames * planes + 1) * rows
        spans = itertools.pairwise(np.searchsorted(self.index, starts).tolist())
        bases: list[NDArray[np.int32] | None] = [None] * planes
        for frame in range(frames):
            for plane, (start, stop) in enumerate(itertools.islice(spans, planes)):
                if start < stop:
                    jumped = np.zeros(rows, np.int32) if (before := bases[plane]) is None else before
                    jumped[self.index[start:stop] - starts[frame * planes + plane]] += self.jumps[start:stop]
                    bases[plane] = jumped
            yield bases


def read_columns(reader: ColumnReader, shape: tuple[int, ...]) -> Escapes:
    """Read what `Escapes.columns` writes of bases of `shape` (T, P, N).

    Raises FormatError(bad_sidecar) when there are more jumps than samples, an index leaves the shape or a jump 31 bits.
    """
    area, count = math.prod(shape), int(reader.column(1, 0)[0])
    reader.expect(count <= area, f"expected at most {area} escapes, got {count}")
    gaps, zigzag = reader.column(count, 0), reader.column(count, 1)
    ascend = not count or (int(gaps.max()) < area and (gaps[1:] > 0).all() and int(gaps.sum()) < area)
    reader.expect(ascend, "escapes are not in ascending order inside the segment")
    reader.expect(int(zigzag.max(initial=0)) < 1 << 32, "an escape jumps by more than 31 bits")
    half, sign = (zigzag >> 1).astype(np.int32), (zigzag & 1).astype(np.int32)
    return Escapes(shape, np.cumsum(gaps, out=gaps), np.bitwise_xor(half, -sign, out=half))


def pack(*found: Escapes) -> bytes:
    return encode_some([column for one in found for column in one.columns()])


def unpack_segment(
    data: bytes | None, shape: tuple[int, int, int], sloped: bool, where: str
) -> tuple[Escapes | None, Escapes]:
    """Read the escapes of a segment of `shape` (T, P, N), behind those of its slopes where it is `sloped`."""
    reader = ColumnReader(data, where)
    slopes = read_columns(reader, (1, *shape[1:])) if sloped else None
    frames = read_columns(reader, shape)
    reader.close()
    return slopes, frames
