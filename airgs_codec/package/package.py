"""Opening a package wherever it lies, reading its files with checks, and writing them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from airgs_codec.errors import FormatError
from airgs_codec.package.index import Entry
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.parse import MAX_ROOT_BYTES, parse_group, parse_page, parse_root
from airgs_codec.package.paths import JSON_NAME, MEDIA_TYPES, MPD_NAME, ROOTS, group_path, locate
from airgs_codec.package.tables import FileEntry, Group, Header, Root, Spans, digest, file_entry
from airgs_codec.places.place import BUCKETS, WEB, Place, place_at

Read = Callable[[str, FileEntry], bytes]  # path and what is known of the file -> its bytes


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Package:
    """An open package: its tables, and its files by their relative paths."""

    files: Place
    manifest: Manifest
    root_bytes: int  # of airgs.json
    mpd_bytes: int = 0  # of manifest.mpd

    @property
    def manifest_bytes(self) -> int:
        """All tables and manifest.mpd together."""
        return self.root_bytes + self.mpd_bytes + self.manifest.bytes_of(self.manifest.table_files())

    def read(self, relative: str) -> bytes:
        """A file that the tables list, whole and unaltered.

        Raises FormatError: missing_entry, missing_file, unsafe_path (a link), size_mismatch, hash_mismatch, and what
        is wrong with the table of the group that it belongs to.
        """
        return read_file(self.files, relative, self.manifest.entry(relative))


def read_file(files: Place, relative: str, entry: FileEntry) -> bytes:
    """A file of a package whose length and digest are known; `Package.read` says what is raised."""
    size, read = find_file(files, relative)
    if size != entry.bytes:
        raise FormatError("size_mismatch", relative, f"expected {entry.bytes} bytes, got {size}")
    data = read()
    check_digest(relative, data, entry)
    return data


def write_file(files: Place, relative: str, data: bytes) -> FileEntry:
    """Write a file of a package, whole or not at all, and return its entry for the tables. Raises OSError."""
    files.write(relative, data, _headers(relative))
    return file_entry(data)


def _headers(relative: str) -> dict[str, str]:
    """What a bucket says of a file to those who fetch it over HTTP; docs/serving.md gives the reasons."""
    name = relative.rpartition("/")[2]
    headers = {"Content-Type": MEDIA_TYPES[name[name.index(".") :]]}
    return headers | {"Cache-Control": "no-cache"} if name in ROOTS else headers


def check_digest(relative: str, data: bytes | bytearray, entry: FileEntry) -> None:
    """Raise FormatError(hash_mismatch) unless a file has the digest of its entry."""
    if digest(data) != entry.sha256:
        raise FormatError("hash_mismatch", relative, "the SHA-256 differs from the one in the tables")


def open_manifest(root: Root, read: Read) -> Manifest:
    """The tables of a package whose airgs.json is read; `read` gets pages and tables of groups when they are needed."""
    shared = {field.name: getattr(root, field.name) for field in fields(Header)}

    def page(path: str, entry: Entry) -> Spans:
        return parse_page(read(path, entry.file), entry, path)

    def group(number: int, entry: Entry) -> Group:
        return parse_group(read(group_path(number + 1), entry.file), root, entry, number)

    return Manifest(**shared, init=root.init, groups=Groups(root.index, page, group))


def root_of(m: Manifest) -> Root:
    """The airgs.json of a package."""
    shared = {field.name: getattr(m, field.name) for field in fields(Header)}
    return Root(**shared, init=m.init, index=m.groups.columns)


def manifest_of(root: Root, groups: Sequence[Group]) -> Manifest:
    """The tables of a package whose groups' tables are in memory; the index in `root` is made anew."""
    shared = {field.name: getattr(root, field.name) for field in fields(Header)}
    return Manifest(**shared, init=root.init, groups=Groups.of(groups))


def open_package(path: str | Path) -> Package:
    """Open the package at `path`, a folder or an address: read and check airgs.json; other files are read when needed.

    Raises FormatError: missing_file, too_large, or one of the reasons of `parse_root`; ConfigError for an address that
    cannot be, and TransportError where a store does not answer.
    """
    return open_files(place_at(path, BUCKETS + WEB))


def open_files(files: Place) -> Package:
    """Open the package of these files, wherever they are; raises as `open_package` does."""
    mpd_bytes, _ = _open_root(files, MPD_NAME)
    size, read = _open_root(files, JSON_NAME)
    if size > MAX_ROOT_BYTES:
        raise FormatError("too_large", f"{files.name}/{JSON_NAME}", f"expected at most {MAX_ROOT_BYTES} bytes")
    data = read()
    manifest = open_manifest(parse_root(data), lambda name, entry: read_file(files, name, entry))
    return Package(files, manifest, len(data), mpd_bytes)


def find_file(files: Place, relative: str) -> tuple[int, Callable[[], bytes]]:
    """Return the length of a file of a package, and what reads it. Raises FormatError: missing_file, unsafe_path."""
    if (found := files.open(relative)) is None:
        raise FormatError("missing_file", relative, "expected a file, got nothing")
    return found


def _open_root(files: Place, relative: str) -> tuple[int, Callable[[], bytes]]:
    try:
        return find_file(files, relative)
    except FormatError:
        expected = "expected a package with manifest.mpd and airgs.json"
        raise FormatError("missing_file", f"{files.name}/{relative}", expected) from None


def find_faults(package: Package) -> dict[str, FormatError]:
    """Files that cannot be used, each with the reason why `Package.read` refuses it; DASH's own are not read."""
    faults: dict[str, FormatError] = {}
    m = package.manifest
    for number in range(len(m.groups)):
        table = group_path(number + 1)
        try:
            m.groups.places.entry(number)
            m.base_of(number)
            paths = m.group_files(number)
        except FormatError as error:
            faults[error.where if locate(error.where)[0] == "page" else table] = error
            continue
        for path in paths:
            try:
                package.read(path)
            except FormatError as error:
                faults[path] = error
    return faults
