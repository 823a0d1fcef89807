"""What must be exact in a key unit (FORMAT.md §3). K kept rows of a tier, then N others in Morton order.

All key qualities share a sidecar, whose canonical means are as coarse as those of the coarsest. The file of a quality
begins with the detail that its own finer cells add.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.grid import cell_bits, coarse_codes
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_columns, sum_gaps
from airgs_codec.errors import FormatError
from airgs_codec.package.tables import LEAST_CLASS, MOST_CLASS, STATIC, Grid


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """The rows of a tier that are rows of the same tier of an earlier group."""

    rows: NDArray[np.intp]  # (K,) their places there, ascending
    depths: NDArray[np.uint8]  # (K,) deepest level that carries a row; STATIC: none


NOTHING_KEPT = Kept(np.empty(0, np.intp), np.empty(0, np.uint8))


@dataclass(frozen=True, slots=True, eq=False)
class KeySidecar:
    """Canonical means, motion classes and depths of the rows of a tier, or of several one after another."""

    codes: NDArray[np.uint64]  # (N,) Morton codes of the canonical means
    classes: NDArray[np.int16]  # (N,) motion classes, -128..127
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none
    kept: Kept = field(default=NOTHING_KEPT)  # the rows of the tier before these


def pack_key_sidecar(sidecar: KeySidecar, grid: Grid, coarsest: int = 0) -> bytes:
    """The bytes of key/T{k}/{n}.bin, a column file; `coarsest` is `coarser` of the coarsest key quality."""
    kept = sidecar.kept
    columns: list[Column] = []
    if len(kept.rows):
        columns += [(np.diff(kept.rows, prepend=-1) - 1, 1), (kept.depths + np.uint8(1), 1)]  # static rows, 255, are 0
    if len(sidecar.codes):
        columns += _position_columns(sidecar, grid, coarsest)
    return encode_columns(columns)


def _position_columns(sidecar: KeySidecar, grid: Grid, coarsest: int) -> list[Column]:
    low = (3 * cell_bits(sidecar.classes, grid, coarsest)).astype(np.uint64)
    codes = coarse_codes(sidecar.codes, sidecar.classes, grid, coarsest)
    before = np.concatenate([np.zeros(1, np.uint64), codes[:-1]])
    gaps = ((codes >> low) - (before >> low)).astype(np.int64)
    least = int(sidecar.classes.min())
    carried = sidecar.depths + np.uint8(1)  # static rows, 255, become 0
    return [(np.array([least - LEAST_CLASS]), 0), (sidecar.classes - least, 1), (gaps, 0), (carried, 1)]


def unpack_key_sidecar(
    data: bytes, rows: int, grid: Grid, coarsest: int, where: str, kept: tuple[int, int] = (0, 0)
) -> KeySidecar:
    """Inverse of `pack_key_sidecar` for `rows` rows that are not kept, with their codes in the coarsest cells.

    `kept`: how many rows are kept, and how many the tier has in the group that they are of. `where` names the file.
    Raises FormatError(bad_sidecar).
    """
    reader = ColumnReader(data, where)
    found = _read_kept(reader, *kept) if kept[0] else NOTHING_KEPT
    none = KeySidecar(np.empty(0, np.uint64), np.empty(0, np.int16), np.empty(0, np.uint8))
    sidecar = _read_positions(reader, rows, grid, coarsest) if rows else none
    reader.close()
    return replace(sidecar, kept=found)


def _read_kept(reader: ColumnReader, count: int, there: int) -> Kept:
    """So many kept rows, of `there` rows."""
    gaps, carried = reader.column(count, 1), reader.column(count, 1)
    if int(gaps.max()) >= there or int((gaps + 1).sum()) > there or int(carried.max()) > STATIC:
        raise FormatError("bad_sidecar", reader.where, f"expected kept rows below {there} and depths up to {STATIC}")
    return Kept(np.cumsum(gaps + 1).astype(np.intp) - 1, (carried - 1).astype(np.uint8))


def _read_positions(reader: ColumnReader, rows: int, grid: Grid, coarsest: int) -> KeySidecar:
    classes = int(reader.column(1, 0)[0]) + LEAST_CLASS + reader.column(rows, 1)
    gaps, carried = reader.column(rows, 0), reader.column(rows, 1)
    where = reader.where
    if int(classes.max()) > MOST_CLASS or int(carried.max()) > STATIC:
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
