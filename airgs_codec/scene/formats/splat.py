"""antimatter15's .splat: 32 bytes a row and no header; position, size, RGBA and rotation, no SH.

N rows of three float32 of position, three of size, four bytes of RGBA and four of a quaternion w, x, y, z.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.scene.ply import PlyHeader

_ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
_LEAST_SCALE = 1e-9  # of a size of 0, whose logarithm is infinite
_SATURATED = math.log(1019)  # the logit of a byte of alpha that is 0 or 255: a quarter of a step off


def read_splat_header(path: Path) -> PlyHeader:
    """The count, from the length. Raises SceneError when it is not of whole rows."""
    size = path.stat().st_size
    if not size or size % _ROW.itemsize:
        raise SceneError(f"{path}: expected .splat rows of {_ROW.itemsize} bytes, got a file of {size}")
    return PlyHeader(size // _ROW.itemsize, 0)


def read_splat(path: Path) -> Gaussians:
    """One frame. Raises SceneError."""
    read_splat_header(path)
    rows = np.fromfile(path, _ROW)
    alpha = rows["rgba"][:, 3] / 255
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales = np.log(np.maximum(rows["scales"], _LEAST_SCALE))
        logits = np.clip(np.log(alpha / (1 - alpha)), -_SATURATED, _SATURATED)
    return Gaussians(
        np.ascontiguousarray(rows["means"]),
        (rows["rotation"].astype(np.float32) - np.float32(128)) / np.float32(128),
        log_scales.astype(np.float32),
        logits.astype(np.float32),
        ((rows["rgba"][:, :3] / 255 - 0.5) / SH_C0).astype(np.float32),
        np.zeros((len(rows), 0, 3), np.float32),
    )
