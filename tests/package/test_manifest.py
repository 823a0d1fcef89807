"""The tables: strict reading, the schema, the conformance corpus, the MPD."""

import gzip
import json
import shutil
import subprocess
from datetime import UTC, datetime

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airgs_codec.package import parse
from airgs_codec.package.parse import parse_group
from tests.faces import (
    JSON_NAME,
    PAGE,
    FormatError,
    LiveClock,
    check_mpd,
    group_path,
    open_package,
    pack_group,
    pack_json,
    parse_root,
    root_of,
    validate,
    write_mpd,
)
from tests.makers.refusals import BREAKS, TABLE, changes, source_of
from tests.support.mutations import apply, parse_table, places, set_value
from tests.support.paths import CORPUS, REPOSITORY
from tests.support.refusals import cases, findings
from tools.schema import manifest_schema

VALID = sorted((CORPUS / "valid").iterdir())
CASES = cases()
TEXT = (CORPUS / "valid" / "two-groups-sh1" / "airgs.json").read_bytes()


def test_the_corpus_is_not_empty():
    assert len(VALID) >= 3 and len(CASES) >= 68


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


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_invalid_packages_are_refused_for_their_reason(case):
    found = findings(case.package())
    assert {f.reason for f in found} == {case.reason}
    assert found[0].where.removeprefix("package/") == case.where
    assert all("\n" not in str(f) for f in found)


def test_the_committed_cases_are_what_their_maker_makes_of_valid_packages():
    committed = {name: (case.base, case.files) for name, case in CASES.items()}
    assert committed == {name: (source_of(name), changes(name)) for name in BREAKS}


def test_every_reason_of_the_format_has_a_case_and_no_other():
    """But for what only the original shows."""
    table = (REPOSITORY / "FORMAT.md").read_text().split("| reason | meaning |")[1].split("\n\n")[0]
    reasons = {reason for row in table.splitlines()[2:] for reason in row.split("|")[1].strip().split(", ")}
    assert {case.reason for case in CASES.values()} == reasons - {"bound_exceeded"} != reasons


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
        assert not validator.is_valid(parse_table(CASES[name].package()[JSON_NAME])), name
    for name in ("unknown_field-group", "missing_field-group", "wrong_type-group"):
        assert not of_groups.is_valid(parse_table(CASES[name].package()[TABLE])), name


TABLES = {JSON_NAME: TEXT, TABLE: (CORPUS / "valid" / "two-groups-sh1" / TABLE).read_bytes()}
ROOT, ENTRY = parse_root(TEXT), open_package(CORPUS / "valid" / "two-groups-sh1").manifest.groups.places.entry(0)


def read(name, place, value):
    """A table of this name with one value changed, read."""
    data = apply(TABLES, set_value(place, value, name))[name]
    return parse_root(data) if name == JSON_NAME else parse_group(data, ROOT, ENTRY, 0)


@pytest.mark.parametrize("name", TABLES)
def test_any_value_of_a_table_is_read_or_refused_never_a_crash(name):
    """Every place, of lists the first part alone, with a value of every kind."""
    seen = set()
    for place in places(parse_table(TABLES[name])):
        if place and not any(isinstance(key, int) and key > 0 for key in place):
            for value in (None, -1, 0, 10**12, 1.5, "", "x", [], {}, True, [0], "NaN"):
                try:
                    read(name, place, value)
                except FormatError as error:
                    seen.add(error.reason)
                    assert error.where.startswith(name)
    assert {"wrong_type", "bad_value", "missing_field"} <= seen


@pytest.mark.parametrize(
    ("name", "place", "value"),
    [
        (TABLE, ("segments", 0, "levels", 0, "psnr"), [1e300, 40.0]),
        (TABLE, ("segments", 0, "levels", 0, "psnr"), [-1e300, 40.0]),
        (TABLE, ("segments", 0, "levels", 0, "worst"), [30.0]),
        (TABLE, ("segments", 0, "levels", 0, "ssim"), []),
        (TABLE, ("segments", 0, "levels", 0, "ssim"), [0.9, 7.0]),
        (TABLE, ("segments", 0, "levels", 0, "delta_e"), []),
        (TABLE, ("segments", 0, "levels", 0, "delta_e"), [0.5]),
        (TABLE, ("segments", 0, "levels", 0, "delta_e"), [-0.1, 0.1]),
        (TABLE, ("segments", 0, "levels", 0, "delta_e"), [0.5, 1e300]),
        (TABLE, ("segments", 0, "levels", 0, "file", "sha256"), ""),
        (TABLE, ("segments", 0, "levels", 0, "file"), {"bytes": 0, "sha256": "A" * 32}),
        (TABLE, ("segments", 0, "levels", 0, "frame_bytes"), [-1]),
        (TABLE, ("keeps",), 1),  # itself
        (TABLE, ("segments", 0, "stop"), 0),
        (TABLE, ("segments",), []),
        (TABLE, ("stop",), 4),
        (TABLE, ("levels", 0, "width"), 8),
        (TABLE, ("levels", 0, "height"), 0),
        (TABLE, ("levels", 0, "height"), 72),
        (TABLE, ("levels", 0, "plane_width"), 4096),
        (TABLE, ("levels", 0, "centres", 0), 2**31),
        (TABLE, ("tiers", 0, "qualities", 0, "width"), 4096 + 16),
        (TABLE, ("tiers", 0, "pictures"), []),
        (TABLE, ("tiers", 0, "qualities", 0, "planes"), []),
        (TABLE, ("tiers", 0, "qualities", 0, "centres", 0), 2**31 - 1),
        (JSON_NAME, ("levels", 0, "quality"), 2),  # there are Q0 and Q1
        (JSON_NAME, ("region", "places", 0, "up"), [0, 0.0, -0.0]),
        (JSON_NAME, ("qualities", 0, "coarser"), 1),
        (JSON_NAME, ("qualities", 1, "coarser"), 22),
        (JSON_NAME, ("timescale",), 30_001),  # at 30 frames a second
        (JSON_NAME, ("tiers",), 0),
        (JSON_NAME, ("tiers",), 1),
        (JSON_NAME, ("init", "sha256"), ""),
        (JSON_NAME, ("index",), []),
        (JSON_NAME, ("index", 0, "frames"), [5]),
        (JSON_NAME, ("index", 0, "frames", 0), 0),
        (JSON_NAME, ("index", 0, "sha256"), "A" * 33),
        (JSON_NAME, ("index",), [{"frames": [5], "segments": [2], "bytes": [9], "sha256": "A" * 32}] * 6),
    ],
)
def test_claims_that_cannot_be_true_are_refused(name, place, value):
    with pytest.raises(FormatError) as caught:
        read(name, place, value)
    assert caught.value.reason == "bad_value"


