"""Files that other code reads by their paths: on this machine, or below an address, from which they come when needed.

A prefix of an object store is mirrored in a temporary folder. It has every object under its own name from the
beginning, as a hole of its length that takes no room on the disk. What is read is fetched into it; frames become holes
again, the least recently used first, where they take more room than `LIMIT`. So whatever reads local files reads these.
"""

from __future__ import annotations

import functools
import shutil
import tempfile
import threading
import weakref
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TypeVar

from airgs_codec.errors import SceneError
from airgs_codec.places.place import PARALLEL, bucket_at

LIMIT = 2 << 30  # bytes of frames on the disk, beside those that are held
_HEAD = 1 << 14  # bytes in which the header of a file is looked for first
_REOPENED = 2  # mirrors of other processes' sequences that a process has at most

Read = TypeVar("Read")


class Files:
    """Files of this machine, with which nothing has to be done; what comes from elsewhere overrides all of this."""

    @contextmanager
    def hold(self, paths: Iterable[Path]) -> Iterator[list[Path]]:
        """Gives where files, or frames that are folders, can be read whole until the block ends.

        Raises SceneError where one is gone, TransportError; and renames as `naming` does.
        """
        yield list(paths)

    def read_headers(self, paths: Sequence[Path], read: Callable[[Path], Read]) -> list[Read]:
        """Return what `read` gives of each frame, which looks no further than its header. Raises what `hold` does."""
        return [read(path) for path in paths]

    def beside(self, path: Path) -> Path | None:
        """Where a file that may lie beside the frames can be read; None where there is none. Raises TransportError."""
        return path if path.is_file() else None

    def name_of(self, path: Path) -> str:
        """A path for people."""
        return str(path)

    @contextmanager
    def naming(self) -> Iterator[None]:
        """A SceneError that the block raises names files for people."""
        yield


LOCAL = Files()


@dataclass(frozen=True, slots=True)
class Habits:
    """What a mirror must know of the files that are read from it."""

    is_small: Callable[[str], bool]  # whether a name is of a small file, which is fetched at once
    header: tuple[str, bytes, int]  # the ending of names of files with a header, how that ends, its longest length
    beside: str  # a folder whose files belong to a frame that lies beside it
    find_parts: Callable[[Path], list[str]]  # names of the files, beside a fetched one, that it cannot be read without


