"""Files under relative paths in a folder of this machine, memory, a bucket or a web server.

Nothing that reads or writes a place needs to know which it is. It can be pickled: other processes open it by its
address. Folders are read by the calls of the operating system, which take a third of the time of obstore's for
small files; all that has an address is reached by obstore, with endpoint and credentials from the environment.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import stat
import tempfile
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import timedelta
from functools import cache, partial
from itertools import accumulate
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from airgs_codec._arguments import path_argument
from airgs_codec.errors import ConfigError, FormatError, SceneError, TransportError
from airgs_codec.places.whole import write_bytes
from airgs_codec.progress import Progress, silent

if TYPE_CHECKING:
    from obstore import GetResult
    from obstore.store import ObjectStore

BUCKETS = ("s3", "gs", "az")
WEB = ("http", "https")
BUSY = (429, 502, 503, 504)
SILENCE_S = 8.0  # without an answer, before a server counts as silent
CIRCLE = "its redirects lead in a circle"
_KEY = "a key, such as stands in an address after the ?, may be missing or too old"
_HINTS = {401: "the server asks for a sign-in", 403: f"the server refuses: {_KEY}", 404: "the server has no such file"}
PARALLEL = 16  # requests at a time
PLAIN: Mapping[str, str] = {}
_LINK = "expected a plain file, got a link"
_PATIENCE = {"retry_timeout": timedelta(seconds=SILENCE_S / 2)}  # no request is begun again later
_FAULTS = {  # in the text of an error of obstore -> what that means
    "kind: Timeout": f"the server is silent: nothing came in {SILENCE_S:g} s, or not all in 30 s",
    "TooManyRedirects": f"expected a file, got none: {CIRCLE}",
    "dns error": "no server has that name",
    "kind: Connect": "the server cannot be reached",
    "kind: Interrupted": "broken off: the answer is shorter than it says",
    "kind: Request": "broken off: the server ended the connection",
}
_NO_CREDENTIALS = re.compile(r"169\.254\.\d+\.\d+|metadata\.google\.internal|Account must be specified")


class Storage(ABC):
    """Files by their paths, with slashes, below one folder or address. All methods raise OSError (TransportError)."""

    name: str  # the folder or address, for messages

    @abstractmethod
    def open(self, path: str) -> tuple[int, Callable[[], bytes]] | None:
        """Return the length of a file and a function that reads it whole; None where there is none.

        Raises FormatError (unsafe_path) where a folder has a link there.
        """

    @abstractmethod
    def sizes(self) -> dict[str, int]:
        """Return the length of every file at any depth, by path."""

    @abstractmethod
    def write(self, path: str, data: bytes, headers: Mapping[str, str] = PLAIN) -> None:
        """Write a file, whole or not at all; a bucket stores the `headers` with it."""

    @abstractmethod
    def delete(self, paths: Iterable[str]) -> None: ...

    def read(self, path: str) -> bytes | None:
        return found[1]() if (found := self.open(path)) else None

    def paths(self) -> list[str]:
        return sorted(self.sizes())


@dataclass(frozen=True, slots=True)
class Folder(Storage):
    """The files below a folder of this machine, which is made when it is needed. No link below it is followed."""

    path: Path

    @property
    def name(self) -> str:  # type: ignore[override]
        return str(self.path)

    def open(self, path: str) -> tuple[int, Callable[[], bytes]] | None:
        file = self._file(path)
        try:
            found = os.lstat(file)
        except (FileNotFoundError, NotADirectoryError):
            return None
        if stat.S_ISLNK(found.st_mode):
            raise FormatError("unsafe_path", path, _LINK)
        return (found.st_size, file.read_bytes) if stat.S_ISREG(found.st_mode) else None

    def sizes(self) -> dict[str, int]:
        entries = (p for p in self.path.rglob("*") if p.is_symlink() or not p.is_dir())  # links count as files
        return {p.relative_to(self.path).as_posix(): p.lstat().st_size for p in entries}

    def write(self, path: str, data: bytes, headers: Mapping[str, str] = PLAIN) -> None:
        file = self._file(path)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(file, data)

    def delete(self, paths: Iterable[str]) -> None:
        for path in paths:
            self._file(path).unlink(missing_ok=True)

    def _file(self, path: str) -> Path:
        """Return the path of a file. Raises FormatError (unsafe_path) where a folder above it is a link."""
        above = accumulate([str(self.path), *path.split("/")[:-1]], "{}/{}".format)
        if any(map(os.path.islink, itertools.islice(above, 1, None))):
            raise FormatError("unsafe_path", path, _LINK)
        return self.path / path


@dataclass(frozen=True, slots=True, eq=False)
class Memory(Storage):
    name: str
    files: dict[str, bytes] = field(default_factory=dict)

    def open(self, path: str) -> tuple[int, Callable[[], bytes]] | None:
        data = self.files.get(path)
        return None if data is None else (len(data), lambda: data)

    def sizes(self) -> dict[str, int]:
        return {path: len(data) for path, data in self.files.items()}

    def write(self, path: str, data: bytes, headers: Mapping[str, str] = PLAIN) -> None:
        self.files[path] = bytes(data)

    def delete(self, paths: Iterable[str]) -> None:
        for path in list(paths):
            self.files.pop(path, None)


class Bucket(Storage):
    """The objects below a prefix of an object store, or the files of a web server, which are only read."""

    def __init__(self, address: str, objects: ObjectStore) -> None:
        self.name = split_query(address)[0]
        self._address, self._objects = address, objects

    def __reduce__(self) -> tuple[object, ...]:
        return _reopened, (self._address,)

    def open(self, path: str) -> tuple[int, Callable[[], bytes]] | None:
        with self._naming(path):
            found = self._get(path)

        def read(found: GetResult) -> bytes:
            with self._naming(path):
                return bytes(found.bytes())

        return (found.meta["size"], partial(read, found)) if found else None

    def sizes(self, below: str = "") -> dict[str, int]:
        """Return the length of every object below a path."""
        with self._naming():
            listed = self._objects.list(below or None)
            return {meta["path"]: meta["size"] for some in listed for meta in some if meta["path"]}

    def write(self, path: str, data: bytes, headers: Mapping[str, str] = PLAIN) -> None:
        with self._naming(path):
            self._objects.put(path, data, attributes=dict(headers))

    def copy(self, source: str, target: str) -> None:
        with self._naming(target):
            self._objects.copy(source, target)

    def delete(self, paths: Iterable[str]) -> None:
        with self._naming():
            if gone := sorted(paths):
                self._objects.delete(gone)

    def _get(self, path: str) -> GetResult | None:
        try:
            return self._objects.get(path)
        except FileNotFoundError as error:
            if re.search("NoSuchBucket|ContainerNotFound", str(error)):
                raise
            return None

    @contextmanager
    def _naming(self, path: str = "") -> Iterator[None]:
        from obstore.exceptions import BaseError

        try:
            yield
        except (BaseError, OSError) as error:
            raise TransportError(f"{self.name}{'/' if path else ''}{path}: {_words(error)}") from error


class Copied:
    """A folder or a file at an address, copied to a temporary folder of this machine, which lasts as long as this.

    A process of this machine that unpickles it reads the same copy; on another machine it is copied again.
    """

    def __init__(
        self, address: str, companions: tuple[str, ...] = (), progress: Progress = silent, path: Path | None = None
    ) -> None:
        """Copy a prefix, or one file with the files and folders of the names `companions`, unless `path` is a copy.

        Raises ConfigError for a bad address or where the disk has no room, SceneError for nothing, TransportError.
        """
        self.address, self._companions, self.path = address.rstrip("/"), companions, path or Path()
        self.files = self.bytes = 0
        if path and path.exists():
            return
        source, below = bucket_at(self.address), ""  # the path of a single file below the folder that is copied
        sizes, (holder, _, name) = _as_files(source.sizes()), self.address.rpartition("/")
        if not sizes and not holder.endswith("/") and (found := (source := bucket_at(holder)).open(name)):
            small = [(path, source.open(path)) for path in companions]
            sizes = {name: found[0], **{path: one[0] for path, one in small if one}}
            sizes |= _as_files({path: size for part in companions for path, size in source.sizes(part).items()})
            below = name
        if not sizes:
            raise SceneError(f"{address}: expected a prefix with frames below it, or a file, got nothing")
        self.path = path or Path(tempfile.mkdtemp(prefix="airgs-")) / source.name.rpartition("/")[2] / below
        folder = self.path.parent if below else self.path
        weakref.finalize(self, shutil.rmtree, folder.parent, ignore_errors=True)
        self._copy(source, sizes, folder, progress)

    def _copy(self, source: Bucket, sizes: Mapping[str, int], folder: Path, progress: Progress) -> None:
        total = sum(sizes.values())
        folder.parent.mkdir(parents=True, exist_ok=True)
        if (free := shutil.disk_usage(folder.parent).free) < total:
            expected = f"expected {total / 1e9:.2f} GB of room for {self.address}"
            raise ConfigError(f"{folder.parent}: {expected}, got {free / 1e9:.2f} GB")
        stage = Path(tempfile.mkdtemp(dir=folder.parent))
        for path in sizes:
            (stage / path).parent.mkdir(parents=True, exist_ok=True)
        progress("copying", 0, max(1, total))

        def copy(path: str) -> int:
            if (data := source.read(path)) is None:
                raise SceneError(f"{source.name}/{path}: expected the file that was listed, got nothing")
            return (stage / path).write_bytes(data)

        with ThreadPoolExecutor(PARALLEL) as pool:
            for done in accumulate(pool.map(copy, sizes)):
                progress("copying", done, max(done, total, 1))
        self.files, self.bytes = len(sizes), done
        with suppress(OSError):  # another process was sooner
            stage.rename(folder)

    def named(self, words: str) -> str:
        """Return words with addresses in place of paths of copies."""
        holder = self.address.rpartition("/")[0]
        return words.replace(str(self.path), self.address).replace(str(self.path.parent), holder)

    def __str__(self) -> str:
        return f"{self.address}: {self.files} file{'s' * (self.files != 1)}, {self.bytes / 1e6:.3g} MB, copied here"

    def __reduce__(self) -> tuple[object, ...]:
        return _copied_here, (self.address, self._companions, self.path)


@cache
def _copied_here(address: str, companions: tuple[str, ...], path: Path) -> Copied:
    return Copied(address, companions, path=path)


def _as_files(sizes: Mapping[str, int]) -> dict[str, int]:
    """Return the objects that can be files: none that stands for a folder or is outside of its prefix."""
    paths = {name: PurePosixPath(name) for name in sizes}
    folders = {str(folder) for path in paths.values() for folder in path.parents}
    return {name: sizes[name] for name, path in paths.items() if name not in folders and ".." not in path.parts}


def is_address(place: str | Path) -> bool:
    """Return whether a place is an address rather than a folder; a `Path` is none."""
    return "://" in str(place)


def place_at(place: str | Path, schemes: tuple[str, ...] = BUCKETS) -> Storage:
    """Return the place at a folder or an address. Raises ConfigError as `bucket_at` does, and for what is no path."""
    place = path_argument("path", place)
    return bucket_at(str(place), schemes) if is_address(place) else Folder(Path(place))


def bucket_at(address: str, schemes: tuple[str, ...] = BUCKETS) -> Bucket:
    """Return the prefix at an address: s3://bucket/prefix, gs://bucket/prefix, az://container/prefix.

    `schemes`: which addresses can be used. Raises ConfigError.
    """
    scheme = address.partition("://")[0]
    if scheme not in schemes:
        known = ", ".join(f"{scheme}://" for scheme in schemes)
        raise ConfigError(f"{address}: expected a folder or an address of {known}, got {scheme}://")
    from obstore.exceptions import BaseError
    from obstore.store import from_url

    address, options = "".join(split_query(address)), {}
    if scheme in WEB:
        client = {"allow_http": True, "read_timeout": timedelta(seconds=SILENCE_S)}
        options = {"client_options": client, "retry_config": _PATIENCE}
    try:
        return Bucket(address, from_url(address, **options))  # type: ignore[call-overload]
    except (BaseError, ValueError) as error:
        raise ConfigError(f"{address}: {_words(error)}") from error


@cache
def _reopened(address: str) -> Bucket:
    return bucket_at(address, BUCKETS + WEB)


def _words(error: Exception) -> str:
    """Return one line on an error of obstore, whose messages are pages."""
    text, _, cause = str(error).partition("\n\nDebug source")
    if _NO_CREDENTIALS.search(text):
        return "no credentials: expected them in the environment (docs/serving.md), this machine has none of its own"
    answer = re.search(r"<Message>([^<\n]+)", text)
    status = re.search(r"status code: (\d+)", text)
    known = status_words(int(status[1])) if status else next((_FAULTS[part] for part in _FAULTS if part in cause), "")
    return answer[1] if answer else known or " ".join(text.split())


def split_query(address: str) -> tuple[str, str]:
    """Split an address before its query, and remove slashes at the end of what is before."""
    before, mark, query = address.partition("?")
    return before if before.endswith("://") else before.rstrip("/"), mark + query


def status_words(status: int) -> str:
    """Return what is wrong with an answer that has a status other than 200."""
    hint = _HINTS.get(status, "the server is busy" if status in BUSY else "")
    return f"expected a file, got status {status}{hint and f' ({hint})'}"


def got_words(data: bytes, otherwise: str) -> str:
    """Return "a web page" where bytes begin as one, else the other words."""
    return "a web page" if data[:64].removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<") else otherwise
