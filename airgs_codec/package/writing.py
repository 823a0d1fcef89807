"""Publishing tables: those of the groups, then full pages of the index, then the MPD, and airgs.json last.

Each file is written whole or not at all, and nothing that airgs.json leads to is ever written twice; so a reader finds
a whole package whenever it looks, also while groups are added.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.mpd import LiveClock, write_mpd
from airgs_codec.package.packing import build_index, extend_index, pack_group, pack_json
from airgs_codec.package.paths import JSON_NAME, MPD_NAME, group_path, page_path
from airgs_codec.package.storage import Storage
from airgs_codec.package.store import root_of
from airgs_codec.package.tables import Group, Spans


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
    for number, page in enumerate(pages, 1):
        files.write(page_path(number), pack_json(page))
    return write_root(files, m, clock) + sum(map(len, tables)) + sum(len(pack_json(page)) for page in pages)


def write_root(files: Storage, m: Manifest, clock: LiveClock | None = None) -> int:
    """Write manifest.mpd and airgs.json of a package whose tables are there; gives their length together."""
    mpd = files.write(MPD_NAME, write_mpd(m, clock))
    return mpd.bytes + files.write(JSON_NAME, pack_json(root_of(m))).bytes


class GrowingPackage:
    """A package to which groups are added, until it is closed; the tables of its groups are in memory."""

    def __init__(self, files: Storage, m: Manifest, available: datetime) -> None:
        """`m`: the tables of the package so far, which are written; `available`: when its first frame was there."""
        self.files = files
        self.manifest = m
        self._groups = list(m.groups)
        self._pages = build_index(self._groups, [pack_group(group) for group in self._groups])[1]
        self._available = available

    def expect(self, group: Group) -> Manifest:
        """The tables with one more group, whose files are written, but not its table."""
        return self._extended(group, pack_group(group))[0]

    def add(self, group: Group) -> None:
        """Publish one more group, whose files are written."""
        table = write_group(self.files, len(self._groups) + 1, group)
        self.manifest, page = self._extended(group, table)
        self._groups.append(group)
        if page:
            self._pages.append(page)
            self.files.write(page_path(len(self._pages)), pack_json(page))
        self._write_root()

    def close(self) -> None:
        """No group will follow."""
        self.manifest = replace(self.manifest, live=False)
        self._write_root()

    def _extended(self, group: Group, table: bytes) -> tuple[Manifest, Spans | None]:
        index, page = extend_index(self.manifest.groups.table, group, table)
        groups, pages = [*self._groups, group], [*self._pages, *([page] if page else [])]
        found = Groups(index, pages.__getitem__, lambda number, _: groups[number])
        return replace(self.manifest, frames=group.stop, groups=found), page

    def _write_root(self) -> None:
        write_root(self.files, self.manifest, LiveClock(self._available, datetime.now(UTC)))
