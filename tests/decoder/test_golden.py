"""Old bytes decode to what they always did: decoding is pinned at the integer codes, encoder bytes are not."""

import json

import pytest

from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.media.h264 import open_segment
from airgs_codec.package.package import open_package
from tests.support.digests import digests
from tests.support.paths import GOLDEN

CASES = sorted(path.stem for path in GOLDEN.glob("*.json"))


def test_the_corpus_is_not_empty():
    assert len(CASES) >= 2


@pytest.mark.parametrize("case", CASES)
def test_decodes_to_the_recorded_codes(case):
    recorded = json.loads((GOLDEN / f"{case}.json").read_text())
    assert len(recorded) > 10
    assert digests(open_package(GOLDEN / case)) == recorded


def test_the_corpus_has_escapes():
    package = open_package(GOLDEN / "fox-fine")
    columns, _ = open_segment(package.read("state/L0/1.m4s"), "x")
    assert ColumnReader(columns, "x").column(1, 0)[0] > 0
