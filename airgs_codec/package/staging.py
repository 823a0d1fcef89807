"""Packages are written whole or not at all: files replace each other, and a finished folder takes its place at once."""

from __future__ import annotations

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from airgs_codec._files import write_bytes
from airgs_codec.errors import ConfigError
from airgs_codec.package.paths import MPD_NAME
from airgs_codec.package.tables import FileEntry, file_entry


def write_file(folder: Path, relative: str, data: bytes) -> FileEntry:
    """Write a file of a package, whole or not at all. Returns its entry for the tables."""
    path = folder / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data)
    return file_entry(data)


@contextmanager
def staged(target: Path) -> Iterator[Path]:
    """Gives a folder beside `target` that takes its place when the block ends without an error.

    An existing package is moved aside before and deleted after; any other existing folder with files in it is
    refused, so that nothing foreign is ever lost. What runs that were killed left beside `target` is put right first:
    a package that was moved aside comes back, unfinished folders are removed.

    Raises ConfigError when `target` is a file or a folder that holds other files than a package.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with _locked(target.parent):
        _clean_up(target)
        if target.exists() and not target.is_dir():
            raise ConfigError(f"{target}: expected a folder for the package, got a file")
        if target.is_dir() and any(target.iterdir()) and not (target / MPD_NAME).is_file():
            raise ConfigError(f"{target}: expected a new folder or an existing package, got a folder with other files")
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


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the only lock on this folder; the kernel frees it when the process dies."""
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _clean_up(target: Path) -> None:
    name = glob.escape(target.name)
    for old in target.parent.glob(f".{name}.*.old"):
        if (old / MPD_NAME).is_file() and not target.exists():
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
