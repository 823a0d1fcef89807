"""Opening a package wherever it lies, reading its files with checks, and writing them."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec.errors import FormatError
from airgs_codec.package.layout import JSON_NAME, MEDIA_TYPES, MPD_NAME, ROOTS, group_path, locate
from airgs_codec.package.manifest import Groups, Manifest, Rung, rungs_of
from airgs_codec.package.parse import MAX_TABLE_BYTES, expect, parse_group, parse_page, parse_root
from airgs_codec.package.tables import Entry, FileEntry, Group, Header, Root, Spans, digest, file_entry
from airgs_codec.places.place import BUCKETS, WEB, Storage, got_words, is_address, place_at, split_query
from airgs_codec.scene.frames import ZERO, Origin

if TYPE_CHECKING:  # decoding needs no cameras
    from airgs_codec.scene.camera import Camera

SHORT = 1 << 16  # bytes: a file of another length is read to say what it is
OPENED = "an open package or the path of one"  # what functions expect that take either
REPR_DIGEST = "Repr-Digest"  # of an answer over HTTP (RFC 9530): all that checks airgs.json, which no table lists
Read = Callable[[str, FileEntry], bytes]  # path and what is known of the file -> its bytes


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Package:
    files: Storage
    manifest: Manifest
    root_bytes: int  # of airgs.json
    mpd_bytes: int = 0  # of manifest.mpd

    @property
    def manifest_bytes(self) -> int:
        return self.root_bytes + self.mpd_bytes + self.manifest.bytes_of(self.manifest.table_files())

    @property
    def origin(self) -> Origin:
        """Return what to add to positions of Gaussians and cameras for those of the scene that was encoded."""
        x, y, z = self.manifest.origin or ZERO
        return x, y, z

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Return what viewers see from each place of the viewing region; they begin at the first."""
        from airgs_codec.package.region import first_views

        return first_views(self.manifest.region, self.manifest.world)

    @property
    def rungs(self) -> tuple[Rung, ...]:
        return rungs_of(self.manifest, self.manifest_bytes)

    def __repr__(self) -> str:
        m = self.manifest
        rungs = f"{len(m.qualities)} keyframe qualities of {len(m.levels)} levels"
        return f"Package({self.files.name}: {m.frames} frames at {float(m.fps):g} a second, {rungs})"

    def read(self, relative: str) -> bytes:
        """Read a file that the tables list, whole and unaltered.

        Raises FormatError: missing_entry, missing_file, unsafe_path (a link), size_mismatch, hash_mismatch, and what
        reading the table of its group raises.
        """
        return read_file(self.files, relative, self.manifest.entry(relative))


def read_file(files: Storage, relative: str, entry: FileEntry) -> bytes:
    size, read = find_file(files, relative)
    if size > max(entry.bytes, SHORT):
        raise FormatError("size_mismatch", relative, f"expected {entry.bytes} bytes, got {size}")
    data = read()
    check_file(relative, data, entry)
    return data


def write_file(files: Storage, relative: str, data: bytes) -> FileEntry:
    """Write a file of a package, whole or not at all, and return its entry for the tables. Raises OSError."""
    name = relative.rpartition("/")[2]
    headers = {"Content-Type": MEDIA_TYPES[name[name.index(".") :]]}  # what a bucket says over HTTP: docs/serving.md
    if name in ROOTS:
        headers["Cache-Control"] = "no-cache"
    files.write(relative, data, headers)
    return file_entry(data)


def check_file(relative: str, data: bytes, entry: FileEntry) -> None:
    """Raise FormatError (size_mismatch, hash_mismatch) unless a file is what its entry says."""
    if len(data) != entry.bytes:
        unpacked = relative.endswith(".gz") and data.startswith(b"{")
        got = "JSON that was unpacked on the way" if unpacked else f"{len(data)}"
        raise FormatError("size_mismatch", relative, f"expected {entry.bytes} bytes, got {got_words(data, got)}")
    if digest(data) != entry.sha256:
        raise FormatError("hash_mismatch", relative, "the SHA-256 differs from the one in the tables")


def repr_digest(data: bytes) -> str:
    return f"sha-256=:{base64.b64encode(hashlib.sha256(data).digest()).decode()}:"


