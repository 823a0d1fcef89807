"""The grid of canonical means: nested cubic cells, finer where pictures depend on them more (FORMAT.md §3). N rows.

It spans a box about nearly all rows. A row outside lies in a wider grid about the same middle, whose steps are 2^e
times as wide, so that it decides nothing for the others. What cells know of a row is its motion class less e: `cells`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.package.tables import GRID_BITS, Grid
from airgs_codec.scene.gaussians import morton_decode, morton_encode

HALF = 1 << (GRID_BITS - 1)  # steps from the middle of the grid to its sides
ORIGIN_STEPS = 1 << 12  # origins are multiples of so many steps: larger cells rarely begin elsewhere for a row more
INSIDE = 0.9  # share of the rows that are surely in the box
LARGEST = 1e30  # world units
EXACT = 50  # bits of a coordinate in steps that float64 holds, and halves of it


def cell_bits(cells: NDArray[np.int16], grid: Grid, coarser: int = 0) -> NDArray[np.int64]:
    """(N,) b of rows: a cell is 2^b steps of its own grid wide.

    `coarser` is that of a key quality, which multiplies the side of cells by 2^coarser.
    """
    return np.minimum(np.clip(cells.astype(np.int64) - grid.finest, 0, GRID_BITS) + coarser, GRID_BITS)


def grid_codes(
    means: NDArray[np.floating], classes: NDArray[np.int16], grid: Grid
) -> tuple[NDArray[np.uint64], NDArray[np.int16]]:
    """(N, 3) means -> (N,) Morton codes of their finest cells, and (N,) e of the grid that each lies in.

    `grid_means` is at most half a cell off on an axis.
    """
    away = means.astype(np.float64) / grid.step - _middle(grid)
    steps = np.floor(away)
    wider = np.maximum(np.frexp(np.maximum(steps, -1 - steps).max(axis=1) / HALF)[1], 0).astype(np.int16)
    index = np.floor(np.ldexp(away, -wider[:, None].astype(np.int32))).astype(np.int64) + HALF
    bits = cell_bits(classes - wider, grid)[:, None]
    return morton_encode(index >> bits << bits), wider


def _middle(grid: Grid) -> NDArray[np.float64]:
    """(3,) steps from the origin of the world to the middle of the grid."""
    return np.asarray(grid.origin, np.float64) + HALF


def coarse_codes(codes: NDArray[np.uint64], cells: NDArray[np.int16], grid: Grid, coarser: int) -> NDArray[np.uint64]:
    """(N,) Morton codes of the cells of a key quality that hold cells as fine or finer, given by (N,) codes."""
    low = (3 * cell_bits(cells, grid, coarser)).astype(np.uint64)
    return codes >> low << low


def grid_means(
    codes: NDArray[np.uint64], classes: NDArray[np.int16], wider: NDArray[np.int16], grid: Grid, coarser: int = 0
) -> NDArray[np.float64]:
    """(N,) Morton codes of cells as fine or finer -> (N, 3) middles of the cells of a key quality in world units."""
    cells = classes - wider
    half = np.exp2(cell_bits(cells, grid, coarser))[:, None] / 2
    away = morton_decode(coarse_codes(codes, cells, grid, coarser)) + half - HALF
    return grid.step * (_middle(grid) + np.ldexp(away, wider[:, None].astype(np.int32)))


def fit_grid(means: NDArray[np.float32], classes: NDArray[np.int16], cell: float) -> Grid:
    """The grid of (N, 3) means whose cells are `cell` motion units wide.

    Where the finest class would need more than GRID_BITS bits an axis for INSIDE of the rows, it shares the cells of a
    coarser one. Raises SceneError when rows are more than LARGEST apart.
    """
    middle = np.median(means, axis=0).astype(np.float64)
    apart = np.abs(means.astype(np.float64) - middle).max(axis=1)
    reach = float(np.quantile(apart, INSIDE))
    if reach > LARGEST:
        raise SceneError(f"means span {reach:g} world units: expected at most {LARGEST:g}")
    box = reach * 2 / HALF, float(np.abs(middle).max()) / 2.0**EXACT
    finest = max([int(classes.min()), *(math.ceil(math.log2(least / cell)) for least in box if least)])
    step = cell * 2.0**finest
    low = means[apart <= step * HALF / 2].min(axis=0).astype(np.float64)
    origin = np.floor(low / step / ORIGIN_STEPS).astype(np.int64) * ORIGIN_STEPS
    return Grid(origin.tolist(), step, finest)
