"""The grid of canonical means: nested cubic cells, finer where pictures depend on them more (FORMAT.md §3). N rows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.package.tables import MAX_BITS, Grid
from airgs_codec.scene.gaussians import morton_decode, morton_encode


def cell_bits(classes: NDArray[np.int16], grid: Grid, coarser: int = 0) -> NDArray[np.int64]:
    """(N,) b of the rows with these motion classes: a cell is 2^b steps of the grid wide.

    `coarser` is that of a key quality, which multiplies the side of cells by 2^coarser.
    """
    return np.minimum(np.clip(classes.astype(np.int64) - grid.finest, 0, grid.bits) + coarser, grid.bits)


def grid_codes(means: NDArray[np.floating], classes: NDArray[np.int16], grid: Grid) -> NDArray[np.uint64]:
    """(N, 3) means -> (N,) Morton codes of their finest cells; `grid_means` is at most 2^b step / 2 off on an axis."""
    bits = cell_bits(classes, grid)[:, None]
    index = np.floor((means.astype(np.float64) - np.asarray(grid.origin)) / (grid.step or 1.0)).astype(np.int64)
    return morton_encode(index >> bits << bits)


def coarse_codes(codes: NDArray[np.uint64], classes: NDArray[np.int16], grid: Grid, coarser: int) -> NDArray[np.uint64]:
    """(N,) Morton codes of the cells of a key quality that hold cells as fine or finer, given by (N,) codes."""
    low = (3 * cell_bits(classes, grid, coarser)).astype(np.uint64)
    return codes >> low << low


def grid_means(
    codes: NDArray[np.uint64], classes: NDArray[np.int16], grid: Grid, coarser: int = 0
) -> NDArray[np.float64]:
    """(N,) Morton codes of cells as fine or finer -> (N, 3) middles of the cells of a key quality in world units."""
    middle = np.exp2(cell_bits(classes, grid, coarser))[:, None] / 2
    corner = morton_decode(coarse_codes(codes, classes, grid, coarser)).astype(np.float64)
    return np.asarray(grid.origin) + grid.step * (corner + middle)


def fit_grid(means: NDArray[np.float32], classes: NDArray[np.int16], cell: float) -> Grid:
    """The grid whose cells are `cell` motion units wide.

    Where the finest class would need more than MAX_BITS bits an axis, it shares the cells of a coarser one. Raises
    SceneError when the (N, 3) means span more than 1e30 world units.
    """
    low, high = means.min(axis=0).astype(np.float64), means.max(axis=0).astype(np.float64)
    extent = float((high - low).max())
    if not np.isfinite(extent) or extent > 1e30:
        raise SceneError(f"means span {extent:g} world units: expected at most 1e30")
    finest = int(classes.min())
    while True:
        step = cell * 2.0**finest
        origin = [_short(value, step) for value in low.tolist()]
        cells = float((high - origin).max()) / step
        if cells < 2**MAX_BITS:
            return Grid(origin, step, max(1, int(cells).bit_length()), finest)
        finest += 1


def _short(value: float, step: float) -> float:
    """At most `value`, and by less than a tenth of a step where float64 can tell: few digits, as viewers fetch them."""
    digits = 1 - math.floor(math.log10(step))
    below = round(math.floor(value * 10.0**digits) / 10.0**digits, digits)
    return below if below <= value else value
