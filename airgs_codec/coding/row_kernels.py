"""Loops over rows that numba compiles: codes out of pictures, and what decoded channels make of rows.

One file on purpose: numba's cache does not notice edits in imported files. All of them let other threads run.

N rows of a group, n rows that are worked on, C colour channels, P planes. Arithmetic is in float32, within the bounds
of FORMAT.md (section 5, Precision): a float64 or whole constant would make it slower (`f4`). A place that is unsigned
(`uintp`) is not tested for counting from the end.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from airgs_codec.coding import escapes
from airgs_codec.package.tables import BLOCK

f4 = np.float32
UNIT = np.int32(escapes.UNIT)
_cell = np.arange(BLOCK**2)
CELL_Y, CELL_X = (  # line and column of each cell of a block, along a Z-curve
    np.sum([(_cell >> (2 * bit + odd) & 1) << bit for bit in range(4)], axis=0).astype(np.uintp) for odd in (1, 0)
)
SMALL_ANGLE = f4(1e-8)  # below it sin(a/2)/a is 1/2, as in `scene.gaussians`
STRIP = 256  # rows whose colours are summed up together: a sum of all of them stays in the first cache


@njit(cache=True, nogil=True)
def read_planes(picture, corners, blocks_wide, bases, first, out):
    """Fill lines of `out` with (H, W) luma of the rows from `first` on; the picture must hold them.

    `corners` (P, 4): of each plane its line of `out`, top, left, and what is added to luma. `bases` (P, N): how many
    UNIT are added to each sample; of no rows where none are.
    """
    cells = len(CELL_X)
    for plane in range(len(corners)):
        line, top, left, centre = corners[plane]
        at = 0
        while at < out.shape[1]:
            block, cell = divmod(first + at, cells)
            y = np.uintp(top + block // blocks_wide * BLOCK)
            x = np.uintp(left + block % blocks_wide * BLOCK)
            count = min(cells - cell, out.shape[1] - at)
            samples, cell_y, cell_x = out[line, at : at + count], CELL_Y[cell:], CELL_X[cell:]
            for i in range(count):
                samples[i] = picture[y + cell_y[i], x + cell_x[i]] + centre
            at += count
        if bases.shape[1]:
            samples, added = out[line], bases[plane, first : first + out.shape[1]]
            for i in range(len(samples)):
                samples[i] += UNIT * added[i]


@njit(cache=True, nogil=True)
def _turn(x, y, z):
    """The unit quaternion of a rotation vector."""
    angle = math.sqrt(x * x + y * y + z * z)
    half = angle / f4(2)
    factor = math.sin(half) / angle if angle > SMALL_ANGLE else f4(0.5)
    return math.cos(half), factor * x, factor * y, factor * z


@njit(cache=True, nogil=True)
def to_quaternions(vectors, quaternions):
    """Rotation vectors (3, n) -> unit quaternions (n, 4)."""
    for i in range(len(quaternions)):
        w, x, y, z = _turn(vectors[0, i], vectors[1, i], vectors[2, i])
        quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3] = w, x, y, z


@njit(cache=True, nogil=True)
def turn_rows(vectors, base, rows, quaternions):
    """Write the product of rotation vectors (3, n) and quaternions `base` (N, 4) to some rows (n,) of (N, 4)."""
    for i in range(len(rows)):
        r = np.uintp(rows[i])
        aw, ax, ay, az = _turn(vectors[0, i], vectors[1, i], vectors[2, i])
        bw, bx, by, bz = base[r, 0], base[r, 1], base[r, 2], base[r, 3]
        quaternions[r, 0] = aw * bw - ax * bx - ay * by - az * bz
        quaternions[r, 1] = aw * bx + ax * bw + ay * bz - az * by
        quaternions[r, 2] = aw * by - ax * bz + ay * bw + az * bx
        quaternions[r, 3] = aw * bz + ax * by - ay * bx + az * bw


@njit(cache=True, nogil=True)
def add_colours(channels, transform, steps, rows, colours):
    """Add to some rows (n,) of (N, C) colours what (C, n) KLT channels make: their product with (C, C), times steps."""
    total = np.empty(STRIP, np.float32)
    for start in range(0, len(rows), STRIP):
        count = min(STRIP, len(rows) - start)
        some = rows[start : start + count]
        for c in range(len(steps)):
            total[:] = f4(0)
            for k in range(len(channels)):
                weight, channel = transform[k, c], channels[k, start : start + count]
                for i in range(count):
                    total[i] += weight * channel[i]
            for i in range(count):
                colours[np.uintp(some[i]), c] += total[i] * steps[c]


@njit(cache=True, nogil=True)
def move_rows(channels, units, base, rows, means):
    """Write to some rows (n,) of `means` (N, 3) those of `base` (N, 3) moved by (3, n) channels in units (N,)."""
    for i in range(len(rows)):
        r = np.uintp(rows[i])
        for axis in range(3):
            means[r, axis] = f4(base[r, axis] + channels[axis, i] * units[r])


@njit(cache=True, nogil=True)
def add_rows(channels, rows, values):
    """Add (3, n) channels to some rows (n,) of (N, 3) values."""
    for i in range(len(rows)):
        r = np.uintp(rows[i])
        for axis in range(3):
            values[r, axis] += channels[axis, i]


@njit(cache=True, nogil=True)
def copy_rows(values, rows, columns):
    """Write the first columns of some rows (n,) of `values` to those of `columns` (N, 3)."""
    for i in range(len(rows)):
        r = np.uintp(rows[i])
        for c in range(3):
            columns[r, c] = values[r, c]
