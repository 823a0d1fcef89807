"""Which pixel of a camera's picture a point falls into. P points, n of them inside the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.render import Camera


def project(
    camera: Camera, points: NDArray[np.floating]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Rows (n,) and columns (n,) of the pixels that points (P, 3) fall into, and which points (n,) those are.

    Points that are nearer than the camera's near plane, or outside its picture, are left out.
    """
    view = camera.world_to_camera
    x, y, z = (points @ view[:3, :3].T + view[:3, 3]).T
    ahead = z > camera.near
    safe = np.where(ahead, z, 1.0)
    column, row = camera.fx * x / safe + camera.cx, camera.fy * y / safe + camera.cy
    inside = np.flatnonzero(ahead & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height))
    return row[inside].astype(np.intp), column[inside].astype(np.intp), inside
