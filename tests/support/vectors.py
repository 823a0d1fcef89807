"""Reading the test vectors of manifests/vectors, and nothing else."""

from __future__ import annotations

import base64
import json
from typing import Any

from tests.support.paths import VECTORS

Case = dict[str, Any]


def cases(name: str, part: str = "cases") -> list[Case]:
    table = json.loads((VECTORS / f"{name}.json").read_text())
    found: list[Case] = table[part]
    return found


def data(text: str) -> bytes:
    """Bytes."""
    return base64.b64decode(text)


def numbers(runs: list[Any]) -> list[int]:
    return [int(n) for part in runs for n in (part[:1] * part[1] if isinstance(part, list) else [part])]
