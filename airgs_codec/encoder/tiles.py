"""Cuts a group into tiles: boxes that are halved across their longest side until there are enough of them.

N rows of a group, P tiles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.gaussians import Gaussians

INSIDE = 1.0  # per cent of the rows, at either end of an axis, that may lie outside of a box: a few are far off


def assign_tiles(means: NDArray[np.floating], count: int) -> NDArray[np.uint8]:
    """(N,) tile of each row, by its mean (N, 3): tiles hold about equally many rows; ties go by row."""
    tiles = np.zeros(len(means), np.uint8)

    def halve(rows: NDArray[np.intp], first: int, parts: int) -> None:
        if parts == 1 or not len(rows):
            tiles[rows] = first
            return
        low, high = np.percentile(means[rows], [INSIDE, 100 - INSIDE], axis=0)
        order = rows[np.argsort(means[rows, int(np.argmax(high - low))], kind="stable")]
        few = parts // 2
        middle = len(order) * few // parts
        halve(order[:middle], first, few)
        halve(order[middle:], first + few, parts - few)

    halve(np.arange(len(means)), 0, count)
    return tiles


def find_box(frames: Sequence[Gaussians], rows: NDArray[np.intp]) -> tuple[list[float], list[float]]:
    """Two opposite corners, world units, of a box that holds nearly all means of some rows in every frame.

    At either end of an axis INSIDE per cent of the rows of a frame may lie outside. Of no rows it is the origin.
    """
    if not len(rows):
        return [0.0] * 3, [0.0] * 3
    corners = np.array([np.percentile(frame.means[rows], [INSIDE, 100 - INSIDE], axis=0) for frame in frames])
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    return [float(f"{v:.6g}") for v in low], [float(f"{v:.6g}") for v in high]
