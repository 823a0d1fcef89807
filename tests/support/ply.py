"""Any .ply file, written plainly: the other half of what the reader must understand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A property: `values` a row, or a list of values a row where `length_type` is given."""

    name: str
    type: str
    values: Sequence
    length_type: str | None = None


def ply_bytes(
    elements: dict[str, Sequence[Column]], form: str = "ascii", newline: str = "\n", comments: Sequence[str] = ()
) -> bytes:
    """A file of elements in order, in one of the three forms; comments stand before the elements."""
    lines = ["ply", f"format {form} 1.0", *comments]
    for name, columns in elements.items():
        lines.append(f"element {name} {len(columns[0].values)}")
        for c in columns:
            kind = f"list {c.length_type} {c.type}" if c.length_type else c.type
            lines.append(f"property {kind} {c.name}")
    body = b"".join(_rows(columns, form, newline) for columns in elements.values())
    return newline.join([*lines, "end_header", ""]).encode() + body


def _rows(columns: Sequence[Column], form: str, newline: str) -> bytes:
    out = []
    for i in range(len(columns[0].values)):
        cells: list[np.ndarray] = []
        for c in columns:
            if c.length_type:
                cells.append(np.array([len(c.values[i])], ORDERS[form] + TYPES[c.length_type]))
            cells.append(np.atleast_1d(np.array(c.values[i], ORDERS[form] + TYPES[c.type])))
        text = " ".join(str(v) for cell in cells for v in cell) + newline
        out.append(text.encode() if form == "ascii" else b"".join(cell.tobytes() for cell in cells))
    return b"".join(out)
