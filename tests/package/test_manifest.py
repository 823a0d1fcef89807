"""The tables: strict reading, the schema, the conformance corpus, the MPD."""

import gzip
import json
import shutil
import subprocess
from datetime import UTC, datetime

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.errors import FormatError
from airgs_codec.inspect.validate import validate
from airgs_codec.package import packing
from airgs_codec.package.mpd import LiveClock, adaptation_sets, write_mpd
from airgs_codec.package.mpd_check import check_mpd
from airgs_codec.package.packing import pack_group, pack_json
from airgs_codec.package.parse import parse_group, parse_root
from airgs_codec.package.paths import JSON_NAME, group_path
from airgs_codec.package.schema import manifest_schema
from airgs_codec.package.store import open_package, root_of
from tests.makers.conformance import BREAKS, TABLE, source_of
from tests.support.mutations import apply, parse_table, places, read_files, set_value
from tests.support.paths import CORPUS

VALID = sorted((CORPUS / "valid").iterdir())
INVALID = sorted((CORPUS / "invalid").iterdir())
TEXT = (CORPUS / "valid" / "two-groups-sh1" / "airgs.json").read_bytes()


def test_the_corpus_is_not_empty():
    assert len(VALID) >= 3 and len(INVALID) >= 15


@pytest.mark.parametrize("path", VALID, ids=lambda p: p.name)
def test_valid_packages_pass_and_survive_json(path):
    assert validate(path) == []
    m = open_package(path).manifest
    assert pack_json(root_of(m)) == (path / "airgs.json").read_bytes()
    assert [pack_group(group) for group in m.groups] == [
        (path / group_path(n)).read_bytes() for n in range(1, 1 + len(m.groups))
    ]
    moment = datetime(2026, 1, 1, tzinfo=UTC)
    assert write_mpd(m, LiveClock(moment, moment)) == (path / "manifest.mpd").read_bytes()


@pytest.mark.parametrize("path", INVALID, ids=lambda p: p.name)
def test_invalid_packages_are_refused_for_their_reason(path):
    findings = validate(path)
    assert {f.reason for f in findings} == {path.name.split("-")[0]}
    assert all("\n" not in str(f) for f in findings)


def test_the_committed_corpus_is_what_its_maker_makes_of_a_valid_package():
    assert {path.name for path in INVALID} == BREAKS.keys()
    for path in INVALID:
        assert read_files(path) == apply(read_files(CORPUS / "valid" / source_of(path.name)), *BREAKS[path.name]), (
            path.name
        )


def test_every_reason_of_the_corpus_is_in_the_format():
    text = (CORPUS.parent / "FORMAT.md").read_text()
    assert [p.name for p in INVALID if p.name.split("-")[0] not in text] == []


def test_the_committed_schema_is_the_generated_one():
    assert json.loads((CORPUS / "airgs.schema.json").read_text()) == manifest_schema()


def test_the_schema_agrees_with_the_reader():
    jsonschema.Draft202012Validator.check_schema(manifest_schema())
    validator = jsonschema.Draft202012Validator(manifest_schema())
    of_groups, of_pages = (
        jsonschema.Draft202012Validator(manifest_schema()["$defs"][name]) for name in ("group", "page")
    )
    for path in VALID:
        validator.validate(json.loads((path / "airgs.json").read_text()))
        of_groups.validate(parse_table((path / "group/1.json.gz").read_bytes()))
    of_pages.validate(json.loads((CORPUS / "valid" / "paged" / "index/1/1.json").read_text()))
    for name in ("unknown_field", "missing_field", "wrong_type", "unknown_version", "bad_value", "wrong_type-live"):
        assert not validator.is_valid(json.loads((CORPUS / "invalid" / name / "airgs.json").read_text())), name
        broken = CORPUS / "invalid" / f"{name}-group" / "group/1.json.gz"
        if name in ("unknown_field", "missing_field", "wrong_type"):
            assert not of_groups.is_valid(parse_table(broken.read_bytes())), name


