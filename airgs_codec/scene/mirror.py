"""A sequence below an address of an object store, as a temporary folder whose files come when they are read.

The folder has every object of the prefix under its own name from the beginning, as a hole of its length that takes no
room on the disk. What is read is fetched into it; frames become holes again, the least recently used first, where they
take more room than `LIMIT`. So whatever reads local files reads these.
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
from pathlib import Path, PurePosixPath

from airgs_codec._stores import PARALLEL, Store
from airgs_codec.errors import SceneError
from airgs_codec.scene.cameras import colmap
from airgs_codec.scene.cameras.read import NAMES as CAMERA_NAMES
from airgs_codec.scene.files import Files, Read
from airgs_codec.scene.formats.gltf import external_buffers
from airgs_codec.scene.formats.ply_elements import HEADER_END, MAX_HEADER
from airgs_codec.scene.formats.sog import META_NAME
from airgs_codec.scene.sequence_json import SETTINGS_NAME

LIMIT = 2 << 30  # bytes of frames on the disk, beside those that are held
_HEAD = 1 << 14  # bytes in which the header of a .ply is looked for first
_KEPT = 2  # mirrors of other processes' sequences that a process keeps
_AT_ONCE = {SETTINGS_NAME, META_NAME, *CAMERA_NAMES}  # small files, by which frames and cameras are found


class Mirror(Files):
    """The files below one address. Each process has a folder of its own, which goes with it or sooner.

    `folder` is that of the process that opened the sequence: paths in it name the files wherever it is unpickled.
    """

    def __init__(self, address: str, folder: Path | None = None, *, deep: bool = True, limit: int = LIMIT) -> None:
        """`deep`: with what is below further slashes. `folder`: in the process that opened it, where that is another.

        Raises ConfigError, TransportError.
        """
        self._store, self._deep, self._limit = Store.at(address), deep, limit
        temporary = tempfile.mkdtemp(prefix="airgs-")
        weakref.finalize(self, shutil.rmtree, temporary, ignore_errors=True)
        self._here = Path(temporary) / self._store.name.rpartition("/")[2]
        self.folder = folder or self._here
        self._lock = threading.RLock()
        self._frames: OrderedDict[str, int] = OrderedDict()  # lengths of what is whole of them, the last used last
        self._held: Counter[str] = Counter()
        self._fetched: set[str] = set()  # files beside the frames
        self._sizes = _as_files(self._store.sizes() if deep else self._store.own_sizes() | self._store.sizes("sparse"))
        for name, size in self._sizes.items():
            _make_hole(self._here / name, size)

    @staticmethod
    def at(address: str) -> tuple[Mirror, Path]:
        """The mirror of a prefix, or of that of an object, and the path of what the address names.

        Raises SceneError where nothing is there, ConfigError, TransportError.
        """
        mirror = place = None
        if (prefix := Mirror(address))._sizes:
            mirror, place = prefix, prefix.folder
        else:
            holder, _, name = address.rstrip("/").rpartition("/")
            if not holder.endswith("/") and name in (around := Mirror(holder, deep=False))._sizes:
                mirror, place = around, around.folder / name
        if mirror is None or place is None:
            raise SceneError(f"{address}: expected a prefix with frames below it, or a file, got nothing")
        with ThreadPoolExecutor(PARALLEL) as pool:
            list(pool.map(mirror.beside, [mirror.folder / name for name in mirror._sizes if _is_needed_at_once(name)]))
        return mirror, place

    def __reduce__(self) -> tuple[object, ...]:
        return _reopened, (self._store.name, self.folder, self._deep, self._limit)

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
        """See `Files.read_headers`: of a .ply only the first bytes are fetched, of a folder nothing more."""
        names = [self._name(path) for path in paths]
        with ThreadPoolExecutor(PARALLEL) as pool:
            list(pool.map(self._fetch_header, filter(_is_ply, names)))
        headers = []
        for start in range(0, len(paths), PARALLEL):
            some = [paths[i] for i in range(start, min(start + PARALLEL, len(paths)))]
            whole = [path for path in some if not (_is_ply(path.name) or (self._here / self._name(path)).is_dir())]
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
            words = words.replace(str(folder), self._store.name)
        return words

    def _fetch_frames(self, names: Iterable[str]) -> list[str]:
        """Have all objects here that frames are of; gives their names."""
        parts = [part for name in names for part in self._parts(name)]
        self._fetch(parts)
        buffers = [
            f"{name.rpartition('/')[0]}/{other}".lstrip("/")
            for name in parts
            if name.lower().endswith(".gltf")
            for other in external_buffers(self._here / name)
        ]
        self._fetch(buffers := [name for name in buffers if name in self._sizes])
        return parts + buffers

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
        file = self._here / name
        part = file.with_name(f".{file.name}.{threading.get_ident()}.part")  # others may be reading what is there
        try:
            size = self._store.download(name, part)
            if size is None:
                raise SceneError(f"{self._store.name}/{name}: expected the object that was listed, got nothing")
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)
        return size

    def _fetch_header(self, name: str) -> None:
        """Write the first bytes of a .ply into its hole, as far as its header goes."""
        size, length = self._sizes[name], _HEAD
        head = self._store.read_start(name, length) if size else b""
        while HEADER_END not in head and length < min(size, MAX_HEADER):
            length *= 4
            head = self._store.read_start(name, length)
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


def _is_ply(name: str) -> bool:
    return name.lower().endswith(".ply")


@functools.lru_cache(maxsize=_KEPT)
def _reopened(address: str, folder: Path, deep: bool, limit: int) -> Mirror:
    """The mirror of a sequence that was pickled in another process, the same for all copies of it in this one."""
    return Mirror(address, folder, deep=deep, limit=limit)


def _is_needed_at_once(name: str) -> bool:
    path = PurePosixPath(name)
    return path.name in _AT_ONCE or ("sparse" in path.parts and path.name in colmap.CAMERA_PARTS)


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
