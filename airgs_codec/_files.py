"""Files that are whole or not there, and JSON that every reader accepts."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PART_SUFFIX = ".part"  # of a file that is being written; its name starts with a dot


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`; what the block writes there takes the place of `path` when the block ends.

    The bytes are on the disk (fsync) before the file has its name, so that a crash leaves the old file or the new one.
    After an error the temporary file is removed and `path` is as it was.
    """
    temporary = path.with_name(f".{path.name}{PART_SUFFIX}")
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically, as `atomic_path` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: Path, value: Any) -> None:
    """Write `to_json(value)`, indented, atomically."""
    write_bytes(path, f"{to_json(value, indent=1)}\n".encode())


def to_json(value: Any, indent: int | None = None) -> str:
    """JSON text of mappings, sequences and plain values; a float that is not finite becomes null, as JSON has none."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
