"""The index: a long package starts as quickly as a short one, and every group is found with a page for each level."""

from dataclasses import replace
from functools import cache
from itertools import accumulate, pairwise
from types import SimpleNamespace

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests import faces
from tests.faces import FormatError, GroupIndex, Groups, build_index, digest, pack_json, root_of
from tests.makers.vectors.packages import pages_to
from tests.support.manifests import no_page, tiny_manifest
from tests.support.regions import arc

PAGE = 64
GROUPS, FRAMES = 7200, 30  # two hours at 30 frames a second
START_BYTES = 16_000
MOST_ROOT_BYTES = 63 * 50 * 3  # of three levels
TABLES = [b"%d" % number for number in range(GROUPS)]
STARTS = [0, *accumulate(1 + 7 * n % 5 for n in range(5000))]
ALL = [  # groups of one to five frames and one to three segments
    SimpleNamespace(start=a, stop=b, segments=range(1 + 3 * n % 4 % 3)) for n, (a, b) in enumerate(pairwise(STARTS))
]
FIRSTS = [0, *accumulate(len(part.segments) for part in ALL)]  # segments before a group


@cache
def index_of(count):
    return build_index(ALL[:count], TABLES[:count])


def places_of(count, broken=()):
    """The places of so many groups, the paths of all pages, and those that are read; the broken ones cannot be."""
    (index, pages), read = index_of(count), []

    def read_page(path, _):
        read.append(path)
        if path in broken:
            raise FormatError("hash_mismatch", path, "of another package")
        return pages[path]

    return GroupIndex(index, read_page), pages, read


