"""Reading binary files piece by piece, little-endian."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import Any


class Cursor:
    """A place in bytes. Every method raises ValueError where the bytes end before what is asked for."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self.data = data
        self.at = 0

    @classmethod
    def open(cls, path: Path) -> Cursor:
        """At the start of a file, which is mapped, not read. Raises OSError."""
        if path.stat().st_size == 0:  # cannot be mapped
            return cls(b"")
        with path.open("rb") as file:
            return cls(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))

    def skip(self, count: int) -> int:
        """Pass over `count` bytes; gives the place before them."""
        start, self.at = self.at, self.at + count
        if self.at > len(self.data):
            raise ValueError(f"it ends after {len(self.data)} bytes")
        return start

    def take(self, form: str) -> tuple[Any, ...]:
        """Values in the form that `struct` knows."""
        return struct.unpack_from(f"<{form}", self.data, self.skip(struct.calcsize(f"<{form}")))

    def piece(self, count: int) -> bytes:
        """The next `count` bytes."""
        start = self.skip(count)
        return self.data[start : self.at]

    def text(self) -> str:
        """UTF-8 up to a zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise ValueError("a name has no end")
        return self.piece(end + 1 - self.at)[:-1].decode()
