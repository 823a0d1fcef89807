"""Files of packages as they are at the moment of a request, each with the SHA-256 of just these bytes; and the page.

A package may grow or be replaced while it is served. A file is therefore opened anew for every request, read whole, and
served from memory: what a client gets under one entity tag is one version of the file, never a mixture of two.
"""

from __future__ import annotations

import asyncio
import errno
import gzip
import os
import re
import stat
import time
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.paths import INIT_NAME, JSON_NAME, MEDIA_TYPES, ROOTS
from airgs_codec.package.tables import digest
from airgs_codec.serve.pages import PAGE, PAGE_TYPES

CACHE_BYTES = 64 << 20
SETTLED_NS = 2_000_000_000  # a younger file may change without a new time stamp (the coarsest are 2 s apart)
LEAST_ZIPPED_BYTES = 1024  # what fits one packet gains nothing
ATTEMPTS, PAUSE_S = 5, 0.02  # to read a file that is being written
_BELOW = r"(?:group|index|key|state)/(?:[A-Za-z0-9_-]+/){0,3}[A-Za-z0-9_-]+(?:\.[a-z0-9]+){1,2}"
_PATH = re.compile("|".join([*map(re.escape, (*ROOTS, INIT_NAME)), _BELOW]), re.ASCII)
_ABSENT = {errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.EACCES, errno.ENAMETOOLONG, errno.ENXIO}
_TEXT = (".json", ".mpd", ".html", ".js")  # the only files that are not compressed already

Stamp = tuple[int, ...]  # device, inode, bytes, ns of the last change of the bytes and of the inode


class Shelves:
    """The folders of packages by their names: those named one by one, and those in folders that hold packages."""

    def __init__(self, folders: list[Path]) -> None:
        """`folders`: packages, and folders that hold packages.

        Raises ConfigError for a folder of neither kind and for two packages of one name.
        """
        self._named: dict[str, Path] = {}
        self._holders: list[Path] = []
        self._known: dict[str, Path] = {}
        for folder in folders:
            self._add(folder)

    def _add(self, folder: Path) -> None:
        own = _is_package(folder)
        found = {folder.resolve().name: folder.absolute()} if own else _packages_in(folder)
        if not found:
            kinds = f"a package with {JSON_NAME} or a folder with packages"
            raise ConfigError(f"{folder}: expected {kinds}, got nothing of that kind")
        for name in sorted(found.keys() & self._known.keys()):
            raise ConfigError(f"{found[name]}: expected packages of different names, got {name} twice")
        self._known |= found
        if own:
            self._named |= found
        else:
            self._holders.append(folder.absolute())

    def packages(self) -> dict[str, Path]:
        """Those that are there now. Where a name has come up twice, the folder that was named first has it."""
        found: dict[str, Path] = {}
        for holder in reversed(self._holders):
            found |= _packages_in(holder)
        self._known = found | self._named
        return dict(self._known)

    def find(self, name: str) -> Path | None:
        """The folder of a package, None where there is no such package."""
        return self._known.get(name) or self.packages().get(name)


def _is_package(folder: Path) -> bool:
    return (folder / JSON_NAME).is_file()


