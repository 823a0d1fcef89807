"""PlayCanvas' and SuperSplat's compressed .ply: chunks of 256 rows with bounds, four words a row; SH 0 to 3."""

from __future__ import annotations

from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.library import convert
from airgs_codec.scene.gaussians import SH_REST, Gaussians
from airgs_codec.scene.ply import PlyHeader
from airgs_codec.scene.ply_elements import Header, read_header

_CHUNK = 256  # rows
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_BOUNDS = tuple(f"{end}_{what}{axis}" for what in ("", "scale_") for end in ("min", "max") for axis in "xyz")


def is_compressed(header: Header) -> bool:
    """Whether a .ply is of this format: its rows are packed."""
    vertex = header.element("vertex")
    return vertex is not None and any(p.name in _WORDS for p in vertex.properties)


def read_compressed_header(path: Path) -> PlyHeader:
    """Count and SH degree. Raises SceneError for a header or a length that is not this format's."""
    header = read_header(path)
    vertex, chunk, sh = (header.element(name) for name in ("vertex", "chunk", "sh"))
    if vertex is None or [(p.name, p.type.str) for p in vertex.properties] != [(name, "<u4") for name in _WORDS]:
        raise SceneError(f"{path}: expected a binary compressed .ply with four packed words a row")
    chunks = -(-vertex.count // _CHUNK)
    bounds = {p.name for p in chunk.properties} if chunk and not chunk.has_lists else set()
    if chunk is None or chunk.count != chunks or not {*_BOUNDS} <= bounds:
        raise SceneError(f"{path}: expected {chunks} chunks with bounds, got {chunk.count if chunk else 'none'}")
    coefficients = len(sh.properties) if sh else 0
    if coefficients % 3 or coefficients // 3 not in SH_REST:
        raise SceneError(f"{path}: expected 0, 9, 24 or 45 SH properties, got {coefficients}")
    if sh and (sh.count != vertex.count or sh.has_lists or any(p.type.itemsize != 1 for p in sh.properties)):
        raise SceneError(f"{path}: expected {vertex.count} SH rows of bytes, got {sh.count}")
    if (size := path.stat().st_size) < header.least_size:
        raise SceneError(f"{path}: expected {header.least_size} bytes, got a truncated file of {size}")
    return PlyHeader(vertex.count, SH_REST.index(coefficients // 3))


def read_compressed(path: Path) -> Gaussians:
    """One frame. Raises SceneError."""
    header = read_compressed_header(path)
    return convert(path, "compressed.ply", path.read_bytes(), header)