TABLES = {JSON_NAME: TEXT, TABLE: (CORPUS / "valid" / "two-groups-sh1" / TABLE).read_bytes()}
PLACES = [(name, p) for name, data in TABLES.items() for p in places(parse_table(data)) if p]
ENTRY = open_package(CORPUS / "valid" / "two-groups-sh1").manifest.groups.places.entry(0)


def read(name, place, value):
    """A table of this name with one value changed, read."""
    data = apply(TABLES, set_value(place, value, name))[name]
    return parse_root(data) if name == JSON_NAME else parse_group(data, parse_root(TEXT), ENTRY, 0)


@given(
    where=st.sampled_from(PLACES), value=st.sampled_from([None, -1, 0, 10**12, 1.5, "", "x", [], {}, True, [0], "NaN"])
)
@settings(max_examples=300, deadline=None)
def test_a_mutated_table_is_read_or_refused_never_a_crash(where, value):
    try:
        read(*where, value)
    except FormatError as error:
        assert error.reason and error.where.startswith(where[0])


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("segments", 0, "levels", 0, "psnr"), [1e300, 40.0]),
        (("segments", 0, "levels", 0, "worst"), [30.0]),
        (("segments", 0, "levels", 0, "ssim"), []),
        (("segments", 0, "levels", 0, "delta_e"), []),
        (("segments", 0, "levels", 0, "delta_e"), [-0.1, 0.1]),
        (("segments", 0, "levels", 0, "files", 0, "sha256"), ""),
        (("segments", 0, "levels", 0, "files", 0), {"bytes": 0, "sha256": "A" * 32}),
        (("segments", 0, "levels", 0, "frame_bytes", 0), [-1, 5]),
        (("segments", 0, "stop"), 0),
        (("segments",), []),
        (("stop",), 4),
        (("tiles", 0, "levels", 0, "width"), 8),
        (("tiles", 0, "levels", 0, "height"), 0),
        (("tiles", 0, "levels", 0, "height"), 72),
        (("tiles", 0, "levels", 0, "plane_width"), 4096),
        (("tiles", 0, "tiers", 0, "qualities", 0, "width"), 4096 + 16),
        (("tiles", 0, "tiers", 0, "pictures"), []),
        (("tiles", 0, "tiers", 0, "qualities", 0, "planes"), []),
        (("tiles", 0, "tiers", 0, "qualities", 0, "centres", 0), 2**31 - 1),
    ],
)
def test_claims_of_a_group_that_cannot_be_true_are_refused(place, value):
    with pytest.raises(FormatError) as caught:
        read(TABLE, place, value)
    assert caught.value.reason == "bad_value"


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("levels", 0, "quality"), 2),  # there are Q0 and Q1
        (("region", "places", 0, "up"), [0, 0.0, -0.0]),
        (("qualities", 0, "coarser"), 1),
        (("qualities", 1, "coarser"), 22),
        (("tiers",), 0),
        (("tiers",), 1),
        (("init", "sha256"), ""),
        (("index",), []),
        (("index", 0, "frames"), [5]),
        (("index", 0, "frames", 0), 0),
        (("index", 0, "sha256"), "A" * 33),
        (("index",), [{"frames": [5], "segments": [2], "bytes": [9], "sha256": "A" * 32}] * 6),
    ],
)
def test_claims_of_a_package_that_cannot_be_true_are_refused(place, value):
    with pytest.raises(FormatError) as caught:
        read(JSON_NAME, place, value)
    assert caught.value.reason == "bad_value"


