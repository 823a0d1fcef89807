"""PLY files: the container, INRIA's Gaussians of SH degree 0 to 3 in it, and point clouds.

Turk's format of 1994: a header of lines, then the rows of each element one after another, in ASCII or binary of either
byte order. Properties may have any order and type. Rows are read in blocks, so that only the columns asked for are ever
held whole. N Gaussians, points or rows; P properties of a row; K = (degree + 1)^2 - 1 SH coefficients past DC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.files import BOM, expecting, require
from airgs_codec.scene.formats.form import FrameFormat, FrameHeader, Holds
from airgs_codec.scene.gaussians import SH_REST, Gaussians

ROWS_AT_ONCE = 1 << 14  # read: some MB
MAX_HEADER = 1 << 16  # bytes
_MAX_DIGITS = 18  # of a count: it fits 64 bits
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2"},
    **{"ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}

_MEANS = ("x", "y", "z")
_NORMALS = ("nx", "ny", "nz")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_OPACITY = ("opacity",)
_SCALES = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_COLOUR = ("red", "green", "blue")


@dataclass(frozen=True, slots=True)
class Element:
    """Rows of named properties, each a type of numpy; None for a list."""

    name: str
    count: int
    properties: dict[str, np.dtype | None]

    @property
    def row(self) -> np.dtype:
        """Return the structured type of a row. Raises ValueError where it has lists."""
        types = [(name, kind) for name, kind in self.properties.items() if kind is not None]
        if len(types) < len(self.properties):
            raise ValueError(f"{self.name} rows of single values, got a list property")
        return np.dtype(types)


@dataclass(frozen=True, slots=True)
class PlyHeader:
    ascii: bool
    elements: dict[str, Element]
    size: int  # bytes of the header

    def end_of(self, name: str) -> int:
        """Return how many bytes a binary file has up to the end of an element. Raises ValueError for lists in it."""
        names = [*self.elements]
        until = [self.elements[one] for one in names[: names.index(name) + 1]]
        return self.size + sum(element.count * element.row.itemsize for element in until)


def read_header(path: Path) -> PlyHeader:
    """Read the header alone. Lines may end in LF, CR LF or CR, as the first one does.

    Raises SceneError when the file cannot be read or has no well-formed header of at most 64 KiB.
    """
    with expecting(path, "a .ply file"), path.open("rb") as file:
        head = file.read(MAX_HEADER)
    newline = next((end for end in (b"\r\n", b"\n", b"\r") if head.removeprefix(BOM).startswith(b"ply" + end)), b"")
    last = newline + b"end_header" + newline
    end = head.find(last)
    require(newline and end >= 0, path, f"expected a .ply header, got {head[:16]!r}")
    lines = head[:end].decode("ascii", "replace").split(newline.decode())
    with expecting(path, "a .ply header"):
        return _parse(lines[1:], end + len(last))


def _parse(lines: Sequence[str], size: int) -> PlyHeader:
    form, elements = "", dict[str, Element]()
    value: Any
    known: dict[str, Any] = elements  # what has names that must differ: elements, or properties of the last one
    for line in lines:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, "1.0"] if name in _BYTE_ORDERS and not form:
                form = name
                continue
            case ["element", name, count] if count.isdecimal() and len(count) <= _MAX_DIGITS:
                known, value = elements, Element(name, int(count), {})
            case ["property", kind, name] if elements and form and kind in _TYPES:
                known, value = elements[[*elements][-1]].properties, np.dtype(_BYTE_ORDERS[form] + _TYPES[kind])
            case ["property", "list", length, kind, name] if (
                elements and _TYPES.get(length, "f")[0] != "f" and kind in _TYPES
            ):
                known, value = elements[[*elements][-1]].properties, None
            case _:
                raise ValueError(f"got the line {line[:80]!r}")
        if name in known:
            raise ValueError(f"the name {name} twice")
        known[name] = value
    if not form:
        raise ValueError("no line says the format")
    return PlyHeader(form == "ascii", elements, size)


def read_columns(path: Path, header: PlyHeader, element: Element, groups: Sequence[Sequence[str]]) -> list[NDArray]:
    """Read an (N, len(names)) array for each group of property names; elements that follow are ignored.

    It is float32, but the first float64 where its properties do not fit that. Raises SceneError when the element or one
    before it has lists, or the file ends before its last row.
    """
    with expecting(path, f"{element.count} {element.name} rows, got a broken or truncated file"):
        row, read = element.row, _text_rows if header.ascii else _binary_rows
        kinds: list[Any] = [np.result_type(np.float32, *(row[name] for name in groups[0]))]
        kinds += [np.float32] * (len(groups) - 1)
        rows = read(path, header, element)
        columns = [np.empty((len(rows), len(names)), kind) for names, kind in zip(groups, kinds, strict=True)]
        for start in range(0, len(rows), ROWS_AT_ONCE):
            block = rows[start : start + ROWS_AT_ONCE]
            for names, column in zip(groups, columns, strict=True):
                for i, name in enumerate(names):
                    column[start : start + ROWS_AT_ONCE, i] = block[name]  # a double past float32 is Inf
    return columns


def _binary_rows(path: Path, header: PlyHeader, element: Element) -> NDArray[np.void]:
    row, end = element.row, header.end_of(element.name)
    if (size := path.stat().st_size) < end:
        raise ValueError(f"{size} of {end} bytes")
    start = end - element.count * row.itemsize
    return np.memmap(path, row, "r", start, (element.count,)) if element.count else np.empty(0, row)


def _text_rows(path: Path, header: PlyHeader, element: Element) -> NDArray[np.void]:
    elements = list(header.elements.values())
    if 2 * element.count * len(element.properties) > path.stat().st_size:  # a digit a value, and a space or newline
        raise ValueError(f"a file of {path.stat().st_size} bytes")
    with path.open(encoding="ascii", errors="replace") as file:
        next(line for line in file if line == "end_header\n")
        lines = (line for line in file if not line.isspace())
        skipped = sum(e.count for e in elements[: elements.index(element)] if e.properties)
        taken = list(islice(lines, skipped, skipped + element.count))
    if len(taken) < element.count:
        raise ValueError(f"{len(taken)} rows")
    return np.loadtxt(taken, element.row, comments=None, ndmin=1) if taken else np.empty(0, element.row)


def write_floats(file: BinaryIO, names: Sequence[str], columns: Sequence[NDArray[np.floating]]) -> None:
    """Write one element `vertex`, binary little-endian, of arrays (N, c) whose columns have these names in their order.

    Those of float64 are double, others float.
    """
    kinds = ["<f8" if column.dtype == np.float64 else "<f4" for column in columns]
    rows = np.empty(len(columns[0]), [(str(i), kinds[i], column.shape[1]) for i, column in enumerate(columns)])
    types = [("double" if kind == "<f8" else "float") for kind, c in zip(kinds, columns, strict=True) for _ in c.T]
    for i, column in enumerate(columns):
        rows[str(i)] = column
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property {kind} {name}" for kind, name in zip(types, names, strict=True)]
    file.write("\n".join([*lines, "end_header", ""]).encode() + rows.tobytes())


def read_ply_header(path: Path) -> FrameHeader:
    _, vertex, degree = _open(path)
    return FrameHeader(vertex.count, degree)


def is_whole(path: Path) -> bool:
    """Return whether a frame has been written to its end: by its length or, in ASCII, a newline as its last byte."""
    try:
        header, vertex = read_vertex(path, "element vertex")
        data = np.memmap(path, np.uint8, "r")
        return data[-1] in b"\r\n" if header.ascii else len(data) >= header.end_of(vertex.name)
    except (SceneError, OSError, ValueError):
        return False


def read_vertex(path: Path, expected: str) -> tuple[PlyHeader, Element]:
    """Return a header and its element of Gaussians or points. Raises SceneError, which says what is expected."""
    header = read_header(path)
    if (vertex := header.elements.get("vertex")) is None:
        got = ", ".join(header.elements)[:80] or "none"
        raise SceneError(f"{path}: expected a .ply header with {expected}, got {got}")
    return header, vertex


def _open(path: Path) -> tuple[PlyHeader, Element, int]:
    header, vertex = read_vertex(path, "element vertex")
    names = vertex.properties
    if "log_duration" in names:
        raise SceneError(f"{path}: expected Gaussians at rest, got those of FTGS, which move: bake them to frames")
    rest = sum(name.startswith("f_rest_") for name in names)
    require(not rest % 3 and rest // 3 in SH_REST, path, f"expected 0, 9, 24 or 45 f_rest properties, got {rest}")
    wanted = (*_MEANS, *_DC, *_OPACITY, *_SCALES[:2], *_ROTATION, *_rest_names(rest // 3))
    if missing := [name for name in wanted if name not in names]:
        raise SceneError(f"{path}: expected INRIA Gaussian properties, missing {', '.join(missing)}")
    return header, vertex, SH_REST.index(rest // 3)


def _rest_names(k: int) -> list[str]:
    """Return the 3 K properties with the colour last; in the file all coefficients of red come first."""
    return [f"f_rest_{colour * k + i}" for i in range(k) for colour in range(3)]


def read_ply(path: Path) -> Gaussians:
    """Read one frame as its file has it: positions are float64 where float32 cannot hold the type that they have.

    Gaussians of two axes have no size along the third. Raises SceneError for a file that is missing, truncated or not a
    Gaussian .ply.
    """
    header, vertex, degree = _open(path)
    sizes = [name for name in _SCALES if name in vertex.properties]
    groups = (_MEANS, _ROTATION, sizes, _OPACITY, _DC, _rest_names(SH_REST[degree]))
    means, quaternions, log_scales, opacity, sh_dc, sh_rest = read_columns(path, header, vertex, groups)
    if len(sizes) < len(_SCALES):  # discs of 2DGS (Huang et al. 2024)
        log_scales = np.pad(log_scales, ((0, 0), (0, 1)), constant_values=-np.inf)
    return Gaussians(means, quaternions, log_scales, opacity[:, 0], sh_dc, sh_rest.reshape(len(means), -1, 3))


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """Write one frame as binary little-endian INRIA .ply; the normals that INRIA writes are zero.

    Positions are doubles in the file where they are float64.
    """
    g = gaussians
    rest = g.sh_rest.transpose(0, 2, 1).reshape(len(g), 3 * g.sh_rest.shape[1])
    names = [*_MEANS, *_NORMALS, *_DC, *(f"f_rest_{i}" for i in range(rest.shape[1])), *_OPACITY, *_SCALES, *_ROTATION]
    normals = np.zeros((len(g), 3), np.float32)
    with path.open("wb") as file:
        columns = (g.means, normals, g.sh_dc, rest, g.opacity_logits[:, None], g.log_scales, g.quaternions)
        write_floats(file, names, columns)


INRIA = FrameFormat("INRIA .ply", "ply", (".ply",), read_ply_header, read_ply, write_ply, Holds(doubles=True))


def read_points(path: Path) -> tuple[NDArray[np.floating], NDArray[np.float32] | None]:
    """Return positions (N, 3) of a point cloud, and RGB of [0, 1] (N, 3) if it has any.

    Whole-number colours are divided by the largest of their type. Raises SceneError for a file that is missing,
    truncated or not a point cloud.
    """
    header, vertex = read_vertex(path, "points")
    types = vertex.properties
    require({*_MEANS} <= types.keys(), path, f"expected a point cloud with x, y, z, got {', '.join(types)[:80]}")
    if not {*_COLOUR} <= types.keys():
        return read_columns(path, header, vertex, (_MEANS,))[0], None
    positions, colours = read_columns(path, header, vertex, (_MEANS, _COLOUR))
    kind = vertex.row["red"]
    return positions, (colours if kind.kind == "f" else colours / np.float32(np.iinfo(kind).max)).astype(np.float32)
