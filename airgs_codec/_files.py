"""Files that are whole or not there, and JSON that every reader accepts."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
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


@contextmanager
def staged_files(folder: Path) -> Iterator[Path]:
    """A temporary folder inside `folder`, which is made; files written there go to `folder` when the block ends.

    They replace those of the same names, each whole; others stay. After an error nothing has changed.
    """
    new = not folder.exists()
    folder.mkdir(exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=".", suffix=PART_SUFFIX, dir=folder))
    try:
        yield stage
        paths = sorted(stage.iterdir())
        for path in paths:
            with path.open("rb") as file:
                os.fsync(file.fileno())
        for path in paths:
            path.replace(folder / path.name)
        new = False
    finally:
        shutil.rmtree(folder if new else stage, ignore_errors=True)


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