@given(count=st.integers(1, len(ALL)), seed=st.randoms(use_true_random=False))
@example(1, None)
@example(63, None)
@example(64, None)
@example(65, None)
@example(4095, None)
@example(4096, None)
@example(4097, None)
@settings(max_examples=12)
def test_every_group_frame_and_segment_is_found_with_a_page_for_each_level(count, seed):
    index, pages = index_of(count)
    digits = [count // PAGE**level % PAGE for level in range(9) if count >= PAGE**level]
    assert [len(spans) for spans in index] == digits and sum(len(pack_json(s)) for s in index) < MOST_ROOT_BYTES
    assert faces.count_groups(index) == count and sorted(pages) == sorted(GroupIndex(index, no_page).pages())
    assert len(pages) == sum(count // PAGE**level for level in range(1, 9))
    chosen = range(count) if seed is None else sorted({0, count - 1, *seed.choices(range(count), k=300)})
    places, _, read = places_of(count)
    for number in chosen:
        part, entry = ALL[number], places.entry(number)
        assert (entry.start, entry.stop, entry.segments) == (part.start, part.stop, len(part.segments))
        assert entry.first_segment == FIRSTS[number] and entry.file.sha256 == digest(TABLES[number])
        assert {places.at_frame(frame) for frame in range(part.start, part.stop)} == {number}
        assert {places.at_segment(FIRSTS[number] + s) for s in part.segments} == {number}
    assert len(read) == len(set(read))
    for number in (0, count // 2, count - 1):
        fresh, _, way = places_of(count)
        fresh.at_frame(ALL[number].start)
        assert way == pages_to(number, count) == list(places.pages_to("groups", number))
        assert way == list(places.pages_to("segments", FIRSTS[number]))
    assert (places.groups, places.frames, places.segments) == (count, STARTS[count], FIRSTS[count])


def test_extending_one_by_one_gives_the_same_as_building_at_once():
    index, pages = [], {}
    for number in range(PAGE * PAGE + 2):
        before = index
        index, filled = faces.extend_index(index, number, ALL[number], TABLES[number])
        assert not set(filled) & set(pages)  # what is written is never written again
        pages |= filled
        carried = len(filled)
        assert [len(spans) for spans in index[:carried]] == [0] * carried
        assert index[carried + 1 :] == before[carried + 1 :]
        if number + 1 in (1, 63, 64, 65, 700, 4095, 4096, 4097):
            assert (index, pages) == index_of(number + 1)


def test_pages_that_are_not_there_are_asked_for_from_the_root_on():
    places, _, read = places_of(4500)
    there, rounds = set(), []
    while missing := places.missing_pages(range(FIRSTS[4000], places.segments), there):
        rounds.append(missing)
        there.update(missing)
    firsts = [f"index/1/{number}.json" for number in range(65, 71)]
    assert sorted(rounds[0]) == [*firsts, "index/2/1.json"]
    assert rounds[1:] == [["index/1/63.json", "index/1/64.json"]]
    assert read == ["index/2/1.json"]  # those of groups are there, but not needed to say so


def test_what_a_page_that_cannot_be_read_leads_to_is_not_looked_for_and_its_segments_are_guessed():
    broken = {"index/1/3.json", "index/1/66.json"}
    places, pages, read = places_of(4500, broken)
    found = list(places.sweep())
    groups = [number for number in found if isinstance(number, int)]
    assert groups == [n for n in range(4500) if n // PAGE not in (2, 65)]
    assert {error.where for error in found if not isinstance(error, int)} == broken and len(found) == len(groups) + 2
    assert len(read) == len(set(read)) == len(pages)

    assert places.guess_span(0) == (0, 1) and ALL[0].segments == range(1)
    guessed = [places.guess_span(segment) for segment in range(FIRSTS[128], FIRSTS[192])]
    assert guessed[0][0] == STARTS[128] and guessed[-1][1] == STARTS[192]
    assert all(a[1] == b[0] for a, b in pairwise(guessed))
    with pytest.raises(FormatError):
        places.at_segment(FIRSTS[192] - 1)


@pytest.fixture(scope="module")
def long():
    """The tables of two hours, as large as those of a scene with three tiers and qualities and five levels."""
    m = tiny_manifest(
        groups=(FRAMES,), fps=(30, 1), keyframe_bytes=((30_000, 20_000, 10_000),) * 3,
        delta_bytes=(50_000, 40_000, 30_000, 20_000, 10_000), psnr=((40.0, 39.0, 38.0),) * 5,
    )  # fmt: skip
    group, groups = m.groups[0], []
    for n in range(GROUPS):
        span = {"start": FRAMES * n, "stop": FRAMES * (n + 1)}
        groups.append(replace(group, **span, segments=[replace(group.segments[0], **span)]))
    index, pages = build_index(groups, [digest(table).encode() * 80 for table in TABLES])  # 2.5 kB each
    m = replace(m, frames=GROUPS * FRAMES, region=arc(90, 13, 1.234567))
    return replace(m, groups=Groups(index, lambda path, _: pages[path], lambda n, _: groups[n])), pages


def test_what_two_hours_fetch_before_their_first_group_is_small(long):
    m, pages = long
    root, mpd = pack_json(root_of(m)), faces.write_mpd(m)
    assert faces.parse_root(root) == root_of(m)
    way = [pages[path] for path in m.groups.places.pages_to("groups", 0)]
    assert len(way) == 2 and len(root) + len(mpd) + sum(len(pack_json(page)) for page in way) <= START_BYTES
    assert len(mpd) < 3_000


def test_places_outside_the_sequence_are_none(long):
    m, _ = long
    for wrong in (-1, GROUPS * FRAMES):
        with pytest.raises(IndexError):
            m.segment_at(wrong)
    for wrong in ("index/1/113.json", "index/2/2.json", "index/3/1.json", f"group/{GROUPS + 1}.json.gz"):
        with pytest.raises(FormatError, match="no table has such a file"):
            m.entry(wrong)


@pytest.mark.parametrize(("level", "number"), [(1, 64), (2, 1), (1, 112)])
def test_pages_are_checked_against_the_level_above(long, level, number):
    m, pages = long
    path = f"index/{level}/{number}.json"
    page = pages[path]
    sums = {name: [2 * getattr(page, name)[0], *getattr(page, name)[2:]] for name in ("frames", "segments")}

    def check(**changes):
        files = pages | {path: replace(page, **changes)}
        opened = faces.open_manifest(root_of(m), lambda name, _: pack_json(files[name]))
        opened.groups.places.check_page(level, number - 1)

    check()
    for words, changes in {
        "expected (64, ": {"frames": [page.frames[0] + 1, *page.frames[1:]]},
        "entries, frames and segments": {"segments": [page.segments[0] + 1, *page.segments[1:]]},
        "columns of one length": {"sha256": page.sha256[32:]},
        "got (63, ": {"bytes": page.bytes[1:], "sha256": page.sha256[32:], **sums},
    }.items():
        with pytest.raises(FormatError) as caught:
            check(**changes)
        assert caught.value.reason == "bad_value" and caught.value.where == path and words in caught.value.detail


def test_tables_that_were_used_long_ago_are_read_again(monkeypatch):
    monkeypatch.setattr("airgs_codec.package.manifest.TABLES_IN_MEMORY", 2)
    m = tiny_manifest(groups=(1, 1, 1))
    read = []
    groups = Groups(m.groups.columns, no_page, lambda n, _: read.append(n) or m.groups[n])
    for n in (0, 1, 0, 2, 0, 1):
        assert groups[n].start == n
    assert read == [0, 1, 2, 1]
