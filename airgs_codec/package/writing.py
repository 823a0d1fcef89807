"""Publishing tables: those of the groups, then full pages of the index, then the MPD, and airgs.json last.

Each file is written whole or not at all, and nothing that airgs.json leads to is ever written twice; so a reader finds
a whole package whenever it looks, also while groups are added.
"""

from __future__ import annotations

from pathlib import Path

from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock, write_mpd
from airgs_codec.package.packing import build_index, pack_group, pack_json
from airgs_codec.package.paths import JSON_NAME, MPD_NAME, group_path, page_path
from airgs_codec.package.staging import write_file
from airgs_codec.package.store import root_of
from airgs_codec.package.tables import Group


def write_group(folder: Path, number: int, group: Group) -> bytes:
    """Write the table of a group, counted from 1, whose files are there already; gives its bytes."""
    data = pack_group(group)
    write_file(folder, group_path(number), data)
    return data


def write_tables(folder: Path, m: Manifest, clock: LiveClock | None = None) -> int:
    """Write all tables and manifest.mpd of a package whose other files are there; gives their length together.

    Raises ConfigError for a growing package without a clock.
    """
    tables = [write_group(folder, number, group) for number, group in enumerate(m.groups, 1)]
    _, pages = build_index(m.groups, tables)
    for number, page in enumerate(pages, 1):
        write_file(folder, page_path(number), pack_json(page))
    return write_root(folder, m, clock) + sum(map(len, tables)) + sum(len(pack_json(page)) for page in pages)


def write_root(folder: Path, m: Manifest, clock: LiveClock | None = None) -> int:
    """Write manifest.mpd and airgs.json of a package whose tables are there; gives their length together."""
    mpd = write_file(folder, MPD_NAME, write_mpd(m, clock))
    return mpd.bytes + write_file(folder, JSON_NAME, pack_json(root_of(m))).bytes
