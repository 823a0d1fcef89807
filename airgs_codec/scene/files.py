"""Files that others wrote, read with care: whatever is wrong with one is a SceneError of one line."""

from __future__ import annotations

import json
import mmap
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.places.whole import BROKEN, expect_plain

BOM = b"\xef\xbb\xbf"  # that Windows puts before UTF-8
SPLATV_MAGIC = b"\x4b\x67\0\0"


@contextmanager
def expecting(path: Path, what: str) -> Iterator[None]:
    """Turn what goes wrong while `path` is read as `what` into a SceneError of one line."""
    try:
        expect_plain(path)
        with np.errstate(all="ignore"):  # what is not finite in the end is refused
            yield
    except SceneError:
        raise
    except OSError as error:
        raise SceneError(f"{path}: expected {what}: {error.strerror or error}") from error
    except (SyntaxError, TokenError) as error:  # of the header of an .npy file, which numpy parses as Python
        raise SceneError(f"{path}: expected {what}: its header is broken") from error
    except (*BROKEN, struct.error, zlib.error, zipfile.BadZipFile) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise SceneError(f"{path}: expected {what}: {' '.join(reason.split())[:200]}") from error


def require(fits: object, where: Path | str, words: str) -> None:
    """Raise SceneError, which begins with the place, unless `fits` is true."""
    if not fits:
        raise SceneError(f"{where}: {words}")


def read_json(path: Path) -> Any:
    """Return what a JSON file holds. Raises SceneError."""
    with expecting(path, "JSON"):
        return json.loads(path.read_text(encoding="utf-8-sig"))


def read_object(path: Path) -> dict[str, Any]:
    data = read_json(path)
    require(isinstance(data, dict), path, f"expected a JSON object, got {type(data).__name__}")
    return data


class Cursor:
    """Bytes that are read piece by piece, little-endian; ValueError where they end before what is asked for."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self.data = data
        self.at = 0

    @classmethod
    def open(cls, path: Path) -> Cursor:
        """Map a file. Raises OSError."""
        if path.stat().st_size == 0:  # cannot be mapped
            return cls(b"")
        with path.open("rb") as file:
            return cls(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))

    def skip(self, count: int) -> int:
        start, self.at = self.at, self.at + count
        if self.at > len(self.data):
            raise ValueError(f"it ends after {len(self.data)} bytes")
        return start

    def take(self, form: str) -> tuple[Any, ...]:
        return struct.unpack_from(f"<{form}", self.data, self.skip(struct.calcsize(f"<{form}")))

    def piece(self, count: int) -> bytes:
        start = self.skip(count)
        return self.data[start : self.at]

    def text(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise ValueError("a name has no end")
        return self.piece(end + 1 - self.at)[:-1].decode()


def open_splatv(path: Path) -> tuple[Cursor, list[dict[str, Any]]]:
    """Return the bytes of a .splatv, from its rows on, and the chunks of its header. Raises what `expecting` knows."""
    cursor = Cursor.open(path)
    magic, length = cursor.take("4sI")
    if magic != SPLATV_MAGIC:
        raise ValueError(f"got {magic!r}")
    return cursor, json.loads(cursor.piece(length))
