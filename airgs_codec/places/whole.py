"""Files and folders of this machine that are whole or not there, and JSON that every reader accepts.

What is written has a name of its own until it is finished. That name is random and is made exclusively, and no link is
followed: neither one that somebody put at the name of the temporary file nor one at the name that it takes.
"""

from __future__ import annotations

import fcntl
import glob
import json
import math
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from airgs_codec.errors import ConfigError

PART_SUFFIX = ".part"  # of what is being written; its name starts with a dot

IsOurs = Callable[[Path], bool]  # whether a folder with files in it is of the kind that may be replaced


@contextmanager
def atomic_path(path: Path, lasting: bool = True) -> Iterator[Path]:
    """Give a new empty file beside `path`; what the block writes there takes the place of `path` when the block ends.

    The bytes are on the disk (fsync) before the file has its name, so that a crash leaves the old file or the new one;
    not so where it need not be `lasting`. After an error the temporary file is removed and `path` is as it was.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}{PART_SUFFIX}")
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
    try:
        yield temporary
        _finish(temporary, lasting)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def staged_files(folder: Path) -> Iterator[Path]:
    """Give a temporary folder inside `folder`, which is made; files written there go to `folder` when the block ends.

    They replace those of the same names, each whole; others stay. After an error nothing has changed.
    """
    new = not folder.exists()
    folder.mkdir(exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=".", suffix=PART_SUFFIX, dir=folder))
    try:
        yield stage
        paths = sorted(stage.iterdir())
        for path in paths:
            _finish(path, lasting=True)
        for path in paths:
            path.replace(folder / path.name)
        new = False
    finally:
        shutil.rmtree(folder if new else stage, ignore_errors=True)


@contextmanager
def staged_folder(target: Path, is_ours: IsOurs, kind: str) -> Iterator[Path]:
    """Give a folder beside `target` that takes its place when the block ends without an error.

    An existing folder of ours is moved aside before and deleted after; any other one with files in it is refused, so
    that nothing foreign is ever lost. What runs that were killed left beside it is put right first: a folder of ours
    that was moved aside comes back, unfinished folders are removed.

    Raises ConfigError, which calls what should be there a `kind`, when there is a file, a link, or a folder with other
    files.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with _locked(target.parent):
        _clean_up(target, is_ours)
        _expect_ours(target, is_ours, kind)
        stage = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".stage", dir=target.parent))
        stage.chmod(0o755)
        lock = os.open(stage, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield stage
        with _locked(target.parent):
            _swap(stage, target)
    finally:
        os.close(lock)
        shutil.rmtree(stage, ignore_errors=True)


def write_bytes(path: Path, data: bytes, lasting: bool = True) -> None:
    """Write a file atomically, as `atomic_path` does."""
    with (
        atomic_path(path, lasting) as temporary,
        open(os.open(temporary, os.O_WRONLY | os.O_NOFOLLOW), "wb") as file,
    ):
        file.write(data)


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


def _finish(path: Path, lasting: bool) -> None:
    """Have the bytes of a file on the disk. Raises OSError where a link is in its place."""
    file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        if lasting:
            os.fsync(file)
    finally:
        os.close(file)


def _expect_ours(target: Path, is_ours: IsOurs, kind: str) -> None:
    if target.is_symlink():
        raise ConfigError(f"{target}: expected a folder for the {kind}, got a link")
    if target.exists() and not target.is_dir():
        raise ConfigError(f"{target}: expected a folder for the {kind}, got a file")
    if target.is_dir() and any(target.iterdir()) and not is_ours(target):
        raise ConfigError(f"{target}: expected a new folder or an existing {kind}, got a folder with other files")


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the only lock on this folder; the kernel frees it when the process dies."""
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _clean_up(target: Path, is_ours: IsOurs) -> None:
    def left(suffix: str) -> list[Path]:
        found = target.parent.glob(f".{glob.escape(target.name)}.*.{suffix}")
        return [path for path in found if path.is_dir() and not path.is_symlink()]

    for old in left("old"):
        if is_ours(old) and not target.exists():
            old.rename(target)
        else:
            shutil.rmtree(old, ignore_errors=True)
    for stage in left("stage"):
        lock = os.open(stage, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(stage, ignore_errors=True)
        except BlockingIOError:  # somebody is at work there
            pass
        finally:
            os.close(lock)


def _swap(stage: Path, target: Path) -> None:
    if not target.exists():
        stage.rename(target)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".old", dir=target.parent))
    os.replace(target, old)
    try:
        stage.rename(target)
    except OSError:
        os.replace(old, target)
        raise
    shutil.rmtree(old, ignore_errors=True)
