"""Packages on disk: reading with checks, writing whole or not at all."""

from __future__ import annotations

import fcntl
import glob
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from airgs_codec._files import write_bytes
from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.package.parse import parse_manifest
from airgs_codec.package.tables import JSON_NAME, MPD_NAME, FileEntry, Manifest

MAX_JSON_BYTES = 1 << 28


@dataclass(frozen=True, slots=True, eq=False)
class Package:
    """An open package: its tables, and its files by their relative paths."""

    path: Path
    manifest: Manifest
    manifest_bytes: int  # airgs.json and manifest.mpd together

    def read(self, relative: str) -> bytes:
        """A listed file, whole and unaltered.

        Raises FormatError: missing_entry, missing_file, unsafe_path (a link), size_mismatch, hash_mismatch.
        """
        entry = self.manifest.files.get(relative)
        if entry is None:
            raise FormatError("missing_entry", relative, f"no entry in {JSON_NAME}")
        data = self._load(relative, entry.bytes)
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            raise FormatError("hash_mismatch", relative, "the SHA-256 differs from the one in airgs.json")
        return data

    def _load(self, relative: str, expected: int) -> bytes:
        path = self.path
        for part in Path(relative).parts:
            path = path / part
            if path.is_symlink():
                raise FormatError("unsafe_path", relative, "expected a plain file, got a link")
        if not path.is_file():
            raise FormatError("missing_file", relative, "expected a file, got nothing")
        size = path.stat().st_size
        if size != expected:
            raise FormatError("size_mismatch", relative, f"expected {expected} bytes, got {size}")
        return path.read_bytes()


def open_package(path: str | Path) -> Package:
    """Open the package in the folder `path`: read and check its tables; other files are read when they are needed.

    Raises FormatError: missing_file, too_large, or one of the reasons of `parse_manifest`.
    """
    path = Path(path)
    mpd, tables = path / MPD_NAME, path / JSON_NAME
    for file in (mpd, tables):
        if file.is_symlink() or not file.is_file():
            raise FormatError("missing_file", str(file), "expected a package with manifest.mpd and airgs.json")
    if tables.stat().st_size > MAX_JSON_BYTES:
        raise FormatError("too_large", str(tables), f"expected at most {MAX_JSON_BYTES} bytes")
    data = tables.read_bytes()
    return Package(path, parse_manifest(data), len(data) + mpd.stat().st_size)


def write_file(folder: Path, relative: str, data: bytes) -> FileEntry:
    """Write a file of a package, whole or not at all; gives its entry in the tables."""
    path = folder / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data)
    return FileEntry(len(data), hashlib.sha256(data).hexdigest())


@contextmanager
def staged(target: Path) -> Iterator[Path]:
    """A folder beside `target` that takes its place when the block ends without an error.

    An existing package is moved aside before and deleted after; any other existing folder with files in it is
    refused (ConfigError), so that nothing foreign is ever lost. What killed runs left beside `target` is put right
    first: a package moved aside comes back, unfinished folders go.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with _locked(target.parent):
        _mend(target)
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
    """Alone among those who lock this folder; the kernel lets a lock go when its process dies."""
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _mend(target: Path) -> None:
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
