"""The PLY container: elements of named properties, in ASCII or binary of either byte order.

N rows of the element read, P properties of it. Turk's format of 1994: a header of lines, then the rows of each element
one after another. Rows are read in blocks, so that only the columns asked for are ever held whole.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.files import BOM, expecting, reading

BLOCK = 1 << 14  # rows read at once: some MB
MAX_HEADER = 1 << 20  # bytes
MOST_ELEMENTS = 64
MOST_PROPERTIES = 4096  # of all elements together; Gaussians with features of a network have some hundreds
HEADER_END = b"end_header"  # the last line of a header
_MAX_DIGITS = 18  # of a count: it fits 64 bits
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2"},
    **{"ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}


@dataclass(frozen=True, slots=True)
class Property:
    """A column of an element; a list has a length of its own in every row."""

    name: str
    type: np.dtype
    length_type: np.dtype | None  # None: a single value a row


@dataclass(frozen=True, slots=True)
class Element:
    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        return any(p.length_type is not None for p in self.properties)

    def row_type(self) -> np.dtype:
        """The structured type of a row without lists."""
        return np.dtype([(p.name, p.type) for p in self.properties])


@dataclass(frozen=True, slots=True)
class Header:
    ascii: bool
    elements: tuple[Element, ...]
    size: int  # bytes of the header

    @property
    def least_size(self) -> int:
        """Bytes of a binary file at least: what its elements without lists take."""
        rows = sum(e.count * e.row_type().itemsize for e in self.elements if not e.has_lists)
        return self.size + rows

    def element(self, name: str) -> Element | None:
        """The element of that name, if there is one."""
        return next((e for e in self.elements if e.name == name), None)


def read_header(path: Path) -> Header:
    """The header alone. Lines may end in LF, CR LF or CR, as the first one does.

    Raises SceneError when the file cannot be read or has no well-formed header of at most 1 MiB, MOST_ELEMENTS and
    MOST_PROPERTIES.
    """
    with reading(path), path.open("rb") as file:
        head = file.read(1 << 12)
        newline = next((end for end in (b"\r\n", b"\n", b"\r") if head.removeprefix(BOM).startswith(b"ply" + end)), b"")
        last = newline + HEADER_END + newline
        while newline and last not in head and len(head) < MAX_HEADER and (more := file.read(len(head))):
            head += more
    end = head.find(last)
    if not newline or end < 0:
        raise SceneError(f"{path}: expected a .ply header, got {head[:16]!r}")
    lines = head[:end].decode("ascii", "replace").split(newline.decode())
    with expecting(path, "a .ply header"):
        return _parse(lines[1:], end + len(last))


def _parse(lines: Sequence[str], size: int) -> Header:
    """The header of its lines after the first. Raises ValueError."""
    form: str | None = None
    elements: list[tuple[str, int, list[Property]]] = []
    rows = [line.split() for line in lines]
    kinds = Counter(row[0] for row in rows if row)
    if kinds["element"] > MOST_ELEMENTS or kinds["property"] > MOST_PROPERTIES:
        got = f"{kinds['element']} elements and {kinds['property']} properties"
        raise ValueError(f"at most {MOST_ELEMENTS} elements and {MOST_PROPERTIES} properties, got {got}")
    for line, row in zip(lines, rows, strict=True):
        match row:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _BYTE_ORDERS and form is None:
                form = name
            case ["element", name, count] if count.isdecimal() and len(count) <= _MAX_DIGITS:
                elements.append((name, int(count), []))
            case ["property", type_name, name] if elements and form and type_name in _TYPES:
                elements[-1][2].append(Property(name, _type(type_name, form), None))
            case ["property", "list", length, type_name, name] if (
                elements and form and _TYPES.get(length, "f")[0] != "f" and type_name in _TYPES
            ):
                elements[-1][2].append(Property(name, _type(type_name, form), _type(length, form)))
            case _:
                raise ValueError(f"got the line {line[:80]!r}")
    if form is None:
        raise ValueError("no line says the format")
    for names in ([e[0] for e in elements], *([p.name for p in e[2]] for e in elements)):
        if twice := [name for name, count in Counter(names).items() if count > 1]:
            raise ValueError(f"{twice[0]} stands there twice")
    return Header(form == "ascii", tuple(Element(n, count, tuple(ps)) for n, count, ps in elements), size)


def _type(name: str, form: str) -> np.dtype:
    return np.dtype(_BYTE_ORDERS[form] + _TYPES[name])


def read_columns(path: Path, header: Header, element: Element, groups: Sequence[Sequence[str]]) -> list[NDArray[Any]]:
    """An (N, len(names)) array for each group of property names; elements that follow are not looked at.

    It is float32, but the first float64 where its properties do not fit that.

    Raises SceneError when the element has lists, or the file ends before its last row.
    """
    if element.has_lists:
        raise SceneError(f"{path}: expected {element.name} rows of single values, got a list property")
    with expecting(path, f"{element.count} {element.name} rows, got a broken or truncated file"):
        blocks = _text_blocks(path, header, element) if header.ascii else _binary_blocks(path, header, element)
        types = {p.name: p.type for p in element.properties}
        kinds = [np.result_type(np.float32, *map(types.__getitem__, groups[0])), *[np.float32] * (len(groups) - 1)]
        columns = None
        start = 0
        for rows in blocks:
            if columns is None:  # from here on the file is known to be as long as its header says
                columns = [
                    np.empty((element.count, len(names)), kind) for names, kind in zip(groups, kinds, strict=True)
                ]
            for names, column in zip(groups, columns, strict=True):
                for i, name in enumerate(names):
                    column[start : start + len(rows), i] = rows[name]  # a double past float32 is Inf
            start += len(rows)
    return columns or [np.empty((0, len(names)), np.float32) for names in groups]


def _binary_blocks(path: Path, header: Header, element: Element) -> Iterator[NDArray[np.void]]:
    """The rows of an element, block by block. Raises ValueError."""
    row = element.row_type()
    with path.open("rb") as file:
        file.seek(header.size)
        for before in header.elements[: header.elements.index(element)]:
            _skip_rows(file, before)
        _expect_bytes(_left(file), element.count * row.itemsize)
        for start in range(0, element.count, BLOCK):
            yield np.frombuffer(_read(file, min(BLOCK, element.count - start) * row.itemsize), row)


def _skip_rows(file: BinaryIO, element: Element) -> None:
    if not element.has_lists:
        size = element.count * element.row_type().itemsize
        _expect_bytes(_left(file), size)
        file.seek(size, os.SEEK_CUR)
        return
    for _ in range(element.count):
        for p in element.properties:
            length = 1
            if p.length_type is not None:
                length = int(np.frombuffer(_read(file, p.length_type.itemsize), p.length_type)[0])
                if length < 0:
                    raise ValueError(f"a list of {length} values in {element.name}")
            file.seek(length * p.type.itemsize, os.SEEK_CUR)


def _left(file: BinaryIO) -> int:
    return os.fstat(file.fileno()).st_size - file.tell()


def _expect_bytes(left: int, size: int) -> None:
    """Refuse rows that the file is too short for, before memory is taken for them."""
    if left < size:
        raise ValueError(f"{max(left, 0)} of {size} bytes")


def _read(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise ValueError("the file ends early")
    return data


def _text_blocks(path: Path, header: Header, element: Element) -> Iterator[NDArray[np.void]]:
    """The rows of an element, block by block; a row is a line. Raises ValueError."""
    row = element.row_type()
    with path.open(encoding="ascii", errors="replace") as file:
        least = 2 * element.count * len(element.properties) - 1  # a digit a value, and what parts it from the next
        _expect_bytes(os.fstat(file.fileno()).st_size - header.size, least)
        next(line for line in file if line == "end_header\n")
        lines = (line for line in file if not line.isspace())
        before = header.elements[: header.elements.index(element)]
        skipped = sum(e.count for e in before if e.properties)
        for start in range(0, element.count, BLOCK):
            count = min(BLOCK, element.count - start)
            taken = list(islice(lines, skipped, skipped + count))
            skipped = 0
            if len(taken) < count:
                raise ValueError(f"{start + len(taken)} rows")
            yield np.loadtxt(taken, row, comments=None, ndmin=1)


def write_floats(
    file: BinaryIO, names: Sequence[str], blocks: Iterator[NDArray[np.floating]], count: int, doubles: int = 0
) -> None:
    """Write one element `vertex` of `count` rows, binary little-endian; blocks are (n, P).

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
