"""A package in a folder of this machine: files replace each other, a finished folder takes its place."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from airgs_codec._files import write_bytes
from airgs_codec.errors import FormatError
from airgs_codec.package.paths import MPD_NAME
from airgs_codec.package.staging import staged
from airgs_codec.package.tables import FileEntry, file_entry


@dataclass(frozen=True, slots=True)
class Folder:
    """The files of a package in a folder of this machine; `storage.Storage` says what each method does."""

    path: Path

    @property
    def name(self) -> str:
        """The folder, for messages."""
        return str(self.path)

    def open(self, relative: str) -> tuple[int, Callable[[], bytes]]:
        """Length of a file, and what reads it. Raises FormatError: missing_file, unsafe_path (a link)."""
        path = self.path
        for part in Path(relative).parts:
            path = path / part
            if path.is_symlink():
                raise FormatError("unsafe_path", relative, "expected a plain file, got a link")
        if not path.is_file():
            raise FormatError("missing_file", relative, "expected a file, got nothing")
        return path.stat().st_size, path.read_bytes

    def write(self, relative: str, data: bytes) -> FileEntry:
        """Write a file, whole or not at all. Returns its entry for the tables."""
        path = self.path / relative
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, data)
        return file_entry(data)

    def paths(self) -> list[str]:
        """Everything below the folder but folders."""
        entries = (p for p in self.path.rglob("*") if p.is_symlink() or not p.is_dir())
        return sorted(p.relative_to(self.path).as_posix() for p in entries)

    def staged(self) -> AbstractContextManager[Path]:
        """Gives a folder beside this one that takes its place when the block ends without an error; see `staged`.

        Raises ConfigError when there is a file, or a folder that holds other files than a package.
        """
        return staged(self.path, lambda folder: (folder / MPD_NAME).is_file(), "package")
