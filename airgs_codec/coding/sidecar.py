"""What must be exact in a key tier (FORMAT.md §3). N rows of a tier in Morton order.

All key qualities share a sidecar, whose canonical means are as coarse as those of the coarsest. The file of a quality
begins with the detail that its own finer cells add.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.grid import cell_bits, coarse_codes
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_columns, sum_gaps
from airgs_codec.errors import FormatError
from airgs_codec.package.tables import LEAST_CLASS, MOST_CLASS, STATIC, Grid


@dataclass(frozen=True, slots=True, eq=False)
class KeySidecar:
    """Canonical means, motion classes and depths of the rows of a tier, or of several one after another.

    Where keys are differences to those of an earlier group, which has the means and classes, there are depths alone.
    """

    codes: NDArray[np.uint64]  # (N,) Morton codes of the canonical means
    classes: NDArray[np.int16]  # (N,) motion classes, -128..127
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none


def pack_key_sidecar(sidecar: KeySidecar, grid: Grid, coarsest: int = 0) -> bytes:
    """The bytes of key/T{k}/{n}.bin, a column file; `coarsest` is `coarser` of the coarsest key quality."""
    carried = sidecar.depths + np.uint8(1), 1  # static rows, 255, become 0
    positions = _position_columns(sidecar, grid, coarsest) if len(sidecar.codes) else []
    return encode_columns([*positions, carried])


def _position_columns(sidecar: KeySidecar, grid: Grid, coarsest: int) -> list[Column]:
    low = (3 * cell_bits(sidecar.classes, grid, coarsest)).astype(np.uint64)
    codes = coarse_codes(sidecar.codes, sidecar.classes, grid, coarsest)
    before = np.concatenate([np.zeros(1, np.uint64), codes[:-1]])
    gaps = ((codes >> low) - (before >> low)).astype(np.int64)
    least = int(sidecar.classes.min())
    return [(np.array([least - LEAST_CLASS]), 0), (sidecar.classes - least, 1), (gaps, 0)]


def unpack_key_sidecar(
    data: bytes, rows: int, grid: Grid, coarsest: int, where: str, depths_alone: bool = False
) -> KeySidecar:
    """Inverse of `pack_key_sidecar` for so many rows, with their codes in the coarsest cells; `where` names the file.

    Raises FormatError(bad_sidecar).
    """
    reader = ColumnReader(data, where)
    placed = 0 if depths_alone else rows
    least = LEAST_CLASS + int(reader.column(min(1, placed), 0).sum())
    classes = least + reader.column(placed, 1)
    gaps, carried = reader.column(placed, 0), reader.column(rows, 1)
    reader.close()
    if int(classes.max(initial=0)) > MOST_CLASS or int(carried.max()) > STATIC:
        raise FormatError("bad_sidecar", where, f"expected classes up to {MOST_CLASS} and depths up to {STATIC}")
    codes = sum_gaps(gaps, 3 * cell_bits(classes.astype(np.int16), grid, coarsest), 3 * grid.bits)
    if codes is None:
        raise FormatError("bad_sidecar", where, f"Morton codes leave {3 * grid.bits} bits")
    return KeySidecar(codes, classes.astype(np.int16), (carried - 1).astype(np.uint8))


def detail_columns(sidecar: KeySidecar, grid: Grid, coarser: int, coarsest: int) -> list[Column]:
    """Return what a key quality adds to the codes that `pack_key_sidecar` writes; the coarsest adds nothing."""
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
