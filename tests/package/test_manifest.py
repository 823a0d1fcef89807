"""airgs.json: strict reading, the schema, the conformance corpus, the MPD."""

import json
import shutil
import subprocess

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.errors import FormatError
from airgs_codec.inspect.validate import validate
from airgs_codec.package.mpd import adaptation_sets, write_mpd
from airgs_codec.package.mpd_check import check_mpd
from airgs_codec.package.parse import parse_manifest
from airgs_codec.package.schema import manifest_schema
from airgs_codec.package.store import open_package
from airgs_codec.package.tables import JSON_NAME
from tests.makers.conformance import BREAKS
from tests.support.mutations import apply, places, read_files, set_value
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
    assert parse_manifest(m.to_json()) == m
    assert write_mpd(m) == (path / "manifest.mpd").read_bytes()


@pytest.mark.parametrize("path", INVALID, ids=lambda p: p.name)
def test_invalid_packages_are_refused_for_their_reason(path):
    findings = validate(path)
    assert {f.reason for f in findings} == {path.name}
    assert all("\n" not in str(f) for f in findings)


def test_the_committed_corpus_is_what_its_maker_makes_of_a_valid_package():
    assert {path.name for path in INVALID} == BREAKS.keys()
    for path in INVALID:
        assert read_files(path) == apply(read_files(CORPUS / "valid" / "moving"), *BREAKS[path.name]), path.name


def test_every_reason_of_the_corpus_is_in_the_format():
    text = (CORPUS.parent / "FORMAT.md").read_text()
    assert [p.name for p in INVALID if p.name not in text] == []


def test_the_committed_schema_is_the_generated_one():
    assert json.loads((CORPUS / "airgs.schema.json").read_text()) == manifest_schema()


def test_the_schema_agrees_with_the_reader():
    jsonschema.Draft202012Validator.check_schema(manifest_schema())
    validator = jsonschema.Draft202012Validator(manifest_schema())
    for path in VALID:
        validator.validate(json.loads((path / "airgs.json").read_text()))
    for name in ("unknown_field", "missing_field", "wrong_type", "unknown_version", "bad_value", "unsafe_path"):
        assert not validator.is_valid(json.loads((CORPUS / "invalid" / name / "airgs.json").read_text())), name


PLACES = [p for p in places(json.loads(TEXT)) if p]


@given(
    place=st.sampled_from(PLACES), value=st.sampled_from([None, -1, 0, 10**12, 1.5, "", "x", [], {}, True, [0], "NaN"])
)
@settings(max_examples=300)
def test_a_mutated_table_is_read_or_refused_never_a_crash(place, value):
    try:
        parse_manifest(set_in(place, value))
    except FormatError as error:
        assert error.reason and error.where.startswith("airgs.json")


def set_in(place, value):
    """The text of a valid table with one value changed."""
    return apply({JSON_NAME: TEXT}, set_value(place, value))[JSON_NAME]


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("segments", 0, "levels", 0, "psnr"), [1e300, 40.0]),
        (("segments", 0, "levels", 0, "worst"), [30.0]),
        (("segments", 0, "levels", 0, "ssim"), []),
        (("segments", 0, "levels", 0, "delta_e"), []),
        (("segments", 0, "levels", 0, "delta_e"), [-0.1, 0.1]),
        (("segments", 0, "levels", 0, "number"), 2),
        (("levels", 0, "quality"), 2),  # there are Q0 and Q1
        (("region", "places", 0, "up"), [0, 0.0, -0.0]),
        (("groups", 0, "tiers", 0, "qualities", 0, "centres", 0), 2**31 - 1),
        (("qualities", 0, "coarser"), 1),
        (("qualities", 1, "coarser"), 22),
        (("segments", 0, "levels", 0, "frame_bytes"), [-1, 5]),
    ],
)
def test_claims_that_cannot_be_true_are_refused(place, value):
    with pytest.raises(FormatError) as caught:
        parse_manifest(set_in(place, value))
    assert caught.value.reason == "bad_value"


@pytest.mark.parametrize(
    ("place", "value", "detail"),
    [
        (("sh_degree",), 4, "airgs.json.sh_degree: expected 0 to 3, got 4"),
        (("qualities", 1, "factor"), 0, "airgs.json.qualities[1].factor: expected 1e-06 to 1000000.0, got 0.0"),
        (("frame_rate",), [30], "airgs.json.frame_rate: expected 2 to 2 values, got 1"),
        (("region", "turn"), 181, "airgs.json.region.turn: expected 0 to 180, got 181.0"),
        (("views", "reference"), "film", "airgs.json.views.reference: expected one of original, none, got 'film'"),
        (
            ("segments", 0, "levels", 0, "ssim", 1),
            1.5,
            "airgs.json.segments[0].levels[0].ssim[1]: expected -1 to 1, got 1.5",
        ),
        (
            ("files", "key/T0/1.bin", "sha256"),
            "12",
            "airgs.json.files['key/T0/1.bin'].sha256: expected SHA-256 as 43 characters of base64url, got '12'",
        ),
    ],
)
def test_a_value_out_of_its_range_is_refused_by_reader_and_schema_alike(place, value, detail):
    text = set_in(place, value)
    with pytest.raises(FormatError) as caught:
        parse_manifest(text)
    assert str(caught.value) == f"{detail} [bad_value]"
    assert not jsonschema.Draft202012Validator(manifest_schema()).is_valid(json.loads(text))


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version": NaN}', "nul", "[" * 100_000])
def test_what_is_not_a_table_is_refused(text):
    with pytest.raises(FormatError):
        parse_manifest(text)


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
    first = 8 * m.files["state/L0/1.m4s"].bytes
    assert int(text.split('id="L0"')[1].split('bandwidth="')[1].split('"')[0]) >= first


@given(st.binary(max_size=300))
def test_any_bytes_as_an_mpd_are_refused(data):
    with pytest.raises(FormatError):
        check_mpd(data, parse_manifest(TEXT))


@pytest.mark.ffmpeg
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="the ffmpeg command line is not installed")
@pytest.mark.parametrize("name", ["moving", "two-groups-sh1"])
def test_ffmpeg_reads_the_mpd_and_decodes_every_state_frame(name):
    package = open_package(CORPUS / "valid" / name)
    m = package.manifest
    for level in range(len(m.levels)):
        command = ["ffmpeg", "-v", "error", "-i", str((package.path / "manifest.mpd").resolve())]
        command += ["-map", f"0:v:{level}", "-f", "framemd5", "-"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        pictures = [line for line in done.stdout.splitlines() if not line.startswith("#")]
        expected = sum(s.stop - s.start for s in m.segments if s.levels[level].number)
        assert len(pictures) == expected
