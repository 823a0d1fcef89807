"""A folder is written whole or not at all: it is made beside its place, which it takes when it is finished."""

from __future__ import annotations

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from airgs_codec.errors import ConfigError

IsOurs = Callable[[Path], bool]  # whether a folder with files in it is of the kind that may be replaced


@contextmanager
def staged(target: Path, is_ours: IsOurs, kind: str) -> Iterator[Path]:
    """Gives a folder beside `target` that takes its place when the block ends without an error.

    An existing folder of ours is moved aside before and deleted after; any other one with files in it is refused, so
    that nothing foreign is ever lost. What runs that were killed left beside it is put right first: a folder of ours
    that was moved aside comes back, unfinished folders are removed.

    Raises ConfigError, which calls what should be there a `kind`, when there is a file or a folder with other files.
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


def _expect_ours(target: Path, is_ours: IsOurs, kind: str) -> None:
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
    name = glob.escape(target.name)
    for old in target.parent.glob(f".{name}.*.old"):
        if is_ours(old) and not target.exists():
            old.rename(target)
        else:
            shutil.rmtree(old, ignore_errors=True)
    for stage in target.parent.glob(f".{name}.*.stage"):
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
