"""Where results of jobs are: a folder that all workers share, or a prefix of an object store.

An entry is whole or absent: the SHA-256 of the rest, then bytes; one that does not fit its digest is removed when it is
read. Results are pickles (`job`): only those who may run code here may write to a store.
"""

from __future__ import annotations

import hashlib
import os
import secrets
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol

from airgs_codec import _stores as objects
from airgs_codec.errors import ConfigError

DIGEST_BYTES = 32


class Store(Protocol):
    """Entries by name, which workers in other processes and on other machines see as well; it can be pickled."""

    @property
    def name(self) -> str:
        """The place, for messages."""

    def has(self, entry: str) -> bool:
        """Whether there is such an entry. Raises OSError (TransportError)."""

    def read(self, entry: str) -> bytes | None:
        """The bytes of an entry; None where there is none that is whole. Raises OSError (TransportError)."""

    def write(self, entry: str, data: bytes) -> None:
        """Put an entry, whole or not at all; one of the same name is replaced. Raises OSError (TransportError)."""


@dataclass(frozen=True, slots=True)
class WorkFolder:
    """Entries as files of a folder, which is made when it is needed."""

    path: Path
    lasting: bool = True  # entries are on the disk (fsync) before they have their names

    @property
    def name(self) -> str:
        """The folder."""
        return str(self.path)

    def has(self, entry: str) -> bool:
        """Whether there is such a file."""
        return self._file(entry).is_file()

    def read(self, entry: str) -> bytes | None:
        """The bytes of an entry; None where there is none that is whole. Raises OSError."""
        try:
            data = unseal(self._file(entry).read_bytes())
        except FileNotFoundError:
            return None
        if data is None:
            self._file(entry).unlink(missing_ok=True)
        return data

    def write(self, entry: str, data: bytes) -> None:
        """Put an entry in the place of any other. Raises OSError."""
        file = self._file(entry)
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_name(f".{entry}.{secrets.token_hex(8)}.part")  # two may write one entry
        try:
            with temporary.open("xb") as out:
                out.write(seal(data))
                out.flush()
                if self.lasting:
                    os.fsync(out.fileno())
            os.replace(temporary, file)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise

    def _file(self, entry: str) -> Path:
        return self.path / _object(entry)


@dataclass(frozen=True, slots=True)
class WorkPrefix:
    """Entries as objects below a prefix of an object store; every process opens it anew by its address."""

    name: str

    def has(self, entry: str) -> bool:
        """Whether there is such an object. Raises TransportError."""
        return _open(self.name).open(_object(entry)) is not None

    def read(self, entry: str) -> bytes | None:
        """The bytes of an entry; None where there is none that is whole. Raises TransportError."""
        found = _open(self.name).open(_object(entry))
        data = None if found is None else unseal(found[1]())
        if found is not None and data is None:
            _open(self.name).delete([_object(entry)])
        return data

    def write(self, entry: str, data: bytes) -> None:
        """Put an entry in the place of any other. Raises TransportError."""
        _open(self.name).put(_object(entry), seal(data), {})


@cache
def _open(address: str) -> objects.Store:
    return objects.Store.at(address)


def _object(entry: str) -> str:
    return f"{entry[:2]}/{entry}"


def seal(data: bytes) -> bytes:
    """An entry as it is stored."""
    return hashlib.sha256(data).digest() + data


def unseal(sealed: bytes) -> bytes | None:
    """The bytes of a stored entry; None where it is damaged."""
    data = sealed[DIGEST_BYTES:]
    return data if hashlib.sha256(data).digest() == sealed[:DIGEST_BYTES] else None


def open_store(place: str) -> Store:
    """The store at a folder or an address (s3://, gs://, az://).

    Raises ConfigError where there is a file, for an address that cannot be, and what `objects.Store.at` raises.
    """
    if objects.is_address(place):
        _open(place)
        return WorkPrefix(place)
    path = Path(place)
    if path.exists() and not path.is_dir():
        raise ConfigError(f"{place}: expected a folder for work, got a file")
    return WorkFolder(path)
