"""Write the conformance corpus: manifests/valid/<name>/ and manifests/invalid/<reason>/, small whole packages.

    python -m tests.makers.conformance

Every package under invalid/ is valid/moving (valid/paged for what concerns a page, valid/kept for kept rows,
valid/tiled for tiles) with one thing broken, and must be refused for the reason that its name begins with. Encoder
bytes may change from one x264 to the next; what the packages decode to is pinned in tests/golden.
"""

from __future__ import annotations

import gzip
import shutil
import tempfile
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from airgs_codec.coding.rangecoder import ColumnReader, encode_columns
from airgs_codec.coding.sidecar import pack_key_sidecar, unpack_key_sidecar
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import APART, KEPT, EncodeSettings, LevelSettings
from airgs_codec.media.fragments import box, with_columns
from airgs_codec.media.mp4 import read_boxes
from airgs_codec.package.folder import Folder
from airgs_codec.package.manifest import Groups
from airgs_codec.package.mpd import LiveClock
from airgs_codec.package.parse import parse_root
from airgs_codec.package.paths import INIT_NAME, JSON_NAME, MPD_NAME
from airgs_codec.package.store import open_package
from airgs_codec.package.tables import Grid, Place, Region, digest
from airgs_codec.package.world import world_from
from airgs_codec.package.writing import write_tables
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence
from tests.support.mutations import (
    Files,
    Mutation,
    add_file,
    apply,
    drop_value,
    edit_tables,
    edit_text,
    honest,
    link_file,
    on_disk,
    pack_table,
    parse_table,
    reindexed,
    remove_file,
    rewrite,
    set_value,
)
from tests.support.paths import INVALID, VALID
from tests.support.rooms import room_frames
from tests.support.scenes import write_sequence

KEY_SIDECAR, KEY_PICTURE, TABLE, PAGE_TABLE = "key/T0/1.bin", "key/T0/Q0/1.m4s", "group/1.json.gz", "index/1/1.json"
TILE_PICTURE = "key/P2/T0/Q0/1.m4s"
KEPT_SIDECAR, KEPT_TABLE, LAST_TABLE = "key/T0/2.bin", "group/2.json.gz", "group/3.json.gz"
NO_SPANS = {"frames": [], "segments": [], "bytes": [], "sha256": ""}
SETTINGS = EncodeSettings(calibrate="none", levels=(LevelSettings(0.0),), keys=APART)


def frames(count: int, degree: int, length: int) -> list[Gaussians]:
    """A small ball of Gaussians, half of it swinging."""
    rng = np.random.default_rng(7)
    rest = rng.normal(size=(count, {0: 0, 1: 3}[degree], 3)) * 0.2
    still = rng.normal(size=(count, 3)) * 0.4
    columns = [rng.normal(size=(count, 4)), rng.normal(size=(count, 3)) * 0.3 - 2, rng.normal(size=count) * 2]
    columns += [rng.normal(size=(count, 3)), rest]
    swing = (np.arange(count) % 2)[:, None] * np.array([0.2, 0.05, 0.0])
    moved = [still + swing * np.sin(0.5 * t) for t in range(length)]
    return [Gaussians(*(np.asarray(c, np.float32) for c in (means, *columns))) for means in moved]


BALL = Region("file", 32, 24, 50.0, 0.01, 5.0, [Place([0.0, 0.0, -3.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 0.2)])

PACKAGES = {
    "moving": (frames(64, 0, 4), replace(SETTINGS, levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1)))),
    "kept": (
        room_frames(60, 6),
        replace(SETTINGS, keys=KEPT, group_frames=2, keep_all=True, region=BALL, measure_pictures=2),
    ),
    "one-gaussian": (frames(1, 1, 1), replace(SETTINGS, key_factors=(1.0,))),
    "paged": (
        frames(4, 0, 65),
        replace(SETTINGS, group_frames=1, key_factors=(1.0,), tiers=(1.0,), measure_pictures=0),
    ),
    "placed": (frames(2, 0, 1), replace(SETTINGS, key_factors=(1.0,), world=world_from((0, 0, 1), 0.01))),
    "white": (frames(2, 0, 1), replace(SETTINGS, key_factors=(1.0,), region=replace(BALL, background=[1.0, 1.0, 1.0]))),
    "tiled": (
        room_frames(24, 4),
        replace(SETTINGS, keys=KEPT, group_frames=2, keep_all=True, region=BALL, measure_pictures=2, tiles=3),
    ),
    "two-groups-sh1": (frames(40, 1, 5), replace(SETTINGS, group_frames=3, segment_s=0.07)),
}


