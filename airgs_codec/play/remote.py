"""The tables of a package that come over a connection: nothing counts before it is checked from the root down."""

from __future__ import annotations

import dataclasses

from airgs_codec.errors import FormatError
from airgs_codec.package.index import count_groups
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import check_digest, open_manifest
from airgs_codec.package.packing import MAX_ROOT_BYTES
from airgs_codec.package.parse import parse_root
from airgs_codec.package.paths import JSON_NAME, group_path, locate
from airgs_codec.package.tables import PAGE, FileEntry, Header, Root
from airgs_codec.play.catalogue import Catalogue

GROWS = ("frames", "live")  # what of the header changes while a package grows


class RemoteTables:
    """A catalogue that grows with the tables that are accepted."""

    def __init__(self) -> None:
        self.catalogue: Catalogue | None = None  # None: airgs.json has not come yet
        self._root: Root | None = None
        self._files: dict[str, bytes] = {}  # pages and tables of groups
        self._keepers: dict[int, set[int]] = {}  # groups whose tables came, by the group whose rows they keep

    def limit(self, path: str) -> int:
        """The most bytes that a file may have. Raises FormatError for one that no table lists."""
        if path == JSON_NAME or self.catalogue is None:
            return MAX_ROOT_BYTES
        return self.catalogue.manifest.entry(path).bytes

    def accept(self, path: str, data: bytes) -> None:
        """Take in a file that came. Raises FormatError for one that is not what the tables say."""
        if path == JSON_NAME:
            self._accept_root(data)
            return
        if self.catalogue is None:
            raise FormatError("missing_entry", path, f"{JSON_NAME} has not come yet")
        entry = self.catalogue.manifest.entry(path)
        if len(data) != entry.bytes:
            raise FormatError("size_mismatch", path, f"expected {entry.bytes} bytes, got {len(data)}")
        check_digest(path, data, entry)
        self._read_table(self.catalogue, path, data)

    def _accept_root(self, data: bytes) -> None:
        root = parse_root(data)
        if self._root is not None:
            _check_growth(self._root, root)
        manifest = open_manifest(root, self._find)
        if self.catalogue is None:
            self.catalogue = Catalogue(manifest, root_bytes=len(data), live=root.live)
        else:
            self.catalogue.grow(manifest, len(data))
        self._root = root

    def _find(self, path: str, entry: FileEntry) -> bytes:
        """A table that came, if it is still what the root leads to."""
        if path not in self._files:
            raise FormatError("missing_file", path, "it has not been fetched")
        check_digest(path, self._files[path], entry)
        return self._files[path]

    def _read_table(self, c: Catalogue, path: str, data: bytes) -> None:
        what, numbers = locate(path)
        if what not in ("group", "page"):
            return
        self._files[path] = data
        try:
            if what == "group":
                self._check_kept(c.manifest, numbers[0] - 1)
            else:
                c.manifest.groups.places.check_page(numbers[0], numbers[1] - 1)
        except FormatError:
            del self._files[path]
            raise

    def _check_kept(self, m: Manifest, group: int) -> None:
        """Read a table, and check it with those that came before: one may keep rows of the other. FormatError."""
        keeps = m.groups[group].keeps
        for number in self._keepers.get(group, ()):
            m.base_of(number)
        if keeps is not None:
            if group_path(keeps) in self._files:
                m.base_of(group)
            self._keepers.setdefault(keeps - 1, set()).add(group)


def _check_growth(before: Root, after: Root) -> None:
    """Raise FormatError(bad_value) unless a root can follow another while groups are added."""
    same = all(
        getattr(before, field.name) == getattr(after, field.name)
        for field in dataclasses.fields(Header)
        if field.name not in GROWS
    )
    was, now = count_groups(before.index), count_groups(after.index)
    kept = now >= was
    for level, (old, new) in enumerate(zip(before.index, after.index, strict=False)):
        if was // PAGE ** (level + 1) == now // PAGE ** (level + 1):  # no page of the level above was filled since
            kept = kept and new.sha256.startswith(old.sha256)
    if not (same and kept and after.frames >= before.frames and before.live >= after.live):
        raise FormatError("bad_value", JSON_NAME, "expected the package of before with more groups, got another")
