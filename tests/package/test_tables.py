"""The tables: paths and channels as FORMAT.md has them, strict reading, the schema, the conformance corpus."""

import gzip
import json
import re
import shutil
import subprocess
from datetime import UTC, datetime

import jsonschema
import numpy as np
import pytest

from tests import faces
from tests.faces import DELTA, JSON_NAME, KEYFRAME, FileKind, FormatError, open_package, parse_group, parse_root
from tests.makers.refusals import BREAKS, PAGE_TABLE, TABLE, changes, source_of
from tests.support.mutations import apply, parse_table, places, set_value
from tests.support.paths import CORPUS, REPOSITORY
from tests.support.refusals import cases, findings
from tools.schema import manifest_schema

VALID = sorted((CORPUS / "valid").iterdir())
CASES = cases()
TWO = CORPUS / "valid" / "two-groups-sh1"
TEXT = (TWO / JSON_NAME).read_bytes()
TABLES = {JSON_NAME: TEXT, TABLE: (TWO / TABLE).read_bytes()}
ROOT, ENTRY = parse_root(TEXT), open_package(TWO).manifest.groups.places.entry(0)
FORMAT = (REPOSITORY / "FORMAT.md").read_text()
COLOURS = 12


def channels(text):
    """The channels that a cell such as `0–2`, `6` or `7 … 6 + C` names."""
    numbers = [int(number) for number in re.findall(r"\d+", text)]
    last = numbers[-1] + COLOURS if "C" in text else numbers[-1]
    return list(range(numbers[0], last + 1))


@pytest.mark.parametrize(
    ("layout", "steps"), [(KEYFRAME, "keyframe_steps"), (DELTA, "delta_steps")], ids=["keyframe", "delta"]
)
def test_the_format_lists_the_same_channels_in_the_same_order(layout, steps):
    """Rows of the table of key or delta channels have channels, value and step."""
    section = FORMAT.split("## 5.")[1].split("## 6.")[0]
    rows = section.split(f"| {layout.kind} channel |")[1].split("\n\n")[0].splitlines()[2:]
    index = layout.attribute_index(layout.width(COLOURS))
    for number, (row, attribute) in enumerate(zip(rows, layout.attributes, strict=True)):
        named, _, step = (cell.strip() for cell in row.strip("| ").split("|"))
        assert list(range(layout.width(COLOURS)))[layout.slice(attribute)] == channels(named)
        assert {layout.names(COLOURS)[channel] for channel in channels(named)} == {attribute}
        assert np.flatnonzero(index == number).tolist() == channels(named)
        assert step == ("1" if attribute == "colour" else f"`{steps}.{attribute}`")
    with pytest.raises(ValueError, match="colours"):
        layout.slice("colours")


@pytest.mark.parametrize(("path", "written", "kind", "place"), [
    (JSON_NAME, "airgs.json", FileKind.MANIFESTS, ("", ())),
    (faces.MPD_NAME, "manifest.mpd", FileKind.MANIFESTS, ("", ())),
    (faces.group_path(7200), "group/7200.json.gz", FileKind.MANIFESTS, ("group", (7200,))),
    (faces.page_path(2, 1), "index/2/1.json", FileKind.MANIFESTS, ("page", (2, 1))),
    (faces.INIT_NAME, "init.mp4", FileKind.INIT, ("", ())),
    (faces.keyframe_media_path(1, 12, 3), "keyframe/T1/Q12/3.m4s", FileKind.KEYFRAME, ("keyframe", (1, 12, 3))),
    (faces.delta_media_path(2, 3), "delta/L2/3.m4s", FileKind.DELTA, ("delta", (2, 3))),
    (faces.keyframe_sidecar_path(0, 30), "keyframe/T0/30.bin", FileKind.SIDECARS, ("sidecar", (0, 30))),
])  # fmt: skip
def test_what_a_file_carries_follows_from_its_path(path, written, kind, place):
    assert (path, faces.file_kind(path), faces.locate(path)) == (written, kind, place)