def _packages_in(holder: Path) -> dict[str, Path]:
    """The packages in a folder: no links, nothing hidden, and no name that an address cannot have."""
    try:
        with os.scandir(holder) as entries:
            names = sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
    except OSError:
        return {}
    usable = (name for name in names if not name.startswith(".") and name.isprintable())
    return {name: holder.absolute() / name for name in usable if _is_package(holder / name)}


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A file at one moment."""

    media_type: str
    lasting: bool  # the file never changes under its name
    data: bytes
    sha256: str  # of `data`, as in the tables: the first 24 bytes in base64url
    zipped: bytes | None  # gzip of `data` where that is worth it


def media_type(path: str) -> str | None:
    """The media type of a file of a package by its path, None for a path that no file of a package has."""
    if not _PATH.fullmatch(path):
        return None
    name = path.rpartition("/")[2]
    return MEDIA_TYPES.get(name[name.index(".") :])


class PackageFiles:
    """The files of packages, each below its folder's name, and of the page that plays them.

    Recently read ones stay in memory, `cache_bytes` at most.
    """

    def __init__(self, folders: list[Path], cache_bytes: int = CACHE_BYTES) -> None:
        """`folders`: packages, and folders that hold packages, of which new ones are found as they appear.

        Raises ConfigError for a folder of neither kind and for two packages of one name.
        """
        self._shelves = Shelves(folders)
        self._cache_bytes = cache_bytes
        self._cache: OrderedDict[tuple[str, str], tuple[Stamp, Snapshot]] = OrderedDict()
        self._held_bytes = 0

    @property
    def packages(self) -> Mapping[str, Path]:
        """The folders of the packages that are there now, by name."""
        return self._shelves.packages()

    async def read(self, name: str, path: str) -> Snapshot | None:
        """A file of the package `name` as it is now, None where there is none.

        Links, other things than plain files, and paths that no file of a package has, count as none. Raises
        TransportError (OSError) for a file that is being written, OSError where the system refuses.
        """
        kind = media_type(path)
        folder = self._shelves.find(name) if kind else None
        return None if kind is None or folder is None else await self._read((name, path), folder, kind)

    async def read_page(self, name: str) -> Snapshot | None:
        """A file of the page, a name of `PAGE_TYPES`, None where it is not built. Raises OSError as `read` does."""
        return await self._read(("", name), PAGE, PAGE_TYPES[name])

    async def _read(self, key: tuple[str, str], folder: Path, kind: str) -> Snapshot | None:
        """The file key[1] of a folder."""
        path = key[1]
        stamp = _stamp_of(folder, path)
        cached = self._cache.get(key)
        if stamp is None:
            return None
        if cached and cached[0] == stamp:
            self._cache.move_to_end(key)
            return cached[1]
        loaded = await asyncio.to_thread(_load, folder, path, kind)
        if loaded and time.time_ns() - max(loaded[0][-2:]) > SETTLED_NS:
            self._remember(key, loaded)
        return loaded[1] if loaded else None

    def _remember(self, key: tuple[str, str], entry: tuple[Stamp, Snapshot]) -> None:
        if old := self._cache.pop(key, None):
            self._held_bytes -= _held(old[1])
        self._cache[key] = entry
        self._held_bytes += _held(entry[1])
        while self._held_bytes > self._cache_bytes:
            _, (_, dropped) = self._cache.popitem(last=False)
            self._held_bytes -= _held(dropped)


def _held(snapshot: Snapshot) -> int:
    return len(snapshot.data) + len(snapshot.zipped or b"")


def _open(folder: Path, path: str) -> int | None:
    """A descriptor of a file below `folder`, no link on the way to it; None if there is none."""
    *parents, name = path.split("/")
    at = None
    try:
        at = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        for part in parents:
            inner = os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=at)
            os.close(at)
            at = inner
        return os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=at)  # a FIFO must not block
    except OSError as error:
        if error.errno in _ABSENT:
            return None
        raise
    finally:
        if at is not None:
            os.close(at)


def _stamp(descriptor: int) -> Stamp | None:
    s = os.fstat(descriptor)
    return (s.st_dev, s.st_ino, s.st_size, s.st_mtime_ns, s.st_ctime_ns) if stat.S_ISREG(s.st_mode) else None


def _stamp_of(folder: Path, path: str) -> Stamp | None:
    descriptor = _open(folder, path)
    if descriptor is None:
        return None
    try:
        return _stamp(descriptor)
    finally:
        os.close(descriptor)


def _load(folder: Path, path: str, kind: str) -> tuple[Stamp, Snapshot] | None:
    """One version of a file, read whole. Raises TransportError where it keeps changing."""
    for _ in range(ATTEMPTS):
        descriptor = _open(folder, path)
        if descriptor is None:
            return None
        with os.fdopen(descriptor, "rb") as file:
            before = _stamp(descriptor)
            if before is None:
                return None
            data = file.read()
            if before == _stamp(descriptor) and len(data) == before[2]:
                return before, _snapshot(path, kind, data)
        time.sleep(PAUSE_S)
    raise TransportError(f"{path}: expected a whole file, got one that is being written")


def _snapshot(path: str, kind: str, data: bytes) -> Snapshot:
    text = path.endswith(_TEXT) and len(data) >= LEAST_ZIPPED_BYTES
    lasting = "/" in path or path == INIT_NAME  # neither a root of a package nor the page
    return Snapshot(kind, lasting, data, digest(data), gzip.compress(data, mtime=0) if text else None)
