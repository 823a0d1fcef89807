"""Packages on disk: opening one, and reading its files with checks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from airgs_codec.errors import FormatError
from airgs_codec.package.parse import parse_manifest
from airgs_codec.package.tables import JSON_NAME, MPD_NAME, Manifest, digest

MAX_JSON_BYTES = 1 << 28


@dataclass(frozen=True, slots=True, eq=False)
class Package:
    """An open package: its tables, and its files by their relative paths."""

    path: Path
    manifest: Manifest
    manifest_bytes: int  # airgs.json and manifest.mpd together

    def read(self, relative: str) -> bytes:
        """A listed file, whole and unaltered.

        Raises FormatError: missing_entry, missing_file, unsafe_path (a link), size_mismatch, hash_mismatch.
        """
        entry = self.manifest.files.get(relative)
        if entry is None:
            raise FormatError("missing_entry", relative, f"no entry in {JSON_NAME}")
        data = self._load(relative, entry.bytes)
        if digest(data) != entry.sha256:
            raise FormatError("hash_mismatch", relative, "the SHA-256 differs from the one in airgs.json")
        return data

    def _load(self, relative: str, expected: int) -> bytes:
        path = self.path
        for part in Path(relative).parts:
            path = path / part
            if path.is_symlink():
                raise FormatError("unsafe_path", relative, "expected a plain file, got a link")
        if not path.is_file():
            raise FormatError("missing_file", relative, "expected a file, got nothing")
        size = path.stat().st_size
        if size != expected:
            raise FormatError("size_mismatch", relative, f"expected {expected} bytes, got {size}")
        return path.read_bytes()


def open_package(path: str | Path) -> Package:
    """Open the package in the folder `path`: read and check its tables; other files are read when they are needed.

    Raises FormatError: missing_file, too_large, or one of the reasons of `parse_manifest`.
    """
    path = Path(path)
    mpd, tables = path / MPD_NAME, path / JSON_NAME
    for file in (mpd, tables):
        if file.is_symlink() or not file.is_file():
            raise FormatError("missing_file", str(file), "expected a package with manifest.mpd and airgs.json")
    if tables.stat().st_size > MAX_JSON_BYTES:
        raise FormatError("too_large", str(tables), f"expected at most {MAX_JSON_BYTES} bytes")
    data = tables.read_bytes()
    return Package(path, parse_manifest(data), len(data) + mpd.stat().st_size)


def find_faults(package: Package) -> dict[str, FormatError]:
    """Listed files that cannot be used, each with the reason why `Package.read` refuses it."""
    faults: dict[str, FormatError] = {}
    for path in package.manifest.files:
        try:
            package.read(path)
        except FormatError as error:
            faults[path] = error
    return faults
