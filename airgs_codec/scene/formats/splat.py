"""antimatter15's .splat: 32 bytes a row and no header; position, size, RGBA and rotation, no SH.

N rows of three float32 of position, three of size, four bytes of RGBA and four of a quaternion w, x, y, z.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.form import SIZES, FrameFormat, FrameHeader, Holds
from airgs_codec.scene.gaussians import SH_C0, Gaussians, logits_of, logs_of

_ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
ROW_BYTES = _ROW.itemsize
RANGES = (SIZES, ("sh_dc", -0.5 / SH_C0, 0.5 / SH_C0))  # of a frame


def read_splat_header(path: Path) -> FrameHeader:
    """The count, from the length. Raises SceneError when it is not of whole rows."""
    size = path.stat().st_size
    if not size or size % ROW_BYTES:
        raise SceneError(f"{path}: expected .splat rows of {ROW_BYTES} bytes, got a file of {size}")
    return FrameHeader(size // ROW_BYTES, 0)


def read_splat(path: Path) -> Gaussians:
    """One frame. Raises SceneError."""
    read_splat_header(path)
    rows = np.fromfile(path, _ROW)
    alpha = rows["rgba"][:, 3] / 255
    return Gaussians(
        np.ascontiguousarray(rows["means"]),
        (rows["rotation"].astype(np.float32) - np.float32(128)) / np.float32(128),
        logs_of(rows["scales"]),
        logits_of(alpha),
        ((rows["rgba"][:, :3] / 255 - 0.5) / SH_C0).astype(np.float32),
        np.zeros((len(rows), 0, 3), np.float32),
    )


def write_splat(path: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions and colours within SPLAT's ranges, its rows in their order."""
    rows = np.empty(len(gaussians), _ROW)
    rows["means"] = gaussians.means
    rows["scales"] = np.exp(gaussians.log_scales)
    rows["rgba"][:, :3] = np.rint((gaussians.sh_dc * SH_C0 + 0.5) * 255)
    rows["rgba"][:, 3] = np.rint(gaussians.opacities() * 255)
    rows["rotation"] = np.clip(np.rint(gaussians.quaternions * 128 + 128), 0, 255)
    rows.tofile(path)


SPLAT = FrameFormat(
    name=".splat",
    key="splat",
    suffixes=(".splat",),
    read_header=read_splat_header,
    read=read_splat,
    write=write_splat,
    holds=Holds(sh_degree=0, rounding="colours, opacities and rotations to 8 bits", ranges=RANGES),
)
