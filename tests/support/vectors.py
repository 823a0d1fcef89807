"""Reading the test vectors of manifests/vectors, and nothing else."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.support.paths import VECTORS

Case = dict[str, Any]


def cases(name: str, part: str = "cases") -> list[Case]:
    table = json.loads((VECTORS / f"{name}.json").read_text())
    found: list[Case] = table[part]
    return found


def label(case: Case) -> str:
    return str(case.get("name", "case"))


def data(text: str) -> bytes:
    """Bytes."""
    return base64.b64decode(text)


def numbers(runs: list[Any]) -> list[int]:
    return [int(n) for part in runs for n in (part[:1] * part[1] if isinstance(part, list) else [part])]


def assert_near(got: Mapping[str, NDArray[Any]], expected: Case) -> None:
    """Every attribute of every row is as near to its value as its tolerance asks."""
    for name, values in expected["values"].items():
        want = np.array(values, np.float64)
        tolerance = np.array(expected["tolerance"][name], np.float64)
        away = np.abs(np.asarray(got[name], np.float64) - want).reshape(len(want), -1).max(axis=1, initial=0.0)
        assert (away <= tolerance).all(), f"{name}: {away} off, at most {tolerance}"


def float32(values: ArrayLike) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)
