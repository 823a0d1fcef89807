"""Escapes: changes of a channel's base value, so that what is left fits 8 bits. T frames, P planes, N rows.

code = 128-centred luma level + UNIT * base; the base of a sample is 0 until an escape changes it.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import FormatError

UNIT = 128  # codes a base counts
LIMIT = 108  # |code - UNIT * base| never exceeds it; 20 levels are left for the video codec's error


def split(codes: NDArray[np.int32]) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """(T, P, N) codes -> luma samples around 128, and the bases (T, P, N). Nothing is clipped."""
    bases = np.empty_like(codes)
    base = np.zeros(codes.shape[1:], np.int32)
    for t, frame in enumerate(codes):
        far = np.abs(frame - UNIT * base) > LIMIT
        base = np.where(far, np.rint(frame / UNIT).astype(np.int32), base)
        bases[t] = base
    return (codes - UNIT * bases + 128).astype(np.uint8), bases


def pack(bases: NDArray[np.int32]) -> bytes:
    """Jumps of the bases as count, index differences and jumps, each array in byte planes."""
    jumps = np.diff(bases, axis=0, prepend=np.zeros_like(bases[:1])).ravel()
    index = np.flatnonzero(jumps)
    values = jumps[index]
    zigzag = ((values << 1) ^ (values >> 31)).astype("<u4")
    gaps = np.diff(index, prepend=0).astype("<u8")
    return b"".join([np.array([len(index)], "<u4").tobytes(), byte_planes(gaps), byte_planes(zigzag)])


def unpack(
    payload: memoryview, shape: tuple[int, int, int], where: str
) -> tuple[NDArray[np.int64], NDArray[np.int32], int]:
    """Inverse of `pack`: ascending flat indices into (T, P, N), the jumps there, and the bytes read.

    Raises FormatError(bad_sidecar) when an index leaves the shape or the payload is too short.
    """
    if len(payload) < 4:
        raise FormatError("bad_sidecar", where, "expected a count of escapes, got the end")
    count = int(np.frombuffer(payload[:4], "<u4")[0])
    if len(payload) < 4 + 12 * count:
        raise FormatError("bad_sidecar", where, f"expected {count} escapes, got {len(payload) - 4} bytes")
    gaps = from_byte_planes(payload[4 : 4 + 8 * count], 8)
    zigzag = from_byte_planes(payload[4 + 8 * count : 4 + 12 * count], 4)
    if count and int(gaps.max()) >= 1 << 40:
        raise FormatError("bad_sidecar", where, "an escape lies outside the segment")
    index = np.cumsum(gaps.astype(np.int64))
    if count and (int(index[-1]) >= int(np.prod(shape, dtype=np.int64)) or (gaps[1:] == 0).any()):
        raise FormatError("bad_sidecar", where, "escapes are not in ascending order inside the segment")
    jumps = (zigzag >> 1).astype(np.int64) ^ -(zigzag & 1).astype(np.int64)
    return index, jumps.astype(np.int32), 4 + 12 * count


def bases_at(
    index: NDArray[np.int64], jumps: NDArray[np.int32], shape: tuple[int, int, int], frame: int
) -> NDArray[np.int32]:
    """(P, N) bases in force at `frame` of the segment."""
    area = shape[1] * shape[2]
    upto = np.searchsorted(index, (frame + 1) * area)
    bases = np.zeros(area, np.int32)
    np.add.at(bases, index[:upto] % area, jumps[:upto])
    return bases.reshape(shape[1:])


def byte_planes(values: NDArray[np.unsignedinteger]) -> bytes:
    """(M,) little-endian integers -> all lowest bytes, then all second bytes, and so on."""
    return values.view(np.uint8).reshape(len(values), values.itemsize).T.tobytes()


def from_byte_planes(payload: memoryview | bytes, width: int) -> NDArray[np.uint64]:
    """Inverse of `byte_planes` for `width` bytes a value, as (M,) uint64."""
    planes = np.frombuffer(payload, np.uint8).reshape(width, -1)
    wide = np.zeros((planes.shape[1], 8), np.uint8)
    wide[:, :width] = planes.T
    return wide.view("<u8")[:, 0]


def deflate(sections: list[bytes]) -> bytes:
    """One zlib stream; each section starts a new block, so each gets Huffman codes of its own."""
    packer = zlib.compressobj(9)
    parts = [packer.compress(sections[0])]
    for section in sections[1:]:
        parts += [packer.flush(zlib.Z_FULL_FLUSH), packer.compress(section)]
    return b"".join([*parts, packer.flush()])


def inflate(data: bytes, most: int, where: str) -> memoryview:
    """Inverse of `deflate`. Raises FormatError(bad_sidecar) past `most` bytes: no decompression bombs."""
    unpacker = zlib.decompressobj()
    try:
        payload = unpacker.decompress(data, most + 1)
    except zlib.error as error:
        raise FormatError("bad_sidecar", where, f"expected a zlib stream: {error}") from error
    if len(payload) > most or not unpacker.eof or unpacker.unused_data:
        raise FormatError("bad_sidecar", where, f"expected one zlib stream of at most {most} bytes")
    return memoryview(payload)
