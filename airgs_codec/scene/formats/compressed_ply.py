"""PlayCanvas' and SuperSplat's compressed .ply: chunks of 256 rows with bounds, four words a row; SH 0 to 3."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.form import FrameFormat, FrameHeader, Holds
from airgs_codec.scene.formats.library import read_with_library
from airgs_codec.scene.formats.ply_elements import Header, read_header
from airgs_codec.scene.gaussians import SH_C0, SH_REST, Gaussians, morton_order

_CHUNK = 256  # rows
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_BOUNDS = tuple(f"{end}_{what}{axis}" for what in ("", "scale_") for end in ("min", "max") for axis in "xyz")

_COLOURS = tuple(f"{end}_{c}" for end in ("min", "max") for c in "rgb")
_SH_RANGE = 4.0


def is_compressed(header: Header) -> bool:
    """Return whether a .ply is of this format: its rows are packed."""
    vertex = header.element("vertex")
    return vertex is not None and any(p.name in _WORDS for p in vertex.properties)


def read_compressed_header(path: Path) -> FrameHeader:
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
    return FrameHeader(vertex.count, SH_REST.index(coefficients // 3))


def read_compressed(path: Path) -> Gaussians:
    """One frame. Raises SceneError."""
    header = read_compressed_header(path)
    return read_with_library(path, "compressed.ply", path.read_bytes(), header)


def write_compressed(path: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions, within COMPRESSED's ranges, in Morton order.

    Neighbours share a chunk, whose bounds are as tight as that makes them. Layout: PlayCanvas' splat-transform.
    """
    g = gaussians.take(morton_order(gaussians.means))
    starts = np.arange(0, len(g), _CHUNK)
    values = (g.means, g.log_scales, g.sh_dc * np.float32(SH_C0) + np.float32(0.5))
    bounds = [end.reduceat(v, starts) for v in values for end in (np.minimum, np.maximum)]
    low, span = (np.repeat(np.stack(b, 1), _CHUNK, 0)[: len(g)] for b in (bounds[::2], _spans(bounds)))
    means, scales, colours = ((v - low[:, i]) / span[:, i] for i, v in enumerate(values))
    words = (_pack(means, (11, 10, 11)), _pack_rotations(g.quaternions), _pack(scales, (11, 10, 11)))
    colour = _pack(np.concatenate([colours, g.opacities()[:, None]], 1), (8, 8, 8, 8))
    rest = np.clip(np.floor((g.sh_rest / (2 * _SH_RANGE) + 0.5) * 256), 0, 255).astype(np.uint8)
    with path.open("wb") as file:
        file.write(_lines(len(g), rest.shape[1] * 3).encode())
        file.write(np.concatenate(bounds, 1).astype("<f4").tobytes())
        file.write(np.stack([*words, colour], 1).astype("<u4").tobytes())
        file.write(rest.transpose(0, 2, 1).tobytes())


def _lines(count: int, coefficients: int) -> str:
    """The header of a file of so many rows and SH properties."""
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {-(-count // _CHUNK)}"]
    lines += [f"property float {name}" for name in (*_BOUNDS, *_COLOURS)]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in _WORDS)]
    if coefficients:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(coefficients))]
    return "\n".join([*lines, "end_header", ""])


def _spans(bounds: list[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    """Widths of the ranges whose ends are neighbours in a list; 1 where there is none."""
    widths = [high - low for low, high in zip(bounds[::2], bounds[1::2], strict=True)]
    return [np.where(width > 0, width, np.float32(1)) for width in widths]


def _pack(values: NDArray[np.floating], bits: tuple[int, ...]) -> NDArray[np.uint32]:
    """(N, len(bits)) values of [0, 1] -> (N,) words, the first value in the highest bits."""
    word = np.zeros(len(values), np.uint32)
    for i, b in enumerate(bits):
        top = (1 << b) - 1
        code = np.clip(np.rint(values[:, i].astype(np.float64) * top), 0, top).astype(np.uint32)
        word = word << np.uint32(b) | code
    return word


def _pack_rotations(quaternions: NDArray[np.float32]) -> NDArray[np.uint32]:
    """(N, 4) unit quaternions w, x, y, z -> (N,) words: which is largest in 2 bits, the other three in 10 each."""
    rows = np.arange(len(quaternions))
    largest = np.abs(quaternions).argmax(axis=1)
    q = quaternions * np.where(quaternions[rows, largest] < 0, -1, 1)[:, None]
    others = np.array([[j for j in range(4) if j != i] for i in range(4)])[largest]
    rest = np.take_along_axis(q, others, 1) * np.sqrt(0.5) + 0.5
    return largest.astype(np.uint32) << np.uint32(30) | _pack(rest, (10, 10, 10))


COMPRESSED = FrameFormat(
    name="compressed .ply",
    key="compressed.ply",
    suffixes=(".ply",),
    fits=is_compressed,
    read_header=read_compressed_header,
    read=read_compressed,
    write=write_compressed,
    holds=Holds(
        rounding="positions and sizes to 10 or 11 bits of the range of 256 neighbours, rotations to 10, all else to 8",
        keeps_rows=False,
        ranges=(("log_scales", -20, 20), ("sh_rest", -_SH_RANGE, _SH_RANGE)),
    ),
)
