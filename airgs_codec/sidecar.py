"""The sidecar of a key unit: what must be exact. N rows of one tier, in Morton order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec import escapes
from airgs_codec.errors import FormatError
from airgs_codec.manifest import Atlas


@dataclass(frozen=True, slots=True, eq=False)
class KeySidecar:
    """Canonical means, size classes and depths of a tier, and the escapes of its key pictures."""

    codes: NDArray[np.uint64]  # (N,) ascending Morton codes of the canonical means
    classes: NDArray[np.int16]  # (N,) size classes, -128..127
    depths: NDArray[np.uint8]  # (N,)
    bases: list[NDArray[np.int32]]  # for each key quality: (P, N) escape bases


def pack_key_sidecar(sidecar: KeySidecar) -> bytes:
    """The bytes of key/T{k}/{n}.bin."""
    gaps = np.diff(sidecar.codes, prepend=np.uint64(0)).astype("<u8")
    width = max(1, -(-int(gaps.max()).bit_length() // 8))
    planes = escapes.byte_planes(gaps)[: width * len(gaps)]
    sections = [bytes([width])]
    sections += [planes[i * len(gaps) : (i + 1) * len(gaps)] for i in range(width)]
    sections += [sidecar.classes.astype(np.int8).tobytes(), sidecar.depths.tobytes()]
    sections += [escapes.pack(bases[None]) for bases in sidecar.bases]
    return escapes.deflate(sections)


def unpack_key_sidecar(data: bytes, qualities: list[Atlas], where: str) -> KeySidecar:
    """Inverse of `pack_key_sidecar`. Raises FormatError(bad_sidecar)."""
    rows = qualities[0].rows
    most = 1 + rows * 10 + sum(4 + 12 * rows * len(atlas.planes) for atlas in qualities)
    payload = escapes.inflate(data, most, where)
    width = payload[0] if payload else 0
    if not 1 <= width <= 8 or len(payload) < 1 + (width + 2) * rows:
        raise FormatError("bad_sidecar", where, f"expected {rows} rows, got {len(payload)} bytes")
    at = 1 + width * rows
    codes = np.cumsum(escapes.from_byte_planes(payload[1:at], width), dtype=np.uint64)
    classes = np.frombuffer(payload[at : at + rows], np.int8).astype(np.int16)
    depths = np.frombuffer(payload[at + rows : at + 2 * rows], np.uint8)
    at += 2 * rows
    bases = []
    for atlas in qualities:
        shape = (1, len(atlas.planes), rows)
        index, jumps, used = escapes.unpack(payload[at:], shape, where)
        bases.append(escapes.bases_at(index, jumps, shape, 0))
        at += used
    if at != len(payload):
        raise FormatError("bad_sidecar", where, f"expected the end at {at}, got {len(payload)} bytes")
    if int(codes[-1]) >> 63 or (codes[1:] < codes[:-1]).any():
        raise FormatError("bad_sidecar", where, "Morton codes leave 63 bits")
    return KeySidecar(codes, classes, depths, bases)
