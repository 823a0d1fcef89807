"""The index: a long package starts as quickly as a short one, and every group is found with one page at most."""

from dataclasses import replace

import pytest

from airgs_codec.decoder.decode import decode
from airgs_codec.errors import FormatError
from airgs_codec.package.index import GroupIndex
from airgs_codec.package.manifest import Groups
from airgs_codec.package.mpd import write_mpd
from airgs_codec.package.packing import build_index, pack_group, pack_json
from airgs_codec.package.parse import parse_page, parse_root
from airgs_codec.package.paths import file_kind, group_path, page_path
from airgs_codec.package.store import open_package, root_of
from airgs_codec.package.tables import PAGE, digest
from tests.support.manifests import tiny_manifest
from tests.support.mutations import read_files
from tests.support.paths import VALID
from tests.support.regions import arc

GROUPS, FRAMES = 7200, 30  # two hours at 30 frames a second
START_BYTES = 16_000


@pytest.fixture(scope="module")
def long():
    """The tables of two hours, as large as those of a scene with three tiers and qualities and five levels."""
    m = tiny_manifest(
        groups=(FRAMES,),
        fps=(30, 1),
        key_bytes=((30_000, 20_000, 10_000),) * 3,
        state_bytes=(50_000, 40_000, 30_000, 20_000, 10_000),
        psnr=((40.0, 39.0, 38.0),) * 5,
    )
    group = m.groups[0]
    groups = [
        replace(
            group,
            start=FRAMES * n,
            stop=FRAMES * (n + 1),
            segments=[replace(group.segments[0], start=FRAMES * n, stop=FRAMES * (n + 1))],
        )
        for n in range(GROUPS)
    ]
    tables = [digest(b"%d" % n).encode() * 80 for n in range(GROUPS)]  # 2.5 kB each
    index, pages = build_index(groups, tables)
    region = arc(90, 13, 1.234567)
    m = replace(m, frames=GROUPS * FRAMES, region=region)
    return replace(m, groups=Groups(index, pages.__getitem__, lambda n, _: groups[n])), pages


def test_what_two_hours_fetch_before_their_first_group_is_small(long):
    m, pages = long
    root, mpd = pack_json(root_of(m)), write_mpd(m)
    assert len(pages) == GROUPS // PAGE and parse_root(root) == root_of(m)
    assert len(root) + len(mpd) + max(len(pack_json(page)) for page in pages) <= START_BYTES
    assert len(mpd) < 3_000


def test_every_place_is_found_with_one_page(long):
    m, pages = long
    for group in (0, 1, PAGE - 1, PAGE, 5000, GROUPS - 1):
        read = []
        index = GroupIndex(m.groups.table, lambda n, seen=read: seen.append(n) or pages[n])
        assert index.at_frame(FRAMES * group) == index.at_frame(FRAMES * (group + 1) - 1) == group
        assert index.at_segment(group) == group and index.entry(group).start == FRAMES * group
        assert read == ([group // PAGE] if group < PAGE * len(pages) else [])
    for wrong in (-1, GROUPS * FRAMES):
        with pytest.raises(IndexError):
            m.segment_at(wrong)


def test_pages_are_checked_against_the_root(long):
    m, pages = long
    root = root_of(m)
    for page in (pages[0], replace(pages[0], frames=[31, 29, *pages[0].frames[2:]])):
        assert parse_page(pack_json(page), root, 0) == page
    for broken in (
        replace(pages[0], frames=[31, *pages[0].frames[1:]]),
        replace(pages[0], segments=[2, *pages[0].segments[1:]]),
        replace(pages[0], sha256=pages[0].sha256[32:]),
    ):
        with pytest.raises(FormatError) as caught:
            parse_page(pack_json(broken), root, 0)
        assert caught.value.reason == "bad_value" and caught.value.where.startswith("index/1.json")


def test_a_frame_is_decoded_from_its_own_tables(tmp_path):
    """Nothing but the root, one page, the table of the group and the files of the group is read."""
    files = read_files(VALID / "paged")
    kept = {"airgs.json", "manifest.mpd", page_path(1), group_path(7)}
    for name, data in files.items():
        if name in kept or (name.endswith(("/7.bin", "/7.m4s")) and file_kind(name)):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_bytes(data)
    whole, part = open_package(VALID / "paged"), open_package(tmp_path)
    assert (decode(part, 6).means == decode(whole, 6).means).all()
    with pytest.raises(FormatError) as caught:
        decode(part, 7)
    assert (caught.value.reason, caught.value.where) == ("missing_file", group_path(8))


def test_tables_that_were_used_long_ago_are_read_again(monkeypatch):
    monkeypatch.setattr("airgs_codec.package.manifest.KEPT", 2)
    m = tiny_manifest(groups=(1, 1, 1))
    read = []
    groups = Groups(m.groups.table, [].__getitem__, lambda n, _: read.append(n) or m.groups[n])
    for n in (0, 1, 0, 2, 0, 1):
        assert groups[n].start == n
    assert read == [0, 1, 2, 1]


def test_a_table_has_the_same_bytes_every_time():
    group = tiny_manifest().groups[0]
    assert pack_group(group) == pack_group(replace(group)) and pack_group(group)[4:8] == bytes(4)
