"""Names of content: equal values have equal names on every machine and in every process."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from fractions import Fraction
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.media.h264 import library_versions

PACKAGE = Path(__file__).parent.parent


def digest(*values: Any) -> str:
    """SHA-256 of plain values, arrays, and dataclasses, sequences and mappings of them, as hexadecimal digits.

    Raises TypeError for anything else: what has no content that can be told apart must not name a result.
    """
    h = hashlib.sha256()
    for value in values:
        _add(h, value)
    return h.hexdigest()


def _add(h: hashlib._Hash, value: Any) -> None:
    if isinstance(value, np.ndarray):
        h.update(f"array {value.dtype.str} {value.shape} ".encode())
        h.update(np.ascontiguousarray(value).data)
    elif value is None or isinstance(value, str | bytes | bool | int | float | Fraction | np.generic):
        text = repr(value).encode()
        h.update(f"{type(value).__name__} {len(text)} ".encode() + text)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        h.update(f"{type(value).__qualname__} ".encode())
        for field in dataclasses.fields(value):
            _add(h, getattr(value, field.name))
    elif isinstance(value, tuple | list):
        h.update(f"sequence {len(value)} ".encode())
        for part in value:
            _add(h, part)
    elif isinstance(value, Mapping):
        h.update(f"mapping {len(value)} ".encode())
        for name in sorted(value):
            _add(h, name)
            _add(h, value[name])
    else:
        raise TypeError(f"expected plain values, arrays or dataclasses, got {type(value).__qualname__}")


@cache
def code_digest(*libraries: str) -> str:
    """SHA-256 of this package's own code and of the versions of what it computes with.

    `libraries`: further packages whose versions count, where they are installed. Results of other versions are not
    taken.
    """
    more = {name: _version(name) for name in libraries}
    versions = [library_versions(), np.__version__, version("numba"), more]
    h = hashlib.sha256(json.dumps(versions, sort_keys=True).encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        h.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes())
    return h.hexdigest()


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
