"""The test vectors of manifests/vectors: reading them, and numbers as they have them, to the digits that count."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tests.support.paths import VECTORS

Case = dict[str, Any]
Table = dict[str, list[Case]]


def cases(name: str, part: str = "cases") -> list[Case]:
    found: list[Case] = json.loads((VECTORS / f"{name}.json").read_text())[part]
    return found


def data(text: str) -> bytes:
    return base64.b64decode(text)


def binary(data: bytes) -> str:
    return base64.b64encode(data).decode()


def numbers(runs: list[Any]) -> list[int]:
    return [int(n) for part in runs for n in (part[:1] * part[1] if isinstance(part, list) else [part])]


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
