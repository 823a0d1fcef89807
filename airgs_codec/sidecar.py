"""The sidecar of a key unit: what must be exact. N rows of one tier, in Morton order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec import escapes
from airgs_codec.errors import FormatError
from airgs_codec.manifest import Atlas
from airgs_codec.rangecoder import Reader, encode_columns


@dataclass(frozen=True, slots=True, eq=False)
class KeySidecar:
    """Canonical means, motion classes and depths of a tier, and the escapes of its key pictures."""

    codes: NDArray[np.uint64]  # (N,) ascending Morton codes of the canonical means
    classes: NDArray[np.int16]  # (N,) motion classes, -128..127
    depths: NDArray[np.uint8]  # (N,)
    bases: list[NDArray[np.int32]]  # for each key quality: (P, N) escape bases


def pack_key_sidecar(sidecar: KeySidecar) -> bytes:
    """The bytes of key/T{k}/{n}.bin."""
    gaps = np.diff(sidecar.codes.astype(np.int64), prepend=np.int64(0))
    least = int(sidecar.classes.min())
    carried = sidecar.depths + np.uint8(1)  # static rows, 255, become 0
    columns = [(gaps, 0), (np.array([least + 128]), 0), (sidecar.classes - least, 1), (carried, 1)]
    return encode_columns([*columns, *(c for bases in sidecar.bases for c in escapes.columns(bases[None]))])


def unpack_key_sidecar(data: bytes, qualities: list[Atlas], where: str) -> KeySidecar:
    """Inverse of `pack_key_sidecar`. Raises FormatError(bad_sidecar)."""
    rows = qualities[0].rows
    reader = Reader(data, where)
    codes = np.cumsum(reader.column(rows, 0).astype(np.uint64), dtype=np.uint64)
    least = int(reader.column(1, 0)[0]) - 128
    classes, carried = least + reader.column(rows, 1), reader.column(rows, 1)
    bases = []
    for atlas in qualities:
        shape = (1, len(atlas.planes), rows)
        bases.append(escapes.bases_at(*escapes.read(reader, shape, where), shape, 0))
    reader.close()
    if int(codes[-1]) >> 63 or (codes[1:] < codes[:-1]).any():
        raise FormatError("bad_sidecar", where, "Morton codes leave 63 bits")
    if int(classes.max()) > 127 or int(carried.max()) > 255:
        raise FormatError("bad_sidecar", where, "expected classes up to 127 and depths up to 255")
    return KeySidecar(codes, classes.astype(np.int16), (carried - 1).astype(np.uint8), bases)
