"""PLY files: the container, INRIA's Gaussians of SH degree 0 to 3 in it, and point clouds.

Turk's format of 1994: a header of lines, then the rows of each element one after another, in ASCII or binary of either
byte order. Properties may have any order and type. Rows are read in blocks, so that only the columns asked for are ever
held whole. N Gaussians, points or rows; P properties of a row; K = (degree + 1)^2 - 1 SH coefficients past DC.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.files import BOM, expecting, reading
from airgs_codec.scene.formats.form import FrameFormat, FrameHeader, Holds
from airgs_codec.scene.gaussians import SH_REST, Gaussians

BLOCK = 1 << 14  # rows read or written at once: some MB
MAX_HEADER = 1 << 20  # bytes
MOST_ELEMENTS = 64
MOST_PROPERTIES = 4096  # of all elements together; Gaussians with features of a network have some hundreds
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
    """Rows of named properties, each a type of numpy; of a list, the types of its length and of its values."""

    name: str
    count: int
    properties: dict[str, np.dtype | tuple[np.dtype, np.dtype]]

    @property
    def row(self) -> np.dtype | None:
        """The structured type of a row; None where it has lists."""
        types = [(name, kind) for name, kind in self.properties.items() if isinstance(kind, np.dtype)]
        return np.dtype(types) if len(types) == len(self.properties) else None

    @property
    def size(self) -> int:
        """Bytes of its rows in a binary file; 0 where they have lists."""
        return 0 if self.row is None else self.count * self.row.itemsize


@dataclass(frozen=True, slots=True)
class Header:
    ascii: bool
    elements: dict[str, Element]
    size: int  # bytes of the header

    @property
    def least_size(self) -> int:
        """Bytes of a binary file at least: what its elements without lists take."""
        return self.size + sum(element.size for element in self.elements.values())

    @property
    def vertex(self) -> Element | None:
        return self.elements.get("vertex")


def read_header(path: Path) -> Header:
    """Reads the header alone. Lines may end in LF, CR LF or CR, as the first one does.

    Raises SceneError when the file cannot be read or has no well-formed header of at most 1 MiB, MOST_ELEMENTS and
    MOST_PROPERTIES.
    """
    with reading(path), path.open("rb") as file:
        head = file.read(1 << 12)
        newline = next((end for end in (b"\r\n", b"\n", b"\r") if head.removeprefix(BOM).startswith(b"ply" + end)), b"")
        last = newline + b"end_header" + newline
        while newline and last not in head and len(head) < MAX_HEADER and (more := file.read(len(head))):
            head += more
    end = head.find(last)
    if not newline or end < 0:
        raise SceneError(f"{path}: expected a .ply header, got {head[:16]!r}")
    lines = head[:end].decode("ascii", "replace").split(newline.decode())
    with expecting(path, "a .ply header"):
        return _parse(lines[1:], end + len(last))


def _parse(lines: Sequence[str], size: int) -> Header:
    form, elements = "", dict[str, Element]()
    properties: dict[str, Any] = {}  # of the last element
    rows = [line.split() for line in lines]
    kinds = Counter(row[0] for row in rows if row)
    if kinds["element"] > MOST_ELEMENTS or kinds["property"] > MOST_PROPERTIES:
        got = f"{kinds['element']} elements and {kinds['property']} properties"
        raise ValueError(f"at most {MOST_ELEMENTS} elements and {MOST_PROPERTIES} properties, got {got}")
    for line, row in zip(lines, rows, strict=True):
        match row:
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, "1.0"] if name in _BYTE_ORDERS and not form:
                form = name
            case ["element", name, count] if count.isdecimal() and len(count) <= _MAX_DIGITS:
                _expect_new(name, elements)
                properties = {}
                elements[name] = Element(name, int(count), properties)
            case ["property", kind, name] if elements and form and kind in _TYPES:
                _expect_new(name, properties)
                properties[name] = _type(kind, form)
            case ["property", "list", length, kind, name] if (
                elements and form and _TYPES.get(length, "f")[0] != "f" and kind in _TYPES
            ):
                _expect_new(name, properties)
                properties[name] = _type(length, form), _type(kind, form)
            case _:
                raise ValueError(f"got the line {line[:80]!r}")
    if not form:
        raise ValueError("no line says the format")
    return Header(form == "ascii", elements, size)


def _expect_new(name: str, known: dict[str, Any]) -> None:
    if name in known:
        raise ValueError(f"{name} stands there twice")


def _type(name: str, form: str) -> np.dtype:
    return np.dtype(_BYTE_ORDERS[form] + _TYPES[name])


def read_columns(path: Path, header: Header, element: Element, groups: Sequence[Sequence[str]]) -> list[NDArray[Any]]:
    """Reads an (N, len(names)) array for each group of property names; elements that follow are not looked at.

    It is float32, but the first float64 where its properties do not fit that. Raises SceneError when the element has
    lists, or the file ends before its last row.
    """
    if (row := element.row) is None:
        raise SceneError(f"{path}: expected {element.name} rows of single values, got a list property")
    kinds: list[Any] = [np.result_type(np.float32, *(row[name] for name in groups[0])), *[np.float32] * len(groups)]
    with expecting(path, f"{element.count} {element.name} rows, got a broken or truncated file"):
        rows = (_text_rows if header.ascii else _binary_rows)(path, header, element, row)
        columns = [np.empty((len(rows), len(names)), kind) for names, kind in zip(groups, kinds, strict=False)]
        for start in range(0, len(rows), BLOCK):
            block = rows[start : start + BLOCK]
            for names, column in zip(groups, columns, strict=True):
                for i, name in enumerate(names):
                    column[start : start + BLOCK, i] = block[name]  # a double past float32 is Inf
    return columns


def _binary_rows(path: Path, header: Header, element: Element, row: np.dtype) -> NDArray[np.void]:
    with path.open("rb") as file:
        file.seek(header.size)
        for before in _before(header, element):
            _skip_rows(file, before)
        _expect_bytes(file, element.size)
        return np.memmap(file, row, "r", file.tell(), (element.count,)) if element.count else np.empty(0, row)


def _before(header: Header, element: Element) -> list[Element]:
    elements = list(header.elements.values())
    return elements[: elements.index(element)]


def _skip_rows(file: BinaryIO, element: Element) -> None:
    if element.row is not None:
        _expect_bytes(file, element.size)
        file.seek(element.size, os.SEEK_CUR)
        return
    for _ in range(element.count):
        for kind in element.properties.values():
            if isinstance(kind, np.dtype):
                file.seek(kind.itemsize, os.SEEK_CUR)
                continue
            data = file.read(kind[0].itemsize)
            if len(data) < kind[0].itemsize:
                raise ValueError("the file ends early")
            if (length := int(np.frombuffer(data, kind[0])[0])) < 0:
                raise ValueError(f"a list of {length} values in {element.name}")
            file.seek(length * kind[1].itemsize, os.SEEK_CUR)


def _expect_bytes(file: BinaryIO | TextIO, size: int, start: int | None = None) -> None:
    """Refuses rows that the file is too short for, before memory is taken for them."""
    left = os.fstat(file.fileno()).st_size - (file.tell() if start is None else start)
    if left < size:
        raise ValueError(f"{max(left, 0)} of {size} bytes")


def _text_rows(path: Path, header: Header, element: Element, row: np.dtype) -> NDArray[np.void]:
    """The rows of an element; a row is a line. Raises ValueError."""
    with path.open(encoding="ascii", errors="replace") as file:
        # a digit a value, and what parts it from the next
        _expect_bytes(file, 2 * element.count * len(element.properties) - 1, header.size)
        next(line for line in file if line == "end_header\n")
        lines = (line for line in file if not line.isspace())
        skipped = sum(e.count for e in _before(header, element) if e.properties)
        taken = list(islice(lines, skipped, skipped + element.count))
    if len(taken) < element.count:
        raise ValueError(f"{len(taken)} rows")
    return np.loadtxt(taken, row, comments=None, ndmin=1) if taken else np.empty(0, row)


def write_floats(
    file: BinaryIO, names: Sequence[str], blocks: Iterator[NDArray[np.floating]], count: int, doubles: int = 0
) -> None:
    """Writes one element `vertex` of `count` rows, binary little-endian; blocks are (n, P).

    Its first `doubles` properties are double, the others float.
    """
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property {'double' if i < doubles else 'float'} {name}" for i, name in enumerate(names)]
    file.write("\n".join([*lines, "end_header", ""]).encode())
    row = np.dtype([("doubles", "<f8", doubles), ("floats", "<f4", len(names) - doubles)])
    for block in blocks:
        rows = np.empty(len(block), row)
        rows["doubles"], rows["floats"] = block[:, :doubles], block[:, doubles:]
        file.write(rows.tobytes())


def read_ply_header(path: Path) -> FrameHeader:
    """Reads the count and SH degree of a frame. Raises SceneError when it is not a Gaussian .ply."""
    _, vertex, degree = _open(path)
    return FrameHeader(vertex.count, degree)


def is_whole(path: Path) -> bool:
    """Return whether a frame has been written to its end, as far as its header and its length tell.

    Of a file in ASCII, whose length no header tells, it takes the last line to be there once it ends with a newline.
    """
    try:
        header, _ = _with_vertex(path, "element vertex")
        with path.open("rb") as file:
            length = file.seek(0, os.SEEK_END)
            file.seek(max(0, length - 1))
            return file.read(1) in b"\r\n" if header.ascii else length >= header.least_size
    except (SceneError, OSError):
        return False


def _with_vertex(path: Path, expected: str) -> tuple[Header, Element]:
    header = read_header(path)
    if header.vertex is None:
        got = ", ".join(header.elements)[:80] or "none"
        raise SceneError(f"{path}: expected a .ply header with {expected}, got {got}")
    return header, header.vertex


def _open(path: Path) -> tuple[Header, Element, int]:
    header, vertex = _with_vertex(path, "element vertex")
    names = vertex.properties
    if "log_duration" in names:
        raise SceneError(f"{path}: expected Gaussians at rest, got those of FTGS, which move: bake them to frames")
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest % 3 or rest // 3 not in SH_REST:
        raise SceneError(f"{path}: expected 0, 9, 24 or 45 f_rest properties, got {rest}")
    wanted = (*_MEANS, *_DC, *_OPACITY, *_SCALES[:2], *_ROTATION, *_rest_names(rest // 3))
    if missing := [name for name in wanted if name not in names]:
        raise SceneError(f"{path}: expected INRIA Gaussian properties, missing {', '.join(missing)}")
    return header, vertex, SH_REST.index(rest // 3)


def _rest_names(k: int) -> list[str]:
    """The 3 K properties with the colour last; in the file all coefficients of red come first."""
    return [f"f_rest_{colour * k + i}" for i in range(k) for colour in range(3)]


def read_ply(path: Path) -> Gaussians:
    """Reads one frame as its file has it: positions are float64 where float32 cannot hold the type that they have.

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
    """Writes one frame as binary little-endian INRIA .ply; the normals that INRIA writes are zero.

    Positions are doubles in the file where they are float64.
    """
    k = gaussians.sh_rest.shape[1]
    names = [*_MEANS, *_NORMALS, *_DC, *(f"f_rest_{i}" for i in range(3 * k)), *_OPACITY, *_SCALES, *_ROTATION]
    with path.open("wb") as file:
        blocks = map(_as_table, gaussians.chunks(BLOCK))
        write_floats(file, names, blocks, len(gaussians), 3 * (gaussians.means.dtype == np.float64))


