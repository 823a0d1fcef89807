"""Where a package lives: a folder of this machine, or a prefix of an object store. Nothing else knows which."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from airgs_codec._stores import Store, is_address
from airgs_codec.package.bucket import Bucket
from airgs_codec.package.folder import Folder
from airgs_codec.package.tables import FileEntry


class Files(Protocol):
    """The files of one package, by their paths in it, to be read."""

    @property
    def name(self) -> str:
        """The package, for messages."""

    def open(self, relative: str) -> tuple[int, Callable[[], bytes]]:
        """Length of a file, and what reads it whole.

        Raises FormatError (missing_file, unsafe_path), TransportError where a store does not answer.
        """

    def paths(self) -> list[str]:
        """All that is there, sorted, whether it belongs to the package or not."""


class Storage(Files, Protocol):
    """The files of one package in a place where they can be written as well."""

    def write(self, relative: str, data: bytes) -> FileEntry:
        """Write a file, whole or not at all, and give its entry for the tables. Raises OSError (TransportError)."""

    def staged(self) -> AbstractContextManager[Path]:
        """Gives an empty folder of this machine; what the block leaves in it is the package when the block ends.

        Nothing changes when the block ends with an error. Raises ConfigError where there is something else than a
        package, OSError (TransportError).
        """


def open_storage(place: str | Path) -> Storage:
    """The storage at a folder or an address. Raises ConfigError as `Store.at` does."""
    return Bucket(Store.at(str(place))) if is_address(place) else Folder(Path(place))
