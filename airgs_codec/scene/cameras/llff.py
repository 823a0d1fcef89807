"""LLFF's poses_bounds.npy: a row for each picture, or as N3DV has it for each camera's video, in the order of names.

A row has 17 numbers: a 3 x 5 matrix (axes down, right, backwards; position; height, width, focal length in pixels), and
the nearest and farthest depth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.camera import Camera
from airgs_codec.scene.cameras.posed import Posed, expect_any
from airgs_codec.scene.files import expecting

NAME = "poses_bounds.npy"
MAGIC = b"\x93NUMPY"


def read(path: Path) -> list[Posed]:
    """One for each row. Raises SceneError."""
    with expecting(path, "rows of 17 numbers"):
        rows = np.asarray(np.load(path, allow_pickle=False)).astype(np.float64).reshape(-1, 17)
        posed = [_posed(row, number) for number, row in enumerate(rows)]
    return expect_any(posed, path, "at least one row")


def _posed(row: NDArray[np.float64], number: int) -> Posed:
    pose = row[:15].reshape(3, 5)
    height, width, focal = pose[:, 4]
    down, right, back = pose[:, 0], pose[:, 1], pose[:, 2]
    view = np.eye(4)
    view[:3, :3] = np.stack([right, down, -back])
    view[:3, 3] = -view[:3, :3] @ pose[:, 3]
    return Posed(Camera(f"view{number:03d}", int(width), int(height), focal, focal, width / 2, height / 2, view))