def test_a_segment_without_frames_is_refused():
    with pytest.raises(FormatError, match=r"segments\[0\]: expected a start at 0, got \[0, 0\)"):
        parse_group(apply(TABLES, set_value(("segments", 0, "stop"), 0, TABLE))[TABLE], ROOT, ENTRY, 0)


def test_a_digest_without_a_length_is_refused():
    level = ("segments", 0, "levels", 0)
    nothing = (("file",), {"bytes": 0, "sha256": "A" * 32}), (("frame_bytes",), [])
    with pytest.raises(FormatError, match="expected both a length and a digest or neither, got 0 and 'AAA"):
        parse_group(
            apply(TABLES, *(set_value(level + at, value, TABLE) for at, value in nothing))[TABLE], ROOT, ENTRY, 0
        )


def test_a_level_of_the_index_that_would_fill_a_page_is_refused():
    spans = {"frames": [1] * PAGE, "segments": [1] * PAGE, "bytes": [9] * PAGE, "sha256": "A" * 32 * PAGE}
    with pytest.raises(FormatError, match=f"expected at most {PAGE - 1} entries, got {PAGE}"):
        parse_root(apply(TABLES, set_value(("frames",), PAGE), set_value(("index",), [spans]))[JSON_NAME])


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
            ("tiers", 0, "sidecar", "sha256"),
            "12",
            "group/1.json.gz.tiers[0].sidecar.sha256: expected a digest of 32 characters of base64url, got '12'",
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
    monkeypatch.setattr(parse, "MAX_TABLE_BYTES", 1000)
    with pytest.raises(FormatError) as caught:
        parse.inflate(gzip.compress(bytes(10**6)), TABLE)
    assert caught.value.reason == "too_large"


@pytest.mark.parametrize("repairs", [b"[]," * (1 << 21) + b"1", b" " * (1 << 24) + b"1"], ids=["values", "bytes"])
def test_a_table_that_would_cost_far_more_than_its_file_is_refused_before_it_is_built(repairs, monkeypatch):
    text = apply(TABLES, set_value(("repairs",), [], TABLE))[TABLE]
    bomb = gzip.compress(gzip.decompress(text).replace(b'"repairs":[]', b'"repairs":[%s]' % repairs))
    assert len(bomb) < 50_000
    monkeypatch.setattr(parse.json, "loads", None)
    with pytest.raises(FormatError) as caught:
        parse_group(bomb, ROOT, ENTRY, 0)
    assert caught.value.reason == "too_large"


def test_a_whole_number_may_be_written_with_a_point():
    assert parse_root(apply(TABLES, set_value(("timescale",), 30000.0))[JSON_NAME]).timescale == 30000
    with pytest.raises(FormatError):
        parse_root(apply(TABLES, set_value(("timescale",), 30000.5))[JSON_NAME])


def test_half_of_a_surrogate_pair_is_no_text():
    with pytest.raises(FormatError) as caught:
        parse_root(TEXT.replace(b'"attribution":"', b'"attribution":"\\ud800'))
    assert (caught.value.reason, caught.value.where) == ("bad_value", "airgs.json.attribution")
    parse_root(TEXT.replace(b'"attribution":"', b'"attribution":"\\ud83e\\udd8a'))


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b'{"version": NaN}', b"nul", b"[" * 100_000])
def test_what_is_not_a_table_is_refused(text):
    with pytest.raises(FormatError):
        parse_root(text)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_json_is_utf_8_without_a_mark(encoding):
    """As in browsers: Python alone would read the others."""
    parse_root(TEXT)
    with pytest.raises(FormatError) as caught:
        parse_root(TEXT.decode().encode(encoding))
    assert caught.value.reason == "not_json"


@pytest.mark.parametrize("digits", [309, 400, 4000])
def test_a_number_that_fits_no_float_is_refused(digits):
    with pytest.raises(FormatError) as caught:
        parse_root(json.dumps(json.loads(TEXT) | {"key_gain": 10**digits}).encode())
    assert (caught.value.reason, caught.value.where) == ("bad_value", "airgs.json.key_gain")


@given(st.binary(max_size=300))
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
        shown = [(s.stop - s.start, s.levels[level]) for s in m.segments]
        expected = sum(frames + bool(state.line) for frames, state in shown if state.file.bytes)
        assert len(pictures) == expected
