"""A package below a prefix of an object store, S3, Google Cloud Storage or Azure.

Objects are put whole, but one by one: no two packages can be swapped. One that takes the place of another is therefore
uploaded below `NEW` first, airgs.json last; from then on it is whole, and is copied to its place inside the store.
While that goes on, readers find files of both, which the digests in the tables tell apart. A run that is cut off before
airgs.json is below `NEW` has changed nothing, and the next run removes what it left; one that is cut off later is
finished by the next run.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from airgs_codec._stores import PARALLEL, Store
from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.package.folder import Folder
from airgs_codec.package.paths import INIT_NAME, JSON_NAME, MEDIA_TYPES, MPD_NAME, ROOTS, belongs
from airgs_codec.package.tables import FileEntry, file_entry

NEW = ".new/"  # a package below it takes the place of the one that is there


class Bucket:
    """The files of a package below a prefix; `storage.Storage` says what each method does.

    Only one run may write at a time.
    """

    def __init__(self, store: Store) -> None:
        """`store`: the prefix, all of it for one package."""
        self.name = store.name
        self._store = store

    def open(self, relative: str) -> tuple[int, Callable[[], bytes]]:
        """Length of an object, and what reads it. Raises FormatError (missing_file), TransportError."""
        if (found := self._store.open(relative)) is None:
            raise FormatError("missing_file", relative, "expected a file, got nothing")
        return found

    def write(self, relative: str, data: bytes) -> FileEntry:
        """Put an object. Returns its entry for the tables. Raises TransportError."""
        self._store.put(relative, data, _headers(relative))
        return file_entry(data)

    def paths(self) -> list[str]:
        """All objects below the prefix. Raises TransportError."""
        return sorted(self._store.sizes())

    @contextmanager
    def staged(self) -> Iterator[Path]:
        """Gives a folder whose files are uploaded when the block ends without an error.

        What runs that were cut off left is put right first, and that objects can be put, copied and deleted is tried.

        Raises ConfigError for a prefix with other objects than those of a package, TransportError.
        """
        self._put_right()
        self._try()
        with tempfile.TemporaryDirectory(prefix="airgs-") as folder:
            yield Path(folder)
            self._publish(Path(folder))

    def _put_right(self) -> None:
        there = self.paths()
        foreign = [name for name in there if not belongs(name.removeprefix(NEW))]
        if foreign:
            raise ConfigError(f"{self.name}: expected a new prefix or an existing package, got {foreign[0]} there")
        if NEW + JSON_NAME in there:
            self._take_place()
        else:
            self._store.delete(name for name in there if name.startswith(NEW))

    def _try(self) -> None:
        one, other = NEW + MPD_NAME, NEW + INIT_NAME
        self.write(one, b"airgs")
        self._store.copy(one, other)
        self._store.delete([one, other])

    def _publish(self, folder: Path) -> None:
        names, before = Folder(folder).paths(), self.paths()
        place = NEW if JSON_NAME in before else ""
        try:
            _for_each(names, lambda name: self.write(place + name, (folder / name).read_bytes()))
        except BaseException:
            with contextlib.suppress(TransportError):
                self._store.delete(place + name for name in names)
            raise
        if place:
            self._take_place()
        else:
            self._store.delete(set(before) - set(names))

    def _take_place(self) -> None:
        """Copy the package below `NEW` to its place; what is left of the old one goes. May be repeated at any time."""
        there = self.paths()
        names = [name.removeprefix(NEW) for name in there if name.startswith(NEW)]
        try:
            _for_each(names, lambda name: self._store.copy(NEW + name, name))
        except TransportError as error:
            rest = f"the new package is whole below {NEW}, and the next run that writes here puts it in its place"
            raise TransportError(f"{error}; {rest}") from error
        self._store.delete(name for name in there if name not in names and not name.startswith(NEW))
        self._store.delete([NEW + JSON_NAME])  # first: without it, what is below `NEW` is no package
        self._store.delete(NEW + name for name in names if name != JSON_NAME)


def _for_each(names: Iterable[str], work: Callable[[str], object]) -> None:
    """Work on the files of a package: on many at a time, on manifest.mpd after them, on airgs.json last."""
    last = (MPD_NAME, JSON_NAME)
    with ThreadPoolExecutor(PARALLEL) as pool:
        list(pool.map(work, [name for name in names if name not in last]))
    for name in last:
        if name in names:
            work(name)


def _headers(relative: str) -> dict[str, str]:
    """What a store says of a file to those who fetch it over HTTP; docs/serving.md gives the reasons."""
    name = relative.rpartition("/")[2]
    headers = {"Content-Type": MEDIA_TYPES[name[name.index(".") :]]}
    return headers | {"Cache-Control": "no-cache"} if name in ROOTS else headers
