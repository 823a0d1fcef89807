"""Publishing tables: those of the groups, then full pages of the index, then the MPD, and airgs.json last.

Each file is written whole or not at all, and nothing that airgs.json leads to is ever written twice; so a reader finds
a whole package whenever it looks, also while groups are added.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock, Streams, write_mpd
from airgs_codec.package.packing import build_index, extend_index, pack_group, pack_json
from airgs_codec.package.paths import JSON_NAME, MPD_NAME, group_path
from airgs_codec.package.storage import Storage
from airgs_codec.package.store import open_manifest, read_file, root_of
from airgs_codec.package.tables import FileEntry, Group


def write_group(files: Storage, number: int, group: Group) -> bytes:
    """Write the table of a group, counted from 1, whose files are there already; gives its bytes."""
    data = pack_group(group)
    files.write(group_path(number), data)
    return data


def write_tables(files: Storage, m: Manifest, clock: LiveClock | None = None) -> int:
    """Write all tables and manifest.mpd of a package whose other files are there; gives their length together.

    Raises ConfigError for a growing package without a clock.
    """
    tables = [write_group(files, number, group) for number, group in enumerate(m.groups, 1)]
    _, pages = build_index(m.groups, tables)
    entries = [files.write(path, pack_json(page)) for path, page in pages.items()]
    return write_root(files, m, clock) + sum(map(len, tables)) + sum(entry.bytes for entry in entries)


def write_root(files: Storage, m: Manifest, clock: LiveClock | None = None, streams: Streams | None = None) -> int:
    """Write manifest.mpd and airgs.json of a package whose tables are there; gives their length together.

    `streams` as in `write_mpd`.
    """
    mpd = files.write(MPD_NAME, write_mpd(m, clock, streams))
    return mpd.bytes + files.write(JSON_NAME, pack_json(root_of(m))).bytes


class GrowingPackage:
    """A package to which groups are added, until it is closed.

    Only the newest table is in memory, and what the MPD says of the others: they are read again where they are wanted.
    """

    def __init__(self, files: Storage, m: Manifest, available: datetime) -> None:
        """`m`: the tables of the package so far, which are written; `available`: when its first frame was there."""
        self.files = files
        self._unwritten: dict[str, bytes] = {}  # tables that `expect` tells of
        self._streams = Streams.of(m)
        self._available = available
        self.manifest = open_manifest(root_of(m), self._read)
        self.manifest.groups.keep(len(m.groups) - 1, m.groups[-1])

    def expect(self, group: Group) -> Manifest:
        """The tables with one more group, whose files are written, but not its table; until the next call or `add`."""
        table, number = pack_group(group), len(self.manifest.groups)
        index, pages = extend_index(self.manifest.groups.columns, number, group, table)
        self._unwritten = {group_path(number + 1): table} | {path: pack_json(page) for path, page in pages.items()}
        root = replace(root_of(self.manifest), frames=group.stop, index=index)
        found = open_manifest(root, self._read)
        found.groups.keep(number, group)
        return found

    def add(self, group: Group) -> None:
        """Publish one more group, whose files are written."""
        self.manifest = self.expect(group)
        for path, data in self._unwritten.items():
            self.files.write(path, data)
        self._unwritten = {}
        self._streams.add(group)
        self._write_root()

    def close(self) -> None:
        """No group will follow."""
        self.manifest = replace(self.manifest, live=False)
        self._write_root()

    def _read(self, path: str, entry: FileEntry) -> bytes:
        """A page or a table of a group."""
        return self._unwritten[path] if path in self._unwritten else read_file(self.files, path, entry)

    def _write_root(self) -> None:
        write_root(self.files, self.manifest, LiveClock(self._available, datetime.now(UTC)), self._streams)