def test_other_paths_are_no_paths_of_a_package():
    others = "", "delta/L0/0.bin", "keyframe/T01/1.bin", "keyframe/T0/1.bin/..", "../keyframe/T0/1.bin"
    for path in (*others, "delta/L0/x.m4s", "group/1.json", "delta/P1/L0/1.m4s"):
        assert faces.locate(path) == ("", ()), path


@pytest.mark.parametrize("path", VALID, ids=lambda p: p.name)
def test_valid_packages_pass_and_survive_json(path):
    assert faces.validate(path) == []
    m = open_package(path).manifest
    assert faces.pack_json(faces.root_of(m)) == (path / JSON_NAME).read_bytes()
    for number, group in enumerate(m.groups, 1):
        assert faces.pack_group(group) == (path / f"group/{number}.json.gz").read_bytes()
    moment = datetime(2026, 1, 1, tzinfo=UTC)
    assert faces.write_mpd(m, faces.LiveClock(moment, moment)) == (path / "manifest.mpd").read_bytes()


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_invalid_packages_are_refused_for_their_reason(case):
    found = findings(case.package())
    assert {f.reason for f in found} == {case.reason} and found[0].where.removeprefix("package/") == case.where
    assert all("\n" not in str(f) for f in found)


def test_the_committed_cases_are_what_their_maker_makes_of_valid_packages():
    committed = {name: (case.base, case.files) for name, case in CASES.items()}
    assert committed == {name: (source_of(name), changes(name)) for name in BREAKS}


def test_every_reason_of_the_format_has_a_case_and_no_other():
    """But for what only the original shows."""
    table = FORMAT.split("| reason | meaning |")[1].split("\n\n")[0]
    reasons = {reason for row in table.splitlines()[2:] for reason in row.split("|")[1].strip().split(", ")}
    assert {case.reason for case in CASES.values()} == reasons - {"bound_exceeded"} != reasons
    assert len(VALID) >= 3 and len(CASES) >= 68


def is_valid(name, data):
    schema = manifest_schema()
    part = {JSON_NAME: schema, TABLE: schema["$defs"]["group"], PAGE_TABLE: schema["$defs"]["page"]}[name]
    return jsonschema.Draft202012Validator(part).is_valid(parse_table(data))


def test_the_committed_schema_is_the_generated_one_and_agrees_with_the_reader():
    assert json.loads((CORPUS / "airgs.schema.json").read_text()) == manifest_schema()
    jsonschema.Draft202012Validator.check_schema(manifest_schema())
    for path in VALID:
        names = (JSON_NAME, TABLE, PAGE_TABLE) if path.name == "paged" else (JSON_NAME, TABLE)
        assert all(is_valid(name, (path / name).read_bytes()) for name in names)
    for reason in ("unknown_field", "missing_field", "wrong_type", "unknown_version", "bad_value", "wrong_type-live"):
        assert not is_valid(JSON_NAME, CASES[reason].package()[JSON_NAME]), reason
    for reason in ("unknown_field-group", "missing_field-group", "wrong_type-group"):
        assert not is_valid(TABLE, CASES[reason].package()[TABLE]), reason


def changed(name, values):
    """The bytes of a table with other values at places such as `levels.0.tiers`."""
    keys = {tuple(int(key) if key.isdigit() else key for key in place.split(".")): v for place, v in values.items()}
    return apply(TABLES, *(set_value(place, value, name) for place, value in keys.items()))[name]


def read(name, data):
    return parse_root(data) if name == JSON_NAME else parse_group(data, ROOT, ENTRY, 0)


@pytest.mark.parametrize("name", TABLES)
def test_any_value_of_a_table_is_read_or_refused_never_a_crash(name):
    """Every place, of lists the first part alone, with a value of every kind."""
    seen = set()
    for place in places(parse_table(TABLES[name])):
        if place and not any(isinstance(key, int) and key > 0 for key in place):
            for value in (None, -1, 0, 10**12, 1.5, "", "x", [], {}, True, [0], "NaN"):
                try:
                    read(name, apply(TABLES, set_value(place, value, name))[name])
                except FormatError as error:
                    seen.add(error.reason)
                    assert error.where.startswith(name)
    assert {"wrong_type", "bad_value", "missing_field"} <= seen