class Mirror(Files):
    """The files below one address. Each process has a folder of its own, which goes with it or sooner.

    `folder` is that of the process that opened the sequence: paths in it name the files wherever it is unpickled.
    """

    def __init__(
        self, address: str, habits: Habits, folder: Path | None = None, *, deep: bool = True, limit: int = LIMIT
    ) -> None:
        """`deep`: with what is below further slashes. `folder`: in the process that opened it, where that is another.

        Raises ConfigError, TransportError.
        """
        self._bucket, self._habits, self._deep, self._limit = bucket_at(address), habits, deep, limit
        temporary = tempfile.mkdtemp(prefix="airgs-")
        weakref.finalize(self, shutil.rmtree, temporary, ignore_errors=True)
        self._here = Path(temporary) / self._bucket.name.rpartition("/")[2]
        self.folder = folder or self._here
        self._lock = threading.RLock()
        self._frames: OrderedDict[str, int] = OrderedDict()  # lengths of what is whole of them, the last used last
        self._held: Counter[str] = Counter()
        self._fetched: set[str] = set()  # files beside the frames
        listed = self._bucket.sizes() if deep else self._bucket.own_sizes() | self._bucket.sizes(habits.beside)
        self._sizes = _as_files(listed)
        for name, size in self._sizes.items():
            _make_hole(self._here / name, size)

    @staticmethod
    def at(address: str, habits: Habits) -> tuple[Mirror, Path]:
        """The mirror of a prefix, or of that of an object, and the path of what the address names.

        Raises SceneError where nothing is there, ConfigError, TransportError.
        """
        mirror = Mirror(address, habits)
        place = mirror.folder
        if not mirror._sizes:
            holder, _, name = address.rstrip("/").rpartition("/")
            if holder.endswith("/") or name not in (mirror := Mirror(holder, habits, deep=False))._sizes:
                raise SceneError(f"{address}: expected a prefix with frames below it, or a file, got nothing")
            place = mirror.folder / name
        with ThreadPoolExecutor(PARALLEL) as pool:
            list(pool.map(mirror.beside, [mirror.folder / name for name in mirror._sizes if habits.is_small(name)]))
        return mirror, place

    def __reduce__(self) -> tuple[object, ...]:
        return _reopened, (self._bucket.name, self._habits, self.folder, self._deep, self._limit)

    @contextmanager
    def hold(self, paths: Iterable[Path]) -> Iterator[list[Path]]:
        """See `Files.hold`."""
        names = [self._name(path) for path in paths]
        with self._lock:
            parts = self._fetch_frames(names)
            self._held.update(parts)
        try:
            with self.naming():
                yield [self._here / name for name in names]
        finally:
            with self._lock:
                self._held.subtract(parts)
                self._make_room()

    def read_headers(self, paths: Sequence[Path], read: Callable[[Path], Read]) -> list[Read]:
        """See `Files.read_headers`: of files whose header has an end, only the first bytes are fetched."""
        names = [self._name(path) for path in paths]
        with ThreadPoolExecutor(PARALLEL) as pool:
            list(pool.map(self._fetch_header, filter(self._has_header, names)))
        headers = []
        for start in range(0, len(paths), PARALLEL):
            some = paths[start : start + PARALLEL]
            whole = [p for p in some if not (self._has_header(p.name) or (self._here / self._name(p)).is_dir())]
            with self.hold(whole):
                headers += [read(self._here / self._name(path)) for path in some]
        return headers

    def beside(self, path: Path) -> Path | None:
        """See `Files.beside`."""
        name = self._name(path)
        if name not in self._sizes:
            return None
        if name not in self._fetched:
            self._download(name)
            self._fetched.add(name)
        return self._here / name

    def name_of(self, path: Path) -> str:
        """The address of a path."""
        return self._told(str(path))

    @contextmanager
    def naming(self) -> Iterator[None]:
        """See `Files.naming`."""
        try:
            yield
        except SceneError as error:
            raise SceneError(self._told(str(error))) from error

    def _name(self, path: Path) -> str:
        return path.relative_to(self.folder).as_posix()

    def _told(self, words: str) -> str:
        """Words with the address in place of either folder."""
        for folder in {self._here, self.folder}:
            words = words.replace(str(folder), self._bucket.name)
        return words

    def _fetch_frames(self, names: Iterable[str]) -> list[str]:
        """Have all objects here that frames are of; gives their names."""
        parts = [part for name in names for part in self._parts(name)]
        self._fetch(parts)
        more = [
            f"{name.rpartition('/')[0]}/{other}".lstrip("/")
            for name in parts
            for other in self._habits.find_parts(self._here / name)
        ]
        self._fetch(more := [name for name in more if name in self._sizes])
        return parts + more

    def _parts(self, name: str) -> list[str]:
        """The objects of a file, or of a folder."""
        folder = self._here / name
        if not folder.is_dir():
            return [name]
        return [f"{name}/{path.name}" for path in sorted(folder.iterdir()) if not path.name.startswith(".")]

    def _fetch(self, names: Iterable[str]) -> None:
        missing = [name for name in dict.fromkeys(names) if name not in self._frames]
        with ThreadPoolExecutor(PARALLEL) as pool:
            sizes = list(pool.map(self._download, missing))
        self._frames.update(zip(missing, sizes, strict=True))
        for name in names:
            self._frames.move_to_end(name)

    def _download(self, name: str) -> int:
        size = self._bucket.download(name, self._here / name)
        if size is None:
            raise SceneError(f"{self._bucket.name}/{name}: expected the object that was listed, got nothing")
        return size

    def _has_header(self, name: str) -> bool:
        return name.lower().endswith(self._habits.header[0])

    def _fetch_header(self, name: str) -> None:
        """Write the first bytes of a file into its hole, as far as its header goes."""
        _, end, longest = self._habits.header
        size, length = self._sizes[name], _HEAD
        head = self._bucket.read_start(name, length) if size else b""
        while end not in head and length < min(size, longest):
            length *= 4
            head = self._bucket.read_start(name, length)
        with self._lock:
            if name not in self._frames:
                with (self._here / name).open("r+b") as file:
                    file.write(head)

    def _make_room(self) -> None:
        """Make holes of frames, the least recently used first, until those that are not held take `limit` at most."""
        free = [name for name in self._frames if not self._held[name]]
        taken = sum(self._frames[name] for name in free)
        for name in free:
            if taken <= self._limit:
                break
            taken -= self._frames.pop(name)
            _make_hole(self._here / name, self._sizes[name])


@functools.lru_cache(maxsize=_REOPENED)
def _reopened(address: str, habits: Habits, folder: Path, deep: bool, limit: int) -> Mirror:
    """The mirror of a sequence that was pickled in another process, the same for all copies of it in this one."""
    return Mirror(address, habits, folder, deep=deep, limit=limit)


def _as_files(sizes: dict[str, int]) -> dict[str, int]:
    """The objects that can be files: not those that stand for a folder, and none outside of their prefix."""
    paths = {name: PurePosixPath(name) for name in sizes}
    folders = {str(folder) for path in paths.values() for folder in path.parents}
    return {name: sizes[name] for name, path in paths.items() if name not in folders and ".." not in path.parts}


def _make_hole(path: Path, size: int) -> None:
    """A file of this length that takes no room."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.truncate(size)
