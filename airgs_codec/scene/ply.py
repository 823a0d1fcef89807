"""INRIA .ply files: any property order, ASCII or binary, SH degree 0 to 3."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement, PlyParseError

from airgs_codec.errors import SceneError
from airgs_codec.scene.gaussians import SH_REST, Gaussians

_BASE = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity")
_SCALES = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """What the header of a frame promises."""

    count: int
    sh_degree: int


def read_ply_header(path: Path) -> PlyHeader:
    """Count and SH degree without reading the rows. Raises SceneError when it is not a Gaussian .ply."""
    try:
        with path.open("rb") as file:
            head = file.read(1 << 16)
    except OSError as error:
        raise SceneError(f"{path}: cannot read: {error.strerror}") from error
    text = head.split(b"end_header", 1)[0].decode("ascii", "replace")
    vertex = re.search(r"^element vertex (\d+)\s*$", text, re.MULTILINE)
    if not head.startswith(b"ply") or b"end_header" not in head or vertex is None:
        raise SceneError(f"{path}: expected a .ply header with 'element vertex', got {head[:16]!r}")
    names = set(re.findall(r"^property \w+ (\w+)\s*$", text, re.MULTILINE))
    if missing := [name for name in (*_BASE, *_SCALES, *_ROTATION) if name not in names]:
        raise SceneError(f"{path}: expected INRIA Gaussian properties, missing {', '.join(missing)}")
    return PlyHeader(int(vertex[1]), _degree(path, sum(name.startswith("f_rest_") for name in names)))


def _degree(path: Path, rest: int) -> int:
    if rest % 3 or rest // 3 not in SH_REST:
        raise SceneError(f"{path}: expected 0, 9, 24 or 45 f_rest properties, got {rest}")
    return SH_REST.index(rest // 3)


def read_ply(path: Path) -> Gaussians:
    """One frame. f_rest is channel-major in the file (all red coefficients first), colour last in memory.

    Raises SceneError for a file that is missing, truncated or not a Gaussian .ply.
    """
    header = read_ply_header(path)
    try:
        vertex = PlyData.read(str(path), mmap="c").elements
        rows = next(element.data for element in vertex if element.name == "vertex")
        columns = {name: np.asarray(rows[name], np.float32) for name in rows.dtype.names}
    except (PlyParseError, ValueError, OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: expected {header.count} rows, got a broken or truncated file: {error}") from error

    def stack(*names: str) -> NDArray[np.float32]:
        return np.stack([columns[name] for name in names], axis=1)

    k = SH_REST[header.sh_degree]
    rest = np.zeros((header.count, 3, 0), np.float32)
    if k:
        rest = stack(*(f"f_rest_{i}" for i in range(3 * k))).reshape(-1, 3, k)
    return Gaussians(
        means=stack("x", "y", "z"),
        quaternions=stack(*_ROTATION),
        log_scales=stack(*_SCALES),
        opacity_logits=columns["opacity"].copy(),
        sh_dc=stack("f_dc_0", "f_dc_1", "f_dc_2"),
        sh_rest=np.ascontiguousarray(rest.transpose(0, 2, 1)),
    )


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """One frame as binary little-endian INRIA .ply; the normals that INRIA writes are zero."""
    n, k = len(gaussians), gaussians.sh_rest.shape[1]
    columns: dict[str, NDArray[np.float32]] = {name: gaussians.means[:, i] for i, name in enumerate("xyz")}
    columns |= {name: np.zeros(n, np.float32) for name in ("nx", "ny", "nz")}
    columns |= {f"f_dc_{i}": gaussians.sh_dc[:, i] for i in range(3)}
    rest = gaussians.sh_rest.transpose(0, 2, 1).reshape(n, 3 * k)
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(3 * k)}
    columns["opacity"] = gaussians.opacity_logits
    columns |= {name: gaussians.log_scales[:, i] for i, name in enumerate(_SCALES)}
    columns |= {name: gaussians.quaternions[:, i] for i, name in enumerate(_ROTATION)}
    rows = np.empty(n, [(name, "<f4") for name in columns])
    for name, values in columns.items():
        rows[name] = values
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(str(path))


def read_points(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Positions (P, 3) and RGB of [0, 1] (P, 3), if it has any, of a point cloud. Raises SceneError."""
    try:
        rows = next(e.data for e in PlyData.read(str(path)).elements if e.name == "vertex")
        positions = np.stack([np.asarray(rows[name], np.float32) for name in "xyz"], axis=1)
        names = ("red", "green", "blue")
        if not set(names) <= set(rows.dtype.names):
            return positions, None
        colours = np.stack([np.asarray(rows[name], np.float32) for name in names], axis=1)
        return positions, colours / np.float32(255) if rows.dtype["red"].kind == "u" else colours
    except (PlyParseError, ValueError, OSError, UnicodeDecodeError, StopIteration) as error:
        raise SceneError(f"{path}: expected a point cloud with x, y, z: {error}") from error
