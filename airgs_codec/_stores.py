"""Object stores: their addresses, and requests to S3, Google Cloud Storage or Azure with errors in one line.

obstore makes the requests. Endpoint and credentials come from the environment, as it reads it.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from airgs_codec.errors import ConfigError, TransportError

if TYPE_CHECKING:
    from obstore import GetResult
    from obstore.store import ObjectStore

SCHEMES = ("s3", "gs", "az")
PARALLEL = 16  # requests at a time
_NO_BUCKET = re.compile("NoSuchBucket|ContainerNotFound")
_NO_CREDENTIALS = re.compile(r"169\.254\.\d+\.\d+|metadata\.google\.internal|Account must be specified")


def is_address(place: str | Path) -> bool:
    """Whether a place is an address rather than a folder. (A `Path` is none: it joins the slashes of an address.)"""
    return "://" in str(place)


class Store:
    """The objects below one prefix of an object store. Every method raises TransportError where it does not answer."""

    def __init__(self, name: str, objects: ObjectStore) -> None:
        """`name`: the prefix, for messages."""
        self.name = name
        self._objects = objects

    @staticmethod
    def at(address: str) -> Store:
        """The prefix at an address: s3://bucket/prefix, gs://bucket/prefix or az://container/prefix.

        Raises ConfigError for other addresses, ones that cannot be, and where the extra `cloud` is not installed.
        """
        scheme = address.partition("://")[0]
        if scheme not in SCHEMES:
            known = ", ".join(f"{scheme}://" for scheme in SCHEMES)
            raise ConfigError(f"{address}: expected a folder or an address of {known}, got {scheme}://")
        if importlib.util.find_spec("obstore") is None:
            raise ConfigError(f"{address}: object stores need obstore: pip install 'airgs-codec[cloud]'")
        from obstore.exceptions import BaseError
        from obstore.store import from_url

        name = address.rstrip("/")
        try:
            return Store(name, from_url(name))
        except (BaseError, ValueError) as error:
            raise ConfigError(f"{address}: {_words(error)}") from error

    def open(self, path: str) -> tuple[int, Callable[[], bytes]] | None:
        """Length of an object, and what reads it whole; None where there is none."""
        with self._told(path):
            found = self._get(path)
        if found is None:
            return None

        def read() -> bytes:
            with self._told(path):
                return bytes(found.bytes())

        return found.meta["size"], read

    def read_start(self, path: str, length: int) -> bytes:
        """The first bytes of an object that is not empty, all of it where it is shorter."""
        with self._told(path):
            return bytes(self._objects.get_range(path, start=0, length=length))

    def download(self, path: str, target: Path) -> int | None:
        """Write an object to a file, whose folder is made; gives its length, None where there is none."""
        with self._told(path):
            found = self._get(path)
            if found is None:
                return None
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as file:
                for part in found.stream():
                    file.write(part)
            return found.meta["size"]

    def sizes(self, below: str = "") -> dict[str, int]:
        """Length of every object below a path, at any depth."""
        with self._told():
            listed = self._objects.list(below or None)
            return {meta["path"]: meta["size"] for some in listed for meta in some if meta["path"]}

    def own_sizes(self) -> dict[str, int]:
        """Length of every object in the prefix itself, and not below another slash."""
        with self._told():
            found = self._objects.list_with_delimiter()["objects"]
            return {meta["path"]: meta["size"] for meta in found if meta["path"]}

    def put(self, path: str, data: bytes, headers: Mapping[str, str]) -> None:
        """Put an object; `headers` is what the store says of it over HTTP."""
        with self._told(path):
            self._objects.put(path, data, attributes=dict(headers))

    def copy(self, source: str, target: str) -> None:
        """Copy an object inside the store."""
        with self._told(target):
            self._objects.copy(source, target)

    def delete(self, paths: Iterable[str]) -> None:
        """Delete objects."""
        with self._told():
            if gone := sorted(paths):
                self._objects.delete(gone)

    def _get(self, path: str) -> GetResult | None:
        try:
            return self._objects.get(path)
        except FileNotFoundError as error:
            if _NO_BUCKET.search(str(error)):
                raise
            return None

    @contextmanager
    def _told(self, path: str = "") -> Iterator[None]:
        """Errors of the store as one line."""
        from obstore.exceptions import BaseError

        try:
            yield
        except (BaseError, OSError) as error:
            raise TransportError(f"{self.name}{'/' if path else ''}{path}: {_words(error)}") from error


def _words(error: Exception) -> str:
    """What went wrong, in one line: obstore's messages are pages, with the store's own answer inside."""
    text = str(error).partition("\n\nDebug source")[0]
    if _NO_CREDENTIALS.search(text):
        return "no credentials: expected them in the environment (docs/serving.md), this machine has none of its own"
    answer = re.search(r"<Message>([^<\n]+)", text)
    return answer[1] if answer else " ".join(text.split())