@pytest.mark.parametrize(
    ("name", "place", "value", "detail"),
    [
        (JSON_NAME, ("sh_degree",), 4, "airgs.json.sh_degree: expected 0 to 3, got 4"),
        (
            JSON_NAME,
            ("qualities", 1, "factor"),
            0,
            "airgs.json.qualities[1].factor: expected 1e-06 to 1000000.0, got 0.0",
        ),
        (JSON_NAME, ("frame_rate",), [30], "airgs.json.frame_rate: expected 2 to 2 values, got 1"),
        (JSON_NAME, ("region", "turn"), 181, "airgs.json.region.turn: expected 0 to 180, got 181.0"),
        (
            JSON_NAME,
            ("views", "reference"),
            "film",
            "airgs.json.views.reference: expected one of original, none, got 'film'",
        ),
        (
            TABLE,
            ("segments", 0, "levels", 0, "ssim", 1),
            1.5,
            "group/1.json.gz.segments[0].levels[0].ssim[1]: expected -1 to 1, got 1.5",
        ),
        (
            TABLE,
            ("tiles", 0, "tiers", 0, "sidecar", "sha256"),
            "12",
            "group/1.json.gz.tiles[0].tiers[0].sidecar.sha256: expected a digest of 32 characters of base64url, "
            "got '12'",
        ),
    ],
)
def test_a_value_out_of_its_range_is_refused_by_reader_and_schema_alike(name, place, value, detail):
    with pytest.raises(FormatError) as caught:
        read(name, place, value)
    assert str(caught.value) == f"{detail} [bad_value]"
    schema = manifest_schema() if name == JSON_NAME else manifest_schema()["$defs"]["group"]
    changed = parse_table(apply(TABLES, set_value(place, value, name))[name])
    assert not jsonschema.Draft202012Validator(schema).is_valid(changed)


def test_a_table_that_would_fill_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr(packing, "MAX_TABLE_BYTES", 1000)
    with pytest.raises(FormatError) as caught:
        packing.inflate(gzip.compress(bytes(10**6)), TABLE)
    assert caught.value.reason == "too_large"


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version": NaN}', "nul", "[" * 100_000])
def test_what_is_not_a_table_is_refused(text):
    with pytest.raises(FormatError):
        parse_root(text)


def ids(m):
    return [[r.id for r in s.representations] for s in adaptation_sets(m)]


def test_the_mpd_has_a_representation_for_everything_that_has_files():
    m = open_package(CORPUS / "valid" / "moving").manifest
    assert [s.role for s in adaptation_sets(m)] == ["state", "key;tier=0", "key;tier=1"]
    assert ids(m) == [["L0", "L1"], ["T0/Q0", "T0/Q1"], ["T1/Q0", "T1/Q1"]]
    still = open_package(CORPUS / "valid" / "one-gaussian").manifest
    assert ids(still) == [["T0/Q0"]]


def test_bandwidth_covers_the_first_segment_within_the_minimum_buffer():
    m = open_package(CORPUS / "valid" / "two-groups-sh1").manifest
    text = write_mpd(m).decode()
    first = 8 * m.entry("state/L0/1.m4s").bytes
    assert int(text.split('id="L0"')[1].split('bandwidth="')[1].split('"')[0]) >= first


@given(st.binary(max_size=300))
@settings(deadline=None)
def test_any_bytes_as_an_mpd_are_refused(data):
    with pytest.raises(FormatError):
        check_mpd(data, open_package(CORPUS / "valid" / "two-groups-sh1").manifest)


@pytest.mark.ffmpeg
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="the ffmpeg command line is not installed")
@pytest.mark.parametrize("name", ["moving", "two-groups-sh1"])
def test_ffmpeg_reads_the_mpd_and_decodes_every_state_frame(name):
    package = open_package(CORPUS / "valid" / name)
    m = package.manifest
    for level in range(len(m.levels)):
        command = ["ffmpeg", "-v", "error", "-i", str((package.files.path / "manifest.mpd").resolve())]
        command += ["-map", f"0:v:{level}", "-f", "framemd5", "-"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        pictures = [line for line in done.stdout.splitlines() if not line.startswith("#")]
        expected = sum(s.stop - s.start for s in m.segments if s.levels[level].bytes)
        assert len(pictures) == expected