def without_moving_rows(files: Files) -> Files:
    """Say in a sidecar that its rows are static, while the tables count them."""
    root = parse_root(files[JSON_NAME])
    group, coarsest = parse_table(files[TABLE]), root.qualities[-1].coarser
    grid = Grid(**group["grid"])
    sidecar = unpack_key_sidecar(
        files[KEY_SIDECAR], group["tiles"][0]["tiers"][0]["count"], grid, coarsest, KEY_SIDECAR
    )
    still = replace(sidecar, depths=np.full_like(sidecar.depths, 255))
    return files | {KEY_SIDECAR: pack_key_sidecar(still, grid, coarsest)}


def kept_sidecar(index: int, depth: int) -> Mutation:
    """A sidecar of the second group whose first kept row has this index, and all of them this depth."""

    def mutate(files: Files) -> Files:
        tier = parse_table(files[KEPT_TABLE])["tiles"][0]["tiers"][0]
        others, kept = tier["count"] - tier["kept"], tier["kept"]
        reader = ColumnReader(files[KEPT_SIDECAR], KEPT_SIDECAR)
        gaps, _ = (reader.column(kept, 1) for _ in range(2))
        rest = [
            (reader.column(count, order), order) for count, order in ((1, 0), (others, 1), (others, 0), (others, 1))
        ]
        columns = [(np.array([index, *gaps[1:]]), 1), (np.full(kept, depth + 1), 1), *(rest if others else [])]
        return files | {KEPT_SIDECAR: encode_columns(columns)}

    return mutate


def flip(data: bytes) -> bytes:
    """Change the last byte."""
    return data[:-1] + bytes([data[-1] ^ 1])


def in_table(*mutations: Mutation) -> tuple[Mutation, ...]:
    """Changes to the table of the first group, of which the index knows."""
    return (*mutations, reindexed)


def inflated(data: bytes) -> bytes:
    """What is in a table, without gzip."""
    return gzip.decompress(data)


def media_alone(data: bytes) -> bytes:
    """A media segment without the uuid box in front of it."""
    return b"".join(whole for kind, whole in read_boxes(data) if kind != b"uuid")


def repaged(files: Files) -> Files:
    """Make airgs.json agree with the length and digest of the first page."""
    page = files[PAGE_TABLE]
    return apply(files, set_value(("index", 1, "bytes"), [len(page)]), set_value(("index", 1, "sha256"), digest(page)))


def unpaged(files: Files) -> Files:
    """Put the groups of the first page into airgs.json, before those that are there."""
    page, index = parse_table(files[PAGE_TABLE]), parse_table(files[JSON_NAME])["index"]
    groups = {name: page[name] + index[0][name] for name in page}
    return apply(files, set_value(("index",), [groups]), remove_file(PAGE_TABLE))


def raised(files: Files) -> Files:
    """Say of the first page that it is one of the second level."""
    groups, pages = parse_table(files[JSON_NAME])["index"]
    page = add_file("index/2/1.json", files[PAGE_TABLE])
    return apply(files, set_value(("index",), [groups, NO_SPANS, pages]), remove_file(PAGE_TABLE), page)


