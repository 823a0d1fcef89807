"""Conditions, ranges and content coding, without a server."""

import asyncio
import gzip
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airgs_codec.package.tables import digest
from airgs_codec.play.repr_digest import check_repr_digest
from airgs_codec.serve.app import PIECE_BYTES, answer, parse_range
from airgs_codec.serve.files import Snapshot, Version

DATA = bytes(range(100))
TEXT = b"x" * 5000
HASH, TEXT_HASH = digest(DATA), digest(TEXT)
SEGMENT = Snapshot("video/mp4", True, Version.of(DATA), None, 0)
ROOT = Snapshot("application/json", False, Version.of(TEXT), Version.of(gzip.compress(TEXT)), 0)


def pieces_of(response):
    async def gather():
        return [piece async for piece in response.body_iterator]

    return asyncio.run(gather()) if hasattr(response, "body_iterator") else [response.body]


def body_of(response):
    return b"".join(pieces_of(response))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("bytes=0-0", range(1)),
        ("bytes=10-19", range(10, 20)),
        ("bytes=90-", range(90, 100)),
        ("bytes=-10", range(90, 100)),
        ("bytes=-1000", range(100)),
        ("bytes=0-1000", range(100)),
        (f"bytes=0-{'9' * 9000}", range(100)),
        (f"Bytes = {'0' * 9000}5 - 6", range(5, 7)),
        ("bytes=100-", range(0)),
        (f"bytes={'9' * 9000}-", range(0)),
        ("bytes=-0", range(0)),
        *((text, None) for text in ("", "bytes=-", "bytes=5-4", "bytes=a-b", "bytes=0-1,3-4", "bits=0-1", "0-1")),
        *((text, None) for text in ("bytes=1", "bytes=--1", "bytes=0x1-2", "bytes=+1-2", "bytes=\u0661-\u0662")),
    ],
)
def test_a_range_is_read_or_ignored(text, expected):
    part = parse_range(text, 100)
    assert part == expected if expected is None else list(part) == list(expected)


@given(first=st.integers(0, 300), last=st.integers(0, 300), size=st.integers(0, 200))
def test_a_range_is_what_a_slice_would_be(first, last, size):
    data = bytes(size)
    part = parse_range(f"bytes={first}-{last}", size)
    assert (part is None) == (last < first)
    assert part is None or data[part.start : part.stop] == data[first : last + 1]
    last_bytes = parse_range(f"bytes=-{last}", size)
    assert len(last_bytes) == min(last, size) and last_bytes.stop == size


def test_a_part_says_where_it_lies():
    response = answer(SEGMENT, {"range": "bytes=10-19"})
    assert (response.status_code, body_of(response)) == (206, DATA[10:20])
    assert response.headers["content-range"] == "bytes 10-19/100" and response.headers["content-length"] == "10"
    refused = answer(SEGMENT, {"range": "bytes=100-"})
    assert (refused.status_code, refused.headers["content-range"]) == (416, "bytes */100")


@pytest.mark.parametrize(
    ("condition", "status"),
    [(f'"{HASH}"', 206), (f'W/"{HASH}"', 200), ('"old"', 200), ("Sat, 29 Oct 1994 19:43:31 GMT", 200)],
)
def test_a_part_of_another_version_is_never_given(condition, status):
    assert answer(SEGMENT, {"range": "bytes=0-1", "if-range": condition}).status_code == status


@pytest.mark.parametrize(
    ("condition", "status"),
    [(f'"{HASH}"', 304), (f'"a", W/"{HASH}"', 304), ("*", 304), ('"old"', 200), (HASH, 200), ("", 200)],
)
def test_a_known_version_is_not_sent_again(condition, status):
    response = answer(SEGMENT, {"if-none-match": condition, "range": ""})
    assert response.status_code == status and response.headers["etag"] == f'"{HASH}"'
    assert (body_of(response) == b"") == (status == 304)


@pytest.mark.parametrize(
    ("accepted", "zipped"),
    [("gzip", True), ("br, GZIP;q=0.5", True), ("gzip;q=0", False), ("gzip; q=0.000", False), ("br", False)],
)  # fmt: skip
def test_text_is_zipped_for_those_who_take_it(accepted, zipped):
    response = answer(ROOT, {"accept-encoding": accepted})
    assert ("content-encoding" in response.headers) == zipped
    body = body_of(response)
    assert (gzip.decompress(body) if zipped else body) == TEXT
    assert response.headers["etag"] == (f'"{TEXT_HASH}-gzip"' if zipped else f'"{TEXT_HASH}"')
    check_repr_digest("airgs.json", body, response.headers["repr-digest"])
    assert response.headers["vary"] == "Accept-Encoding"
    assert response.headers["content-length"] == str(len(body))


def test_ranges_count_in_the_file_itself_and_pictures_are_never_zipped():
    part = answer(ROOT, {"accept-encoding": "gzip", "range": "bytes=0-9"})
    assert body_of(part) == TEXT[:10] and "content-encoding" not in part.headers
    assert "content-encoding" not in answer(SEGMENT, {"accept-encoding": "gzip"}).headers


def test_what_may_be_kept_for_ever():
    assert "immutable" in answer(SEGMENT, {}).headers["cache-control"]
    assert answer(ROOT, {}).headers["cache-control"] == "no-cache"


@pytest.mark.parametrize(("asked", "expected"), [("", range(500_000)), ("bytes=7-400000", range(7, 400_001))])
def test_a_file_is_read_in_pieces_and_no_further_than_a_range_goes(asked, expected):
    reads = []
    version = Version(500_000, bytes(32), lambda start, stop: reads.append(range(start, stop)) or bytes(stop - start))
    pieces = pieces_of(answer(Snapshot("video/mp4", True, version, None, 0), {"range": asked}))
    assert reads[0].start == expected.start and reads[-1].stop == expected.stop
    assert all(one.stop == other.start for one, other in itertools.pairwise(reads))
    assert [len(piece) for piece in pieces] == [len(read) for read in reads]
    assert max(map(len, reads)) == PIECE_BYTES
