"""Files of a package that are in memory: those of groups that were just encoded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from airgs_codec.errors import FormatError


@dataclass(frozen=True, slots=True, eq=False)
class MemoryFiles:
    """The bytes of files by their paths; `storage.Files` says what each method does."""

    name: str
    files: Mapping[str, bytes]

    def open(self, relative: str) -> tuple[int, Callable[[], bytes]]:
        """Length of a file, and what gives it. Raises FormatError (missing_file)."""
        if relative not in self.files:
            raise FormatError("missing_file", relative, "expected a file, got nothing")
        return len(self.files[relative]), lambda: self.files[relative]

    def paths(self) -> list[str]:
        """All paths, sorted."""
        return sorted(self.files)