def shortened(files: Files) -> Files:
    """Make one group of the first two on the first page, whose sums stay as they are."""
    page = parse_table(files[PAGE_TABLE])
    sums = {name: [sum(page[name][:2]), *page[name][2:]] for name in ("frames", "segments")}
    entries = {"bytes": page["bytes"][1:], "sha256": page["sha256"][32:]}
    return repaged(files | {PAGE_TABLE: pack_table(PAGE_TABLE, sums | entries)})


BREAKS: dict[str, tuple[Mutation, ...]] = {  # reason, and where -> what breaks valid/moving, or valid/paged
    "not_json": (rewrite(JSON_NAME, lambda text: text[:-1]),),
    "not_json-group": in_table(rewrite(TABLE, inflated)),
    "not_json-group-tail": in_table(rewrite(TABLE, lambda data: data + data)),
    "unknown_version": (set_value(("version",), 1),),
    "unknown_field": (set_value(("colour",), "red"),),
    "unknown_field-group": in_table(set_value(("colour",), "red", TABLE)),
    "missing_field": (drop_value(("frames",)),),
    "missing_field-world": (set_value(("world",), {"transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}),),
    "missing_field-group": in_table(drop_value(("grid",), TABLE)),
    "wrong_type": (set_value(("frames",), "4"),),
    "wrong_type-world": (set_value(("world",), None),),
    "wrong_type-index": (edit_tables(lambda root: root.update(index={"groups": root["index"][0]})),),
    "wrong_type-live": (set_value(("live",), 1),),
    "wrong_type-group": in_table(set_value(("count",), None, TABLE)),
    "bad_value": (set_value(("sh_degree",), 4),),
    "bad_value-world": (set_value(("world",), {"transform": [1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0], "metric": True}),),
    "bad_value-world-mirror": (
        set_value(("world",), {"transform": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0], "metric": False}),
    ),
    "bad_value-background": (set_value(("region", "background"), [1, 1, 1.5]),),
    "bad_value-background-length": (set_value(("region", "background"), [1, 1]),),
    "bad_value-columns": (set_value(("index", 0, "frames"), [2, 2]),),
    "bad_value-index": (set_value(("index",), []),),
    "bad_value-index-level": (edit_tables(lambda root: root["index"].append(NO_SPANS)),),
    "bad_value-cover": (set_value(("frames",), 5),),
    "bad_value-page-root": (set_value(("index", 0), NO_SPANS),),
    "bad_value-page-full": (unpaged,),
    "bad_value-page-level": (raised,),
    "bad_value-page-short": (shortened,),
    "bad_value-group": in_table(set_value(("start",), 1, TABLE)),
    "bad_value-tiles": (set_value(("tiles",), 2),),
    "bad_value-tile-levels": in_table(set_value(("tiles", 1, "levels"), [], TABLE)),
    "bad_value-tile-box": in_table(set_value(("tiles", 1, "low"), [0, 1e9, 0], TABLE)),
    "bad_value-tile-files": in_table(set_value(("segments", 0, "levels", 0, "files"), [], TABLE)),
    "missing_file-tile": (remove_file(TILE_PICTURE),),
    "foreign_file-tile": (add_file(KEY_PICTURE, b"a tile has a folder\n"),),
    "bad_value-segments": in_table(set_value(("segments", 0, "stop"), 3, TABLE)),
    "bad_value-page-sum": (set_value(("frames", 0), 2, PAGE_TABLE), repaged),
    "bad_value-keeps": in_table(set_value(("keeps",), 2, KEPT_TABLE)),
    "bad_value-keeps-chain": in_table(set_value(("keeps",), 2, LAST_TABLE)),
    "bad_value-keeps-none": in_table(drop_value(("keeps",), KEPT_TABLE)),
    "bad_value-kept": in_table(set_value(("tiles", 0, "tiers", 0, "kept"), 1 << 24, KEPT_TABLE)),
    "missing_field-kept": in_table(drop_value(("tiles", 0, "tiers", 0, "kept"), KEPT_TABLE)),
    "bad_sidecar-kept": (kept_sidecar(1 << 20, 0), honest),
    "bad_sidecar-kept-depth": (kept_sidecar(0, 255), honest),
    "unsafe_path": (link_file(KEY_SIDECAR, "Q0/1.m4s"),),
    "missing_entry": in_table(
        set_value(("tiles", 0, "tiers", 0, "pictures", 0), {"bytes": 0, "sha256": ""}, TABLE), remove_file(KEY_PICTURE)
    ),
    "missing_file": (remove_file(KEY_PICTURE),),
    "missing_file-group": (remove_file(TABLE),),
    "missing_file-page": (remove_file(PAGE_TABLE),),
    "foreign_file-page": (add_file("index/2/1.json", b"nothing leads to it\n"),),
    "foreign_file": (add_file("notes.txt", b"not part of the package\n"),),
    "size_mismatch": (rewrite(KEY_SIDECAR, lambda b: b + b"\0"),),
    "size_mismatch-group": (rewrite(TABLE, lambda b: b + b"\0"),),
    "hash_mismatch": (rewrite(KEY_SIDECAR, flip),),
    "hash_mismatch-group": (rewrite(TABLE, flip),),
    "hash_mismatch-page": (rewrite(PAGE_TABLE, lambda b: b[:-3] + b"x" + b[-2:]),),
    "bad_sidecar": (rewrite(KEY_SIDECAR, lambda b: b[: len(b) // 2]), honest),
    "bad_sidecar-detail": (rewrite(KEY_PICTURE, lambda b: with_columns(media_alone(b), bytes(20))), honest),
    "count_mismatch": (without_moving_rows, honest),
    "bad_picture": (rewrite(KEY_PICTURE, lambda b: b[:-40] + bytes(20)), honest),
    "bad_picture-uuid": (rewrite(KEY_PICTURE, lambda b: box(b"uuid", bytes(20)) + media_alone(b)), honest),
    "bad_value-picture-width": in_table(set_value(("tiles", 0, "tiers", 0, "qualities", 0, "width"), 4096, TABLE)),
    "bad_picture-size": in_table(set_value(("tiles", 0, "tiers", 0, "qualities", 0, "height"), 4096, TABLE)),
    "doctype": (edit_text(MPD_NAME, "<MPD", '<!DOCTYPE MPD [<!ENTITY a "b">]><MPD'),),
    "bad_mpd": (edit_text(MPD_NAME, "</MPD>", ""),),
    "foreign_url": (edit_text(MPD_NAME, 'media="state/', 'media="http://example.com/state/'),),
    "mpd_mismatch": (edit_text(MPD_NAME, '<S t="0"', '<S t="1"'),),
    "mpd_mismatch-live": (set_value(("live",), True),),
}


def source_of(name: str) -> str:
    """The valid package that a broken one is made of."""
    return "tiled" if "-tile" in name else "paged" if "-page" in name else "kept" if "-ke" in name else "moving"


def main() -> None:
    """Write the corpus anew."""
    shutil.rmtree(VALID, ignore_errors=True)
    shutil.rmtree(INVALID, ignore_errors=True)
    for name, (sequence, settings) in PACKAGES.items():
        with tempfile.TemporaryDirectory() as folder:
            encode(open_sequence(write_sequence(Path(folder), sequence)), VALID / name, settings)
    write_live()
    for name, mutations in BREAKS.items():
        on_disk(shutil.copytree(VALID / source_of(name), INVALID / name), *mutations)


def write_live() -> None:
    """valid/live: the first group of valid/two-groups-sh1 while the second is still to come."""
    package = open_package(VALID / "two-groups-sh1")
    m = package.manifest
    first = replace(m, frames=m.groups[0].stop, live=True, groups=Groups.of(m.groups[:1]))
    live = Folder(VALID / "live")
    for path in (INIT_NAME, *first.group_files(0)):
        live.write(path, package.read(path))
    moment = datetime(2026, 1, 1, tzinfo=UTC)
    write_tables(live, first, LiveClock(moment, moment))


if __name__ == "__main__":
    main()
