"""What must be exact in a keyframe tier: canonical means, motion classes and depths (FORMAT.md §3). N rows in Morton
order.

Means lie in the middle of nested cubic cells, finer where pictures depend on them more. The grid spans a box about
nearly all rows. A row outside lies in a wider grid about the same middle, whose steps are 2^e times as wide, so that it
decides nothing for the others. What cells know of a row is its motion class less e: `cells`.

All keyframe qualities share a sidecar, whose canonical means are as coarse as those of the coarsest. The file of a
quality begins with the detail that its own finer cells add.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.escapes import Escapes, read_columns
from airgs_codec.coding.motion import Classes
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_columns, sum_gaps
from airgs_codec.errors import FormatError, SceneError
from airgs_codec.package.tables import GRID_BITS, LEAST_CLASS, MOST_CLASS, MOST_WIDER, STATIC, Grid
from airgs_codec.scene.gaussians import morton_decode, morton_encode

Codes = NDArray[np.uint64]  # Morton codes
HALF = 1 << (GRID_BITS - 1)  # steps from the middle of the grid to its sides
ORIGIN_STEPS = 1 << 12  # whose multiples origins are: one row more rarely moves where larger cells begin
INSIDE = 0.9  # share of the rows that are surely in the box
MOST_REACH = 1e30  # world units
EXACT = 50  # bits of a coordinate in steps that float64 holds, and halves of it


def cell_bits(cells: Classes, grid: Grid, coarser: int = 0) -> NDArray[np.int64]:
    """Return (N,) b of rows: a cell is 2^b steps of its own grid wide.

    `coarser` is that of a keyframe quality, which multiplies the side of cells by 2^coarser.
    """
    return np.minimum(np.clip(cells.astype(np.int64) - grid.finest, 0, GRID_BITS) + coarser, GRID_BITS)


def grid_codes(means: NDArray[np.floating], classes: Classes, grid: Grid) -> tuple[Codes, Classes]:
    """Return (N,) Morton codes of the finest cells of means (N, 3), and (N,) e of the grid that each lies in.

    `grid_means` is at most half a cell off on an axis.
    """
    away = means.astype(np.float64) / grid.step - np.add(grid.origin, HALF, dtype=np.float64)
    steps = np.floor(away)
    wider = np.maximum(np.frexp(np.maximum(steps, -1 - steps).max(axis=1) / HALF)[1], 0).astype(np.int16)
    index = np.floor(np.ldexp(away, -wider[:, None].astype(np.int32))).astype(np.int64) + HALF
    bits = cell_bits(classes - wider, grid)[:, None]
    return morton_encode(index >> bits << bits), wider


def coarse_codes(codes: Codes, cells: Classes, grid: Grid, coarser: int) -> Codes:
    """Return (N,) Morton codes of the cells of a keyframe quality that hold cells as fine or finer, given by codes."""
    low = (3 * cell_bits(cells, grid, coarser)).astype(np.uint64)
    return codes >> low << low


def grid_means(codes: Codes, classes: Classes, wider: Classes, grid: Grid, coarser: int = 0) -> NDArray[np.float64]:
    """Return (N, 3) middles, in world units, of the cells of a keyframe quality that hold cells as fine or finer."""
    cells = classes - wider
    half = np.exp2(cell_bits(cells, grid, coarser))[:, None] / 2
    away = morton_decode(coarse_codes(codes, cells, grid, coarser)) + half - HALF
    return grid.step * (np.add(grid.origin, HALF, dtype=np.float64) + np.ldexp(away, wider[:, None].astype(np.int32)))


def fit_grid(means: NDArray[np.float32], classes: Classes, cell: float) -> Grid:
    """Return the grid of means (N, 3) whose cells are `cell` motion units wide.

    Where the finest class would need more than GRID_BITS bits an axis for INSIDE of the rows, it shares the cells of a
    coarser one. Raises SceneError for distances above MOST_REACH.
    """
    middle = np.median(means, axis=0).astype(np.float64)
    distances = np.abs(means.astype(np.float64) - middle).max(axis=1)
    if (reach := float(np.quantile(distances, INSIDE))) > MOST_REACH:
        raise SceneError(f"means span {reach:g} world units: expected at most {MOST_REACH:g}")
    box = reach * 2 / HALF, float(np.abs(middle).max()) / 2.0**EXACT
    finest = max([int(classes.min()), *(math.ceil(math.log2(least / cell)) for least in box if least)])
    step = cell * 2.0**finest
    low = means[distances <= step * HALF / 2].min(axis=0).astype(np.float64)
    origin = np.floor(low / step / ORIGIN_STEPS).astype(np.int64) * ORIGIN_STEPS
    return Grid(origin.tolist(), step, finest)


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeSidecar:
    """Canonical means, motion classes and depths of the rows of a tier, or of several one after another.

    Where keyframes are differences to those of an earlier group, which has the means and classes, only depths are sent.
    """

    codes: Codes  # (N,) Morton codes of the canonical means
    classes: Classes  # (N,) motion classes, -128..127
    wider: Classes  # (N,) e of the grid, 2^e times as wide, that a row lies in; 0 but far away
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none

    @property
    def cells(self) -> Classes:
        return self.classes - self.wider


def pack_keyframe_sidecar(sidecar: KeyframeSidecar, grid: Grid, coarsest: int = 0) -> bytes:
    """Return the bytes of a sidecar, a column file; `coarsest` is `coarser` of the coarsest keyframe quality."""
    carried = sidecar.depths + np.uint8(1), 1  # static rows, 255, become 0
    if not len(sidecar.codes):
        return encode_columns([carried])
    low = (3 * cell_bits(sidecar.cells, grid, coarsest)).astype(np.uint64)
    codes = coarse_codes(sidecar.codes, sidecar.cells, grid, coarsest)
    gaps = ((codes >> low) - (np.append(np.uint64(0), codes[:-1]) >> low)).astype(np.int64)
    least = int(sidecar.classes.min())
    placed = [(np.array([coarsest, least - LEAST_CLASS]), 0), (sidecar.classes - least, 1), (gaps, 0)]
    return encode_columns([*placed, carried, *Escapes.of(sidecar.wider.astype(np.int32)[None, None]).columns()])


def unpack_keyframe_sidecar(
    data: bytes, rows: int, grid: Grid, coarsest: int, where: str, depths_only: bool = False
) -> KeyframeSidecar:
    """Read what `pack_keyframe_sidecar` writes of `rows` rows, with codes of the coarsest cells; `where` names the
    file.

    Raises FormatError(bad_sidecar).
    """
    reader = ColumnReader(data, where)
    placed = 0 if depths_only else rows
    found, least = reader.column(2, 0).tolist() if placed else (coarsest, 0)
    reader.expect(found == coarsest, f"expected coarser {coarsest}, got {found}")
    classes = LEAST_CLASS + least + reader.column(placed, 1)
    gaps, carried = reader.column(placed, 0), reader.column(rows, 1)
    wider = read_columns(reader, (1, 1, placed)).bases(0)[0] if placed else np.empty(0, np.int32)
    reader.close()
    fits = int(classes.max(initial=0)) <= MOST_CLASS and int(carried.max()) <= STATIC
    reader.expect(fits, f"expected classes up to {MOST_CLASS} and depths up to {STATIC}")
    reader.expect(((wider >= 0) & (wider <= MOST_WIDER)).all(), f"expected grids 2^0 to 2^{MOST_WIDER} times as wide")
    depths = (carried - 1).astype(np.uint8)
    shared = KeyframeSidecar(gaps.astype(np.uint64), classes.astype(np.int16), wider.astype(np.int16), depths)
    codes = sum_gaps(gaps, 3 * cell_bits(shared.cells, grid, coarsest), 3 * GRID_BITS)
    if codes is None:
        raise FormatError("bad_sidecar", where, f"Morton codes leave {3 * GRID_BITS} bits")
    return replace(shared, codes=codes)


def detail_columns(sidecar: KeyframeSidecar, grid: Grid, coarser: int, coarsest: int) -> list[Column]:
    """Return what a keyframe quality adds to the codes of `pack_keyframe_sidecar`; the coarsest adds nothing."""
    if coarser == coarsest:
        return []
    low = (3 * cell_bits(sidecar.cells, grid, coarser)).astype(np.uint64)
    known = coarse_codes(sidecar.codes, sidecar.cells, grid, coarsest)
    return [(np.array([coarser]), 0), (((sidecar.codes - known) >> low).astype(np.int64), 0)]


def read_detail(
    reader: ColumnReader, sidecar: KeyframeSidecar, grid: Grid, coarser: int, coarsest: int
) -> KeyframeSidecar:
    """Return a sidecar of `unpack_keyframe_sidecar` with the codes of a keyframe quality: the inverse of
    `detail_columns`.

    Raises FormatError(bad_sidecar).
    """
    if coarser == coarsest:
        return sidecar
    found = int(reader.column(1, 0)[0])
    reader.expect(found == coarser, f"expected coarser {coarser}, got {found}")
    detail = reader.column(len(sidecar.codes), 0)
    low, high = (3 * cell_bits(sidecar.cells, grid, r) for r in (coarser, coarsest))
    reader.expect(not (detail >> (high - low)).any(), "the detail of a position leaves its cell")
    return replace(sidecar, codes=sidecar.codes | (detail << low).astype(np.uint64))