def _as_table(g: Gaussians) -> NDArray[np.floating]:
    rest = g.sh_rest.transpose(0, 2, 1).reshape(len(g), -1)
    parts = (g.means, np.zeros_like(g.means), g.sh_dc, rest, g.opacity_logits[:, None], g.log_scales, g.quaternions)
    return np.concatenate(parts, axis=1)


INRIA = FrameFormat("INRIA .ply", "ply", (".ply",), read_ply_header, read_ply, write_ply, Holds(doubles=True))


def read_points(path: Path) -> tuple[NDArray[np.floating], NDArray[np.float32] | None]:
    """Positions (N, 3) of a point cloud, and RGB of [0, 1] (N, 3) if it has any.

    Whole-number colours are divided by the largest of their type. Raises SceneError for a file that is missing,
    truncated or not a point cloud.
    """
    header, vertex = _with_vertex(path, "points")
    types = vertex.properties
    if not {*_MEANS} <= types.keys():
        raise SceneError(f"{path}: expected a point cloud with x, y, z, got {', '.join(types)[:80]}")
    if not {*_COLOUR} <= types.keys():
        return read_columns(path, header, vertex, (_MEANS,))[0], None
    positions, colours = read_columns(path, header, vertex, (_MEANS, _COLOUR))
    kind = types["red"]
    whole = isinstance(kind, np.dtype) and kind.kind != "f"
    return positions, (colours / np.float32(np.iinfo(kind).max) if whole else colours).astype(np.float32)
