"""What must be exact in a key tier (FORMAT.md §3). N rows of a tier in Morton order.

All key qualities share a sidecar, whose canonical means are as coarse as those of the coarsest. The file of a quality
begins with the detail that its own finer cells add.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.escapes import Escapes, read_columns
from airgs_codec.coding.grid import cell_bits, coarse_codes
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_columns, sum_gaps
from airgs_codec.errors import FormatError
from airgs_codec.package.tables import GRID_BITS, LEAST_CLASS, MOST_CLASS, MOST_WIDER, STATIC, Grid


@dataclass(frozen=True, slots=True, eq=False)
class KeySidecar:
    """Canonical means, motion classes and depths of the rows of a tier, or of several one after another.

    Where keys are differences to those of an earlier group, which has the means and classes, there are depths alone.
    """

    codes: NDArray[np.uint64]  # (N,) Morton codes of the canonical means
    classes: NDArray[np.int16]  # (N,) motion classes, -128..127
    wider: NDArray[np.int16]  # (N,) e of the grid, 2^e times as wide, that a row lies in; 0 but far away
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none

    @property
    def cells(self) -> NDArray[np.int16]:
        """(N,) what cells know of the rows (`coding.grid`)."""
        return self.classes - self.wider


def pack_key_sidecar(sidecar: KeySidecar, grid: Grid, coarsest: int = 0) -> bytes:
    """The bytes of key/T{k}/{n}.bin, a column file; `coarsest` is `coarser` of the coarsest key quality."""
    carried = sidecar.depths + np.uint8(1), 1  # static rows, 255, become 0
    if not len(sidecar.codes):
        return encode_columns([carried])
    wider = Escapes.of(sidecar.wider.astype(np.int32)[None, None]).columns()
    return encode_columns([*_position_columns(sidecar, grid, coarsest), carried, *wider])


def _position_columns(sidecar: KeySidecar, grid: Grid, coarsest: int) -> list[Column]:
    low = (3 * cell_bits(sidecar.cells, grid, coarsest)).astype(np.uint64)
    codes = coarse_codes(sidecar.codes, sidecar.cells, grid, coarsest)
    before = np.concatenate([np.zeros(1, np.uint64), codes[:-1]])
    gaps = ((codes >> low) - (before >> low)).astype(np.int64)
    least = int(sidecar.classes.min())
    return [(np.array([coarsest, least - LEAST_CLASS]), 0), (sidecar.classes - least, 1), (gaps, 0)]


def unpack_key_sidecar(
    data: bytes, rows: int, grid: Grid, coarsest: int, where: str, depths_alone: bool = False
) -> KeySidecar:
    """Inverse of `pack_key_sidecar` for so many rows, with their codes in the coarsest cells; `where` names the file.

    Raises FormatError(bad_sidecar).
    """
    reader = ColumnReader(data, where)
    placed = 0 if depths_alone else rows
    first = reader.column(2 if placed else 0, 0)
    _expect_cells(first[:1], coarsest, where)
    classes = LEAST_CLASS + int(first[1:].sum()) + reader.column(placed, 1)
    gaps, carried = reader.column(placed, 0), reader.column(rows, 1)
    wider = read_columns(reader, (1, 1, placed)).bases(0)[0] if placed else np.empty(0, np.int32)
    reader.close()
    if int(classes.max(initial=0)) > MOST_CLASS or int(carried.max()) > STATIC:
        raise FormatError("bad_sidecar", where, f"expected classes up to {MOST_CLASS} and depths up to {STATIC}")
    if not ((wider >= 0) & (wider <= MOST_WIDER)).all():
        raise FormatError("bad_sidecar", where, f"expected rows in a grid 2^0 to 2^{MOST_WIDER} times as wide")
    depths = (carried - 1).astype(np.uint8)
    shared = KeySidecar(gaps.astype(np.uint64), classes.astype(np.int16), wider.astype(np.int16), depths)
    codes = sum_gaps(gaps, 3 * cell_bits(shared.cells, grid, coarsest), 3 * GRID_BITS)
    if codes is None:
        raise FormatError("bad_sidecar", where, f"Morton codes leave {3 * GRID_BITS} bits")
    return replace(shared, codes=codes)


def detail_columns(sidecar: KeySidecar, grid: Grid, coarser: int, coarsest: int) -> list[Column]:
    """Return what a key quality adds to the codes that `pack_key_sidecar` writes; the coarsest adds nothing."""
    if coarser == coarsest:
        return []
    low = (3 * cell_bits(sidecar.cells, grid, coarser)).astype(np.uint64)
    known = coarse_codes(sidecar.codes, sidecar.cells, grid, coarsest)
    return [(np.array([coarser]), 0), (((sidecar.codes - known) >> low).astype(np.int64), 0)]


def read_detail(reader: ColumnReader, sidecar: KeySidecar, grid: Grid, coarser: int, coarsest: int) -> KeySidecar:
    """A sidecar of `unpack_key_sidecar` with the codes of a key quality: the inverse of `detail_columns`.

    Raises FormatError(bad_sidecar).
    """
    if coarser == coarsest:
        return sidecar
    _expect_cells(reader.column(1, 0), coarser, reader.where)
    low, high = (3 * cell_bits(sidecar.cells, grid, r) for r in (coarser, coarsest))
    detail = reader.column(len(low), 0)
    if (detail >> (high - low)).any():
        raise FormatError("bad_sidecar", reader.where, "the detail of a position leaves its cell")
    return replace(sidecar, codes=sidecar.codes | (detail << low).astype(np.uint64))


def _expect_cells(told: NDArray[np.int64], coarser: int, where: str) -> None:
    """Raise FormatError(bad_sidecar) where a file is of cells other than airgs.json says: all codes would be wrong."""
    if (told != coarser).any():
        raise FormatError("bad_sidecar", where, f"expected coarser {coarser}, got {told[0]}")
