"""A package in a folder is written whole or not at all: files replace each other, a finished folder takes its place."""

from __future__ import annotations

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from airgs_codec._files import write_bytes
from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.package.paths import MPD_NAME
from airgs_codec.package.tables import FileEntry, file_entry


@dataclass(frozen=True, slots=True)
class Folder:
    """The files of a package in a folder of this machine; `storage.Storage` says what each method does."""

    path: Path

    @property
    def name(self) -> str:
        """The folder, for messages."""
        return str(self.path)

    def open(self, relative: str) -> tuple[int, Callable[[], bytes]]:
        """Length of a file, and what reads it. Raises FormatError: missing_file, unsafe_path (a link)."""
        path = self.path
        for part in Path(relative).parts:
            path = path / part
            if path.is_symlink():
                raise FormatError("unsafe_path", relative, "expected a plain file, got a link")
        if not path.is_file():
            raise FormatError("missing_file", relative, "expected a file, got nothing")
        return path.stat().st_size, path.read_bytes

    def write(self, relative: str, data: bytes) -> FileEntry:
        """Write a file, whole or not at all. Returns its entry for the tables."""
        path = self.path / relative
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, data)
        return file_entry(data)

    def paths(self) -> list[str]:
        """Everything below the folder but folders."""
        entries = (p for p in self.path.rglob("*") if p.is_symlink() or not p.is_dir())
        return sorted(p.relative_to(self.path).as_posix() for p in entries)

    @contextmanager
    def staged(self) -> Iterator[Path]:
        """Gives a folder beside this one that takes its place when the block ends without an error.

        An existing package is moved aside before and deleted after; any other existing folder with files in it is
        refused, so that nothing foreign is ever lost. What runs that were killed left beside it is put right first: a
        package that was moved aside comes back, unfinished folders are removed.

        Raises ConfigError when there is a file, or a folder that holds other files than a package.
        """
        target = self.path
        target.parent.mkdir(parents=True, exist_ok=True)
        with _locked(target.parent):
            _clean_up(target)
            _expect_package(target)
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


def _expect_package(target: Path) -> None:
    if target.exists() and not target.is_dir():
        raise ConfigError(f"{target}: expected a folder for the package, got a file")
    if target.is_dir() and any(target.iterdir()) and not (target / MPD_NAME).is_file():
        raise ConfigError(f"{target}: expected a new folder or an existing package, got a folder with other files")


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
