"""The visual hull of masks: the cells of space that almost every camera that sees them has in its mask.

Cells are halved where masks may have a part of them. P cells, H x W pixels; lengths in world units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.masks import Mask, closed, grown
from airgs_codec.scene.camera import Camera
from airgs_codec.trainer.fit.points import looked_at, project

CELLS = 48  # along each side of the box at first
HALVED = 2  # times
SEEN = 0.4  # share of all cameras that see a cell of the hull
FEWEST = 3  # cameras that see it
CORNER = math.sqrt(3) / 2  # of a cell, from its centre, in sides


@dataclass(frozen=True, slots=True, eq=False)
class Hull:
    """Cells of one size."""

    centres: NDArray[np.float64]  # (P, 3)
    side: float


def visual_hull(cameras: Sequence[Camera], masks: Sequence[Mask], share: float) -> Hull:
    """The hull of the masks (H, W) of cameras, in a box around what they look at that reaches to half of them.

    `share`: of the cameras that see a cell have it in their masks, or all but one.
    """
    centre = looked_at(cameras)
    reach = float(np.median([np.linalg.norm(camera.position - centre) for camera in cameras]))
    side = 2 * reach / CELLS
    along = (np.arange(CELLS) + 0.5) * side - reach
    cells = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3) + centre
    children = np.stack(np.meshgrid(*[(-0.25, 0.25)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(HALVED):
        cells = cells[_supported(cells, side * CORNER, cameras, masks, share)]
        cells = (cells[:, None] + children * side).reshape(-1, 3)
        side /= 2
    return Hull(cells[_supported(cells, 0.0, cameras, masks, share)], side)


def silhouette(hull: Hull, camera: Camera) -> Mask:
    """(H, W) the pixels where a camera sees a hull."""
    seen = np.zeros((camera.height, camera.width), np.bool_)
    rows, columns, inside = project(camera, hull.centres)
    seen[rows, columns] = True
    return closed(seen, _pixels(hull.side * CORNER, camera, hull.centres[inside]))


def _supported(
    cells: NDArray[np.float64], radius: float, cameras: Sequence[Camera], masks: Sequence[Mask], share: float
) -> NDArray[np.bool_]:
    """(P,) the cells of which masks have a point within a radius."""
    seen, agree = np.zeros(len(cells), int), np.zeros(len(cells), int)
    for camera, mask in zip(cameras, masks, strict=True):
        rows, columns, inside = project(camera, cells)
        seen[inside] += 1
        agree[inside] += (grown(mask, _pixels(radius, camera, cells[inside])) if radius else mask)[rows, columns]
    enough = seen >= max(FEWEST, SEEN * len(cameras))
    return enough & (seen - agree <= np.maximum(1, (1 - share) * seen))


def _pixels(radius: float, camera: Camera, points: NDArray[np.float64]) -> int:
    """How large a camera sees a radius where half of the points (P, 3) are; at least a pixel."""
    depths = points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    return max(1, math.ceil(radius * camera.fx / np.median(depths))) if len(points) else 1
