"""Files of packages as they are at the moment of a request, each with the SHA-256 of just these bytes; and the page.

A package may grow or be replaced while it is served: what a client gets under one entity tag is one version of a file,
never a mixture of two. Texts, which change, are read whole and served from memory. Of other files only the digest is
kept; they are read in pieces as a connection takes them, each from a file that is still the one that was hashed.
"""

from __future__ import annotations

import asyncio
import errno
import gzip
import hashlib
import os
import re
import stat
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.layout import INIT_NAME, JSON_NAME, MEDIA_TYPES, POSTER_NAME, ROOTS
from airgs_codec.serve.pages import PAGE, PAGE_TYPES

CACHE_BYTES = 64 << 20
SETTLED_NS = 2_000_000_000  # a younger file may change without a new time stamp (the coarsest are 2 s apart)
ENTRY_BYTES = 1024  # that a digest takes in memory, about
LEAST_ZIPPED_BYTES = 1024  # what fits one packet gains nothing
MOST_HELD_BYTES = 4 << 20  # of a text; a longer one is read in pieces, too
HASHED_BYTES = 1 << 18  # that are hashed at once
ATTEMPTS, PAUSE_S = 5, 0.02  # to read a file that is being written
_BELOW = r"(?:group|index|key|sound|state)/(?:[A-Za-z0-9_-]+/){0,3}[A-Za-z0-9_-]+(?:\.[a-z0-9]+){1,2}"
_PATH = re.compile("|".join([*map(re.escape, (*ROOTS, INIT_NAME, POSTER_NAME)), _BELOW]), re.ASCII)
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
        if not found and not _is_empty(folder):
            kinds = f"a package with {JSON_NAME}, a folder with packages or an empty one"
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
    return os.path.isfile(folder / JSON_NAME)  # False, too, where it may not be looked at


def _is_empty(folder: Path) -> bool:
    """Whether a folder has no files but hidden ones: packages may be on their way."""
    return folder.is_dir() and all(path.name.startswith(".") for path in folder.iterdir())


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
class Version:
    """Bytes that a client may be given, whole or in parts."""

    size: int
    sha256: bytes
    read: Callable[[int, int], bytes]  # from start to stop; raises OSError where another version has come since

    @staticmethod
    def of(data: bytes) -> Version:
        """These bytes."""
        return Version(len(data), hashlib.sha256(data).digest(), lambda start, stop: data[start:stop])


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A file at one moment."""

    media_type: str
    lasting: bool  # the file never changes under its name
    plain: Version
    zipped: Version | None  # its gzip where that is worth it
    held_bytes: int  # that it takes in memory


def media_type(path: str) -> str | None:
    """The media type of a file of a package by its path, None for a path that no file of a package has."""
    if not _PATH.fullmatch(path):
        return None
    name = path.rpartition("/")[2]
    return MEDIA_TYPES.get(name[name.index(".") :])


class PackageFiles:
    """The files of packages, each below its folder's name, and of the page that plays them.

    Texts and digests of those that were asked for last stay in memory, `cache_bytes` at most.
    """

    def __init__(self, folders: list[Path], cache_bytes: int = CACHE_BYTES) -> None:
        """`folders`: packages, and folders that hold packages, of which new ones are found as they appear.

        Raises ConfigError for a folder of neither kind and for two packages of one name.
        """
        self._shelves = Shelves(folders)
        self._cache_bytes = cache_bytes
        self._cache: OrderedDict[tuple[str, str], tuple[Stamp, Snapshot]] = OrderedDict()
        self._held_bytes = 0
        self._loading: dict[tuple[tuple[str, str], Stamp], asyncio.Task[tuple[Stamp, Snapshot] | None]] = {}

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
        task = self._loading.get((key, stamp))
        if task is None:  # all who ask meanwhile wait for this one
            task = self._loading[key, stamp] = asyncio.create_task(asyncio.to_thread(_load, folder, path, kind))
            task.add_done_callback(lambda _: self._loading.pop((key, stamp)))
        loaded = await asyncio.shield(task)
        if loaded and time.time_ns() - max(loaded[0][-2:]) > SETTLED_NS:
            self._remember(key, loaded)
        return loaded[1] if loaded else None

    def _remember(self, key: tuple[str, str], entry: tuple[Stamp, Snapshot]) -> None:
        if old := self._cache.pop(key, None):
            self._held_bytes -= old[1].held_bytes
        self._cache[key] = entry
        self._held_bytes += entry[1].held_bytes
        while self._held_bytes > self._cache_bytes:
            _, (_, dropped) = self._cache.popitem(last=False)
            self._held_bytes -= dropped.held_bytes


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
    """One version of a file, which is read to its end. Raises TransportError where it keeps changing."""
    lasting = "/" in path or path in (INIT_NAME, POSTER_NAME)  # neither a root of a package nor the page
    for _ in range(ATTEMPTS):
        descriptor = _open(folder, path)
        if descriptor is None:
            return None
        try:
            stamp = _stamp(descriptor)
            if stamp is None:
                return None
            if path.endswith(_TEXT) and stamp[2] <= MOST_HELD_BYTES:
                snapshot = _hold(kind, lasting, os.pread(descriptor, stamp[2], 0))
            else:
                plain = Version(stamp[2], _hash(descriptor, stamp[2]), partial(_read_part, folder, path, stamp))
                snapshot = Snapshot(kind, lasting, plain, None, ENTRY_BYTES)
            if stamp == _stamp(descriptor):
                return stamp, snapshot
        finally:
            os.close(descriptor)
        time.sleep(PAUSE_S)
    raise TransportError(f"{path}: expected a whole file, got one that is being written")


def _hold(kind: str, lasting: bool, data: bytes) -> Snapshot:
    zipped = gzip.compress(data, mtime=0) if len(data) >= LEAST_ZIPPED_BYTES else None
    held_bytes = ENTRY_BYTES + len(data) + len(zipped or b"")
    return Snapshot(kind, lasting, Version.of(data), None if zipped is None else Version.of(zipped), held_bytes)


def _hash(descriptor: int, size: int) -> bytes:
    sha256 = hashlib.sha256()
    for start in range(0, size, HASHED_BYTES):
        sha256.update(os.pread(descriptor, min(HASHED_BYTES, size - start), start))
    return sha256.digest()


def _read_part(folder: Path, path: str, stamp: Stamp, start: int, stop: int) -> bytes:
    """Bytes of the file with this stamp. Raises TransportError where it is another now."""
    descriptor = _open(folder, path)
    if descriptor is not None:
        try:
            data = os.pread(descriptor, stop - start, start)
            if _stamp(descriptor) == stamp:
                return data
        finally:
            os.close(descriptor)
    raise TransportError(f"{path}: expected the version that was asked for, got another")
