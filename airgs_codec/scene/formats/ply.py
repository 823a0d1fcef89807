"""Frames and point clouds as .ply: INRIA's Gaussians in any property order and type, SH degree 0 to 3.

N Gaussians or points, K = (degree + 1)^2 - 1 SH coefficients past DC.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.form import FrameFormat, FrameHeader, Holds
from airgs_codec.scene.formats.ply_elements import BLOCK, Element, Header, read_columns, read_header, write_floats
from airgs_codec.scene.gaussians import SH_REST, Gaussians

_MEANS = ("x", "y", "z")
_NORMALS = ("nx", "ny", "nz")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_OPACITY = ("opacity",)
_SCALES = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_COLOUR = ("red", "green", "blue")


def read_ply_header(path: Path) -> FrameHeader:
    """The count and SH degree of a frame, without its rows. Raises SceneError when it is not a Gaussian .ply."""
    _, vertex = _open(path, "element vertex")
    return FrameHeader(vertex.count, _sh_degree(path, vertex))


def is_whole(path: Path) -> bool:
    """Return whether a frame has been written to its end, as far as its header and its length tell.

    Of a file in ASCII, whose length no header tells, it takes the last line to be there once it ends with a newline.
    """
    try:
        header, _ = _open(path, "element vertex")
        with path.open("rb") as file:
            length = file.seek(0, os.SEEK_END)
            file.seek(max(0, length - 1))
            return file.read(1) in b"\r\n" if header.ascii else length >= header.least_size
    except (SceneError, OSError):
        return False


def _open(path: Path, expected: str) -> tuple[Header, Element]:
    header = read_header(path)
    vertex = header.element("vertex")
    if vertex is None:
        got = ", ".join(e.name for e in header.elements)[:80] or "none"
        raise SceneError(f"{path}: expected a .ply header with {expected}, got {got}")
    return header, vertex


def _sh_degree(path: Path, vertex: Element) -> int:
    names = {p.name for p in vertex.properties}
    if "log_duration" in names:
        raise SceneError(f"{path}: expected Gaussians at rest, got those of FTGS, which move: bake them to frames")
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest % 3 or rest // 3 not in SH_REST:
        raise SceneError(f"{path}: expected 0, 9, 24 or 45 f_rest properties, got {rest}")
    wanted = (*_MEANS, *_DC, *_OPACITY, *_SCALES[:2], *_ROTATION, *_rest_names(rest // 3))
    if missing := [name for name in wanted if name not in names]:
        raise SceneError(f"{path}: expected INRIA Gaussian properties, missing {', '.join(missing)}")
    return SH_REST.index(rest // 3)


def _rest_names(k: int) -> list[str]:
    """The 3 K properties with the colour last; in the file all coefficients of red come first."""
    return [f"f_rest_{colour * k + i}" for i in range(k) for colour in range(3)]


def read_ply(path: Path) -> Gaussians:
    """Read one frame as its file has it: positions are float64 where float32 cannot hold the type that they have.

    Gaussians of two axes have no size along the third. Raises SceneError for a file that is missing, truncated or not a
    Gaussian .ply.
    """
    header, vertex = _open(path, "element vertex")
    rest = _rest_names(SH_REST[_sh_degree(path, vertex)])
    sizes = [name for name in _SCALES if name in {p.name for p in vertex.properties}]
    groups = (_MEANS, _ROTATION, sizes, _OPACITY, _DC, rest)
    means, quaternions, log_scales, opacity, sh_dc, sh_rest = read_columns(path, header, vertex, groups)
    if len(sizes) < len(_SCALES):  # discs of 2DGS (Huang et al. 2024)
        log_scales = np.pad(log_scales, ((0, 0), (0, 1)), constant_values=-np.inf)
    return Gaussians(means, quaternions, log_scales, opacity[:, 0], sh_dc, sh_rest.reshape(len(means), -1, 3))


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """Write one frame as binary little-endian INRIA .ply; the normals that INRIA writes are zero.

    Positions are doubles in the file where they are float64.
    """
    k = gaussians.sh_rest.shape[1]
    names = [*_MEANS, *_NORMALS, *_DC, *(f"f_rest_{i}" for i in range(3 * k)), *_OPACITY, *_SCALES, *_ROTATION]
    with path.open("wb") as file:
        write_floats(file, names, _blocks(gaussians), len(gaussians), 3 * (gaussians.means.dtype == np.float64))


INRIA = FrameFormat(
    name="INRIA .ply",
    key="ply",
    suffixes=(".ply",),
    read_header=read_ply_header,
    read=read_ply,
    write=write_ply,
    holds=Holds(doubles=True),
)


def _blocks(gaussians: Gaussians) -> Iterator[NDArray[np.floating]]:
    """The rows of a file, (n, 17 + 3 K) each."""
    for start in range(0, len(gaussians), BLOCK):
        g = gaussians.take(slice(start, start + BLOCK))
        rest = g.sh_rest.transpose(0, 2, 1).reshape(len(g), -1)
        parts = (g.means, np.zeros_like(g.means), g.sh_dc, rest, g.opacity_logits[:, None], g.log_scales, g.quaternions)
        yield np.concatenate(parts, axis=1)


def read_points(path: Path) -> tuple[NDArray[np.floating], NDArray[np.float32] | None]:
    """Positions (N, 3) of a point cloud, and RGB of [0, 1] (N, 3) if it has any.

    Whole-number colours are divided by the largest of their type. Raises SceneError for a file that is missing,
    truncated or not a point cloud.
    """
    header, vertex = _open(path, "points")
    types = {p.name: p.type for p in vertex.properties}
    if not {*_MEANS} <= types.keys():
        raise SceneError(f"{path}: expected a point cloud with x, y, z, got {', '.join(types)[:80]}")
    if not {*_COLOUR} <= types.keys():
        return read_columns(path, header, vertex, (_MEANS,))[0], None
    positions, colours = read_columns(path, header, vertex, (_MEANS, _COLOUR))
    kind = types["red"]
    return positions, (colours if kind.kind == "f" else colours / np.float32(np.iinfo(kind).max)).astype(np.float32)