LEVEL = "segments.0.levels.0"
PAGEFUL = {"frames": [1] * 64, "segments": [1] * 64, "bytes": [9] * 64, "sha256": "A" * 32 * 64}
HIGH = [{"frames": [5], "segments": [2], "bytes": [9], "sha256": "A" * 32}] * 6


@pytest.mark.parametrize(("name", "values", "words"), [
    *((TABLE, {f"{LEVEL}.psnr": [db, 40.0]}, "psnr") for db in (1e300, -1e300)),
    *((JSON_NAME, {"rungs": rungs}, "rungs") for rungs in ([], [[]], [[], []])),
    *((TABLE, {f"{LEVEL}.delta_e": e}, "delta_e") for e in ([], [0.5], [-0.1, 0.1], [0.5, 1e300])),
    (TABLE, {f"{LEVEL}.file.sha256": ""}, "file"),
    (TABLE, {f"{LEVEL}.file": {"bytes": 0, "sha256": "A" * 32}}, ""),
    (TABLE, {f"{LEVEL}.file": {"bytes": 0, "sha256": "A" * 32}, f"{LEVEL}.frame_bytes": []},
     "expected both a length and a digest or neither, got 0 and 'AAA"),
    (TABLE, {f"{LEVEL}.frame_bytes": [-1]}, "frame_bytes"),
    (TABLE, {"base": 1}, "centres"),  # its pictures are no differences
    (TABLE, {"segments.0.stop": 0}, "segments[0]: expected a start at 0, got [0, 0)"),
    (TABLE, {"segments": []}, ""),
    *((TABLE, {"stop": stop}, "") for stop in (4, 10**6)),
    *((TABLE, {place: 1 << 24}, "") for place in ("count", "tiers.0.count")),
    (TABLE, {"levels.0.width": 8}, "width"),
    *((TABLE, {"levels.0.height": height}, "height") for height in (0, 72)),
    (TABLE, {"levels.0.plane_width": 4096}, "width"),
    (TABLE, {"levels.0.centres.0": 2**31}, "centres"),
    (TABLE, {"tiers.0.qualities.0.width": 4096 + 16}, "width"),
    (TABLE, {"tiers.0.pictures": []}, "pictures"),
    (TABLE, {"tiers.0.qualities.0.planes": []}, "planes"),
    (TABLE, {"tiers.0.qualities.0.centres.0": 2**31 - 1}, "centres"),
    (JSON_NAME, {"levels.0.quality": 2}, "quality"),  # there are Q0 and Q1
    (JSON_NAME, {"region.places.0.up": [0, 0.0, -0.0]}, "up"),
    (JSON_NAME, {"qualities.0.coarser": 1}, "coarser"),
    (JSON_NAME, {"qualities.1.coarser": 22}, "coarser"),
    (JSON_NAME, {"timescale": 30_001}, "timescale"),  # at 30 frames a second
    *((JSON_NAME, {"tiers": tiers}, "tiers") for tiers in (0, 1)),
    (JSON_NAME, {"init.sha256": ""}, "init"),
    (JSON_NAME, {"index": []}, "index"),
    (JSON_NAME, {"index.0.frames": [5]}, "index[0]"),
    (JSON_NAME, {"index.0.frames.0": 0}, "index[0]"),
    (JSON_NAME, {"index.0.sha256": "A" * 33}, "index[0]"),
    (JSON_NAME, {"index": HIGH}, "index"),
    (JSON_NAME, {"frames": 64, "index": [PAGEFUL]}, "expected at most 63 entries, got 64"),
])  # fmt: skip
def test_claims_that_cannot_be_true_are_refused(name, values, words):
    with pytest.raises(FormatError) as caught:
        read(name, changed(name, values))
    assert caught.value.reason == "bad_value" and words in str(caught.value)


