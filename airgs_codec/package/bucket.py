"""A package below a prefix of an object store, S3, Google Cloud Storage or Azure.

Objects are put whole, but one by one: no two packages can be swapped. One that takes the place of another is therefore
uploaded below `NEW` first, airgs.json last; from then on it is whole, and is copied to its place inside the store.
While that goes on, readers find files of both, which the digests in the tables tell apart. A run that is cut off before
airgs.json is below `NEW` has changed nothing, and the next run removes what it left; one that is cut off later is
finished by the next run.
"""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from obstore.exceptions import BaseError
from obstore.store import ObjectStore, from_url

from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.package.folder import Folder
from airgs_codec.package.paths import INIT_NAME, JSON_NAME, MEDIA_TYPES, MPD_NAME, ROOTS, belongs
from airgs_codec.package.tables import FileEntry, file_entry

NEW = ".new/"  # a package below it takes the place of the one that is there
PARALLEL = 16  # requests at a time
_NO_BUCKET = re.compile("NoSuchBucket|ContainerNotFound")
_NO_CREDENTIALS = re.compile(r"169\.254\.\d+\.\d+|metadata\.google\.internal|Account must be specified")


class Bucket:
    """The files of a package below a prefix; `storage.Storage` says what each method does.

    Endpoint and credentials come from the environment, as obstore reads it. Only one run may write at a time.
    """

    def __init__(self, name: str, store: ObjectStore) -> None:
        """`name`: for messages; `store`: the prefix, all of it for one package."""
        self.name = name
        self._store = store

    @staticmethod
    def at(address: str) -> Bucket:
        """The prefix at an address. Raises ConfigError for one that cannot be."""
        name = address.rstrip("/")
        try:
            return Bucket(name, from_url(name))
        except (BaseError, ValueError) as error:
            raise ConfigError(f"{address}: {_words(error)}") from error

    def open(self, relative: str) -> tuple[int, Callable[[], bytes]]:
        """Length of an object, and what reads it. Raises FormatError (missing_file), TransportError."""
        with self._told(relative):
            try:
                found = self._store.get(relative)
            except FileNotFoundError as error:
                if _NO_BUCKET.search(str(error)):
                    raise
                raise FormatError("missing_file", relative, "expected a file, got nothing") from None

        def read() -> bytes:
            with self._told(relative):
                return bytes(found.bytes())

        return found.meta["size"], read

    def write(self, relative: str, data: bytes) -> FileEntry:
        """Put an object. Returns its entry for the tables. Raises TransportError."""
        with self._told(relative):
            self._store.put(relative, data, attributes=_headers(relative))
        return file_entry(data)

    def paths(self) -> list[str]:
        """All objects below the prefix. Raises TransportError."""
        with self._told():
            return sorted(meta["path"] for some in self._store.list() for meta in some if meta["path"])

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
            self._delete(name for name in there if name.startswith(NEW))

    def _try(self) -> None:
        one, other = NEW + MPD_NAME, NEW + INIT_NAME
        self.write(one, b"airgs")
        self._copy(one, other)
        self._delete([one, other])

    def _publish(self, folder: Path) -> None:
        names, before = Folder(folder).paths(), self.paths()
        place = NEW if JSON_NAME in before else ""
        try:
            _for_each(names, lambda name: self.write(place + name, (folder / name).read_bytes()))
        except BaseException:
            with contextlib.suppress(TransportError):
                self._delete(place + name for name in names)
            raise
        if place:
            self._take_place()
        else:
            self._delete(set(before) - set(names))

    def _take_place(self) -> None:
        """Copy the package below `NEW` to its place; what is left of the old one goes. May be repeated at any time."""
        there = self.paths()
        names = [name.removeprefix(NEW) for name in there if name.startswith(NEW)]
        try:
            _for_each(names, lambda name: self._copy(NEW + name, name))
        except TransportError as error:
            rest = f"the new package is whole below {NEW}, and the next run that writes here puts it in its place"
            raise TransportError(f"{error}; {rest}") from error
        self._delete(name for name in there if name not in names and not name.startswith(NEW))
        self._delete([NEW + JSON_NAME])  # first: without it, what is below `NEW` is no package
        self._delete(NEW + name for name in names if name != JSON_NAME)

    def _copy(self, source: str, target: str) -> None:
        with self._told(target):
            self._store.copy(source, target)

    def _delete(self, names: Iterable[str]) -> None:
        with self._told():
            if gone := sorted(names):
                self._store.delete(gone)

    @contextmanager
    def _told(self, relative: str = "") -> Iterator[None]:
        """Errors of the store as one line."""
        try:
            yield
        except (BaseError, OSError) as error:
            raise TransportError(f"{self.name}{'/' if relative else ''}{relative}: {_words(error)}") from error


def _for_each(names: Iterable[str], work: Callable[[str], object]) -> None:
    """Work on the files of a package: on many at a time, on manifest.mpd after them, on airgs.json last."""
    last = (MPD_NAME, JSON_NAME)
    with ThreadPoolExecutor(PARALLEL) as pool:
        list(pool.map(work, [name for name in names if name not in last]))
    for name in last:
        if name in names:
            work(name)


def _headers(relative: str) -> dict[str, str]:
    """What a store says of a file to those who fetch it over HTTP; docs/serve.md gives the reasons."""
    name = relative.rpartition("/")[2]
    headers = {"Content-Type": MEDIA_TYPES[name[name.index(".") :]]}
    return headers | {"Cache-Control": "no-cache"} if name in ROOTS else headers


def _words(error: Exception) -> str:
    """What went wrong, in one line: obstore's messages are pages, with the store's own answer inside."""
    text = str(error).partition("\n\nDebug source")[0]
    if _NO_CREDENTIALS.search(text):
        return "no credentials: expected them in the environment (docs/stores.md), and this machine has none of its own"
    answer = re.search(r"<Message>([^<\n]+)", text)
    return answer[1] if answer else " ".join(text.split())
