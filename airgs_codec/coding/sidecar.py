"""What must be exact in a key unit (FORMAT.md §3). N rows, in Morton order within a tier.

All key qualities share a sidecar, whose canonical means are as coarse as those of the coarsest. The file of a quality
begins with the detail that its own finer cells add.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.grid import cell_bits, coarse_codes
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_columns, sum_gaps
from airgs_codec.errors import FormatError
from airgs_codec.package.tables import Grid


@dataclass(frozen=True, slots=True, eq=False)
class KeySidecar:
    """Canonical means, motion classes and depths of the rows of a tier, or of several one after another."""

    codes: NDArray[np.uint64]  # (N,) Morton codes of the canonical means
    classes: NDArray[np.int16]  # (N,) motion classes, -128..127
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none


def join_sidecars(parts: Sequence[KeySidecar]) -> KeySidecar:
    """The rows of several tiers, one after another."""
    return KeySidecar(
        np.concatenate([part.codes for part in parts]),
        np.concatenate([part.classes for part in parts]),
        np.concatenate([part.depths for part in parts]),
    )


def pack_key_sidecar(sidecar: KeySidecar, grid: Grid, coarsest: int = 0) -> bytes:
    """The bytes of key/T{k}/{n}.bin, a column file; `coarsest` is `coarser` of the coarsest key quality."""
    low = (3 * cell_bits(sidecar.classes, grid, coarsest)).astype(np.uint64)
    codes = coarse_codes(sidecar.codes, sidecar.classes, grid, coarsest)
    before = np.concatenate([np.zeros(1, np.uint64), codes[:-1]])
    gaps = ((codes >> low) - (before >> low)).astype(np.int64)
    least = int(sidecar.classes.min())
    carried = sidecar.depths + np.uint8(1)  # static rows, 255, become 0
    columns = [(np.array([least + 128]), 0), (sidecar.classes - least, 1), (gaps, 0), (carried, 1)]
    return encode_columns(columns)


def unpack_key_sidecar(data: bytes, rows: int, grid: Grid, coarsest: int, where: str) -> KeySidecar:
    """Inverse of `pack_key_sidecar` for `rows` rows, whose codes it gives as those of the coarsest cells.

    `where` names the file. Raises FormatError(bad_sidecar).
    """
    reader = ColumnReader(data, where)
    classes = int(reader.column(1, 0)[0]) - 128 + reader.column(rows, 1)
    gaps, carried = reader.column(rows, 0), reader.column(rows, 1)
    reader.close()
    if int(classes.max()) > 127 or int(carried.max()) > 255:
        raise FormatError("bad_sidecar", where, "expected classes up to 127 and depths up to 255")
    codes = np.empty(rows, np.uint64)
    if not sum_gaps(gaps, 3 * cell_bits(classes.astype(np.int16), grid, coarsest), 3 * grid.bits, codes):
        raise FormatError("bad_sidecar", where, f"Morton codes leave {3 * grid.bits} bits")
    return KeySidecar(codes, classes.astype(np.int16), (carried - 1).astype(np.uint8))


def detail_columns(sidecar: KeySidecar, grid: Grid, coarser: int, coarsest: int) -> list[Column]:
    """What a key quality adds to the codes that `pack_key_sidecar` writes; the coarsest adds nothing."""
    if coarser == coarsest:
        return []
    low = (3 * cell_bits(sidecar.classes, grid, coarser)).astype(np.uint64)
    known = coarse_codes(sidecar.codes, sidecar.classes, grid, coarsest)
    return [(((sidecar.codes - known) >> low).astype(np.int64), 0)]


def read_detail(reader: ColumnReader, sidecar: KeySidecar, grid: Grid, coarser: int, coarsest: int) -> KeySidecar:
    """A sidecar of `unpack_key_sidecar` with the codes of a key quality: the inverse of `detail_columns`.

    Raises FormatError(bad_sidecar).
    """
    if coarser == coarsest:
        return sidecar
    low, high = (3 * cell_bits(sidecar.classes, grid, r) for r in (coarser, coarsest))
    detail = reader.column(len(low), 0)
    if (detail >> (high - low)).any():
        raise FormatError("bad_sidecar", reader.where, "the detail of a position leaves its cell")
    return replace(sidecar, codes=sidecar.codes | (detail << low).astype(np.uint64))