@pytest.mark.parametrize(("name", "place", "value", "detail"), [
    (JSON_NAME, "sh_degree", 4, ".sh_degree: expected 0 to 3, got 4"),
    (JSON_NAME, "qualities.1.factor", 0, ".qualities[1].factor: expected 1e-06 to 1000000.0, got 0.0"),
    (JSON_NAME, "frame_rate", [30], ".frame_rate: expected 2 to 2 values, got 1"),
    (JSON_NAME, "region.turn", 181, ".region.turn: expected 0 to 180, got 181.0"),
    (JSON_NAME, "views.reference", "film", ".views.reference: expected one of original, none, got 'film'"),
    (JSON_NAME, "rungs.1.0.ssim", 1.5, ".rungs[1][0].ssim: expected -1 to 1, got 1.5"),
    (TABLE, "tiers.0.sidecar.sha256", "12",
     ".tiers[0].sidecar.sha256: expected a digest of 32 characters of base64url, got '12'"),
])  # fmt: skip
def test_a_value_out_of_its_range_is_refused_by_reader_and_schema_alike(name, place, value, detail):
    data = changed(name, {place: value})
    with pytest.raises(FormatError) as caught:
        read(name, data)
    assert str(caught.value) == f"{name}{detail} [bad_value]"
    assert not is_valid(name, data)


@pytest.mark.parametrize("repairs", [b"[]," * (1 << 21) + b"1", b" " * (1 << 24) + b"1"], ids=["values", "bytes"])
def test_a_table_that_would_cost_far_more_than_its_file_is_refused_before_it_is_built(repairs, monkeypatch):
    text = gzip.decompress(changed(TABLE, {"repairs": []}))
    bomb = gzip.compress(text.replace(b'"repairs":[]', b'"repairs":[%s]' % repairs))
    assert len(bomb) < 50_000
    monkeypatch.setattr("airgs_codec.package.parse.json.loads", None)
    with pytest.raises(FormatError) as caught:
        read(TABLE, bomb)
    assert caught.value.reason == "too_large"


@pytest.mark.parametrize(("text", "reason", "where"), [
    *((text, "not_json", "") for text in (b"", b"{", b'{"version": NaN}', b"nul", b"[" * 100_000)),
    # JSON is UTF-8 without a mark, as in browsers: Python alone would read the others.
    *((TEXT.decode().encode(encoding), "not_json", "") for encoding in ("utf-8-sig", "utf-16", "utf-32")),
    (b"[]", "wrong_type", ""),
    (changed(JSON_NAME, {"timescale": 30000.5}), "wrong_type", ".timescale"),
    *((changed(JSON_NAME, {"keyframe_gain": 10**n}), "bad_value", ".keyframe_gain") for n in (309, 400, 4000)),
    (changed(JSON_NAME, {"attribution": "\ud800"}), "bad_value", ".attribution"),  # half of a surrogate pair
])  # fmt: skip
def test_what_is_not_a_table_is_refused(text, reason, where):
    with pytest.raises(FormatError) as caught:
        parse_root(text)
    assert (caught.value.reason, caught.value.where) == (reason, JSON_NAME + where)


def test_a_whole_number_may_have_a_point_and_text_a_surrogate_pair():
    assert parse_root(changed(JSON_NAME, {"timescale": 30000.0})).timescale == 30000
    assert parse_root(changed(JSON_NAME, {"attribution": "\U0001f98a"})).attribution == "\U0001f98a"


@pytest.mark.ffmpeg
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="the ffmpeg command line is not installed")
@pytest.mark.parametrize("name", ["moving", "two-groups-sh1"])
def test_ffmpeg_reads_the_mpd_and_decodes_every_delta_frame(name):
    package = open_package(CORPUS / "valid" / name)
    m = package.manifest
    for level in range(len(m.levels)):
        command = ["ffmpeg", "-v", "error", "-i", str((package.files.path / "manifest.mpd").resolve())]
        command += ["-map", f"0:v:{level}", "-f", "framemd5", "-"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        pictures = [line for line in done.stdout.splitlines() if not line.startswith("#")]
        shown = [(s.stop - s.start, s.levels[level]) for s in m.segments]
        expected = sum(frames + bool(state.slopes) for frames, state in shown if state.file.bytes)
        assert len(pictures) == expected
