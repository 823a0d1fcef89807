"""Tables of vectors as JSON that a person can read: a case on a line of its own, numbers to the digits that count."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Table = dict[str, list[dict[str, Any]]]


def write(table: Table) -> bytes:
    """The bytes of a file: one list of cases after another."""
    parts = []
    for name, cases in table.items():
        lines = ",\n".join("  " + json.dumps(case, separators=(",", ":"), allow_nan=False) for case in cases)
        parts.append(f" {json.dumps(name)}: [\n{lines}\n ]")
    return ("{\n" + ",\n".join(parts) + "\n}\n").encode()


def binary(data: bytes) -> str:
    """Bytes as base64."""
    return base64.b64encode(data).decode()


def runs(numbers: Iterable[Any]) -> list[Any]:
    """Whole numbers, a run of equal ones as [number, how many]."""
    counted = [(number, len(list(run))) for number, run in groupby(numbers)]
    return [part for number, count in counted for part in ([[number, count]] if count > 3 else [number] * count)]


def wide(numbers: ArrayLike) -> list[Any]:
    """Whole numbers of up to 64 bits as strings, which no reader rounds, in runs."""
    return runs(str(number) for number in np.asarray(numbers).ravel().tolist())


def plain(values: Any) -> Any:
    """Numbers to ten digits, far below every tolerance, in lists of the same shape."""
    if isinstance(values, Sequence):
        return [plain(value) for value in values]
    short = float(f"{float(values):.10g}")
    return int(short) if short.is_integer() and abs(short) < 1e6 else short
