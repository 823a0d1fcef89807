"""Where a package lives: a folder of this machine, or a prefix of an object store. Nothing else knows which."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from airgs_codec.errors import ConfigError
from airgs_codec.package.folder import Folder
from airgs_codec.package.tables import FileEntry

SCHEMES = ("s3", "gs", "az")


class Storage(Protocol):
    """The files of one package, by their paths in it."""

    @property
    def name(self) -> str:
        """The package, for messages."""

    def open(self, relative: str) -> tuple[int, Callable[[], bytes]]:
        """Length of a file, and what reads it whole.

        Raises FormatError (missing_file, unsafe_path), TransportError where a store does not answer.
        """

    def write(self, relative: str, data: bytes) -> FileEntry:
        """Write a file, whole or not at all, and give its entry for the tables. Raises OSError (TransportError)."""

    def paths(self) -> list[str]:
        """All that is there, sorted, whether it belongs to the package or not."""

    def staged(self) -> AbstractContextManager[Path]:
        """Gives an empty folder of this machine; what the block leaves in it is the package when the block ends.

        Nothing changes when the block ends with an error. Raises ConfigError where there is something else than a
        package, OSError (TransportError).
        """


def open_storage(place: str | Path) -> Storage:
    """The storage at a folder or an address: s3://bucket/prefix, gs://bucket/prefix or az://container/prefix.

    Raises ConfigError for other addresses, ones that cannot be, and where the extra `cloud` is not installed.
    """
    if not is_address(place):
        return Folder(Path(place))
    scheme = str(place).partition("://")[0]
    if scheme not in SCHEMES:
        known = ", ".join(f"{scheme}://" for scheme in SCHEMES)
        raise ConfigError(f"{place}: expected a folder or an address of {known}, got {scheme}://")
    if importlib.util.find_spec("obstore") is None:
        raise ConfigError(f"{place}: object stores need obstore: pip install 'airgs-codec[cloud]'")
    from airgs_codec.package.bucket import Bucket

    return Bucket.at(str(place))


def is_address(place: str | Path) -> bool:
    """Whether a place is an address rather than a folder. (A `Path` is none: it joins the slashes of an address.)"""
    return "://" in str(place)