def check_repr_digest(where: str, data: bytes, header: str) -> None:
    """Raise FormatError(hash_mismatch) for bytes that are not those of the header; one without SHA-256 says nothing."""
    if re.search(r"\bsha-256=:[A-Za-z0-9+/]+=*:", header) and repr_digest(data) not in header:
        raise FormatError("hash_mismatch", where, "the SHA-256 differs from the one in the headers of the answer")


def open_manifest(root: Root, read: Read) -> Manifest:
    """Return the tables of a package with this root; `read` gets pages and tables of groups when they are needed."""
    groups = Groups(root.index, partial(_read_page, read), partial(_read_group, read, root))
    return Manifest(**header_of(root), groups=groups)


def _read_page(read: Read, path: str, entry: Entry) -> Spans:
    return parse_page(_read_table(read, path, entry.file), entry, path)


def _read_group(read: Read, root: Root, number: int, entry: Entry) -> Group:
    return parse_group(_read_table(read, group_path(number + 1), entry.file), root, entry, number)


def _read_table(read: Read, path: str, file: FileEntry) -> bytes:
    if file.bytes > MAX_TABLE_BYTES:
        raise FormatError("too_large", path, f"expected at most {MAX_TABLE_BYTES} bytes, got {file.bytes}")
    return read(path, file)


def header_of(one: Header) -> dict[str, Any]:
    return {field.name: getattr(one, field.name) for field in fields(Header)}


def root_of(m: Manifest) -> Root:
    return Root(**header_of(m), index=m.groups.columns)


def open_package(path: str | Path) -> Package:
    """Open the package at `path`, a folder or an address: read and check airgs.json; other files are read when needed.

    An address may also be that of its airgs.json or manifest.mpd, and have a query, which goes with every file.

    Raises FormatError: missing_file, too_large, or one of the reasons of `parse_root`; ConfigError for an address that
    cannot be, and TransportError where a store does not answer.
    """
    return open_files(place_at(folder_of(path) if isinstance(path, str) and is_address(path) else path, BUCKETS + WEB))


def folder_of(address: str) -> str:
    """Return the folder of a package from its address, or that of one of its roots, with the query."""
    before, query = split_query(address)
    folder, _, last = before.rpartition("/")
    return (folder if last in ROOTS else before) + query


def open_files(files: Storage) -> Package:
    """Open the package of these files, wherever they are; raises as `open_package` does."""
    mpd_bytes, _ = _open_root(files, MPD_NAME)
    size, read = _open_root(files, JSON_NAME)
    where, words = f"{files.name}/{JSON_NAME}", f"expected at most {MAX_TABLE_BYTES} bytes"
    expect(size <= MAX_TABLE_BYTES, where, words, "too_large")
    data = read()
    return Package(files, open_manifest(parse_root(data), partial(read_file, files)), len(data), mpd_bytes)


def find_file(files: Storage, relative: str) -> tuple[int, Callable[[], bytes]]:
    """Return the length of a file of a package, and what reads it. Raises FormatError: missing_file, unsafe_path."""
    if (found := files.open(relative)) is None:
        raise FormatError("missing_file", relative, "expected a file, got nothing")
    return found


def _open_root(files: Storage, relative: str) -> tuple[int, Callable[[], bytes]]:
    try:
        return find_file(files, relative)
    except FormatError:
        expected = "expected a package with manifest.mpd and airgs.json, as airgs-encode writes it"
        raise FormatError("missing_file", f"{files.name}/{relative}", expected) from None


def find_faults(package: Package) -> dict[str, FormatError]:
    """Return the files that cannot be used, each with the error of `Package.read`; DASH's own are not read."""
    faults, m = dict[str, FormatError](), package.manifest
    for number in m.groups.places.sweep():
        if isinstance(number, FormatError):
            faults[number.where] = number
            continue
        try:
            m.base_of(number)
            paths = m.group_files(number)
        except FormatError as error:
            faults[error.where if locate(error.where)[0] == "page" else group_path(number + 1)] = error
            continue
        for path in paths:
            try:
                package.read(path)
            except FormatError as error:
                faults[path] = error
    return faults
