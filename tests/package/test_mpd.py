"""The MPD: bandwidth by its definition, gaps, and refusal of everything that would lead a player elsewhere."""

import copy
import dataclasses
import io
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from datetime import UTC, datetime
from fractions import Fraction

import av
import pytest

from airgs_codec.media.mp4 import init_segment
from airgs_codec.package.mpd import DASH, MIN_BUFFER_S, Run
from tests.faces import (
    MPD_NAME,
    NO_FILE,
    ConfigError,
    FormatError,
    LiveClock,
    Manifest,
    Streams,
    check_mpd,
    still_files,
    write_mpd,
)
from tests.support.manifests import tiny_manifest, with_segments
from tests.support.mutations import apply, edit_text

NS = f"{{{DASH}}}"


def with_a_still_segment(levels: Sequence[int] = (0, 1, 2), number: int = 1) -> Manifest:
    """Three groups; in these levels nothing moves in one of them, so that it has no files of them."""
    m = tiny_manifest(groups=(10, 5, 10))
    segments = list(m.segments)
    still = [
        dataclasses.replace(v, file=NO_FILE, frame_bytes=[]) if j in levels else v
        for j, v in enumerate(segments[number].levels)
    ]
    segments[number] = dataclasses.replace(segments[number], levels=still)
    return with_segments(m, segments)


MANIFESTS = {
    "equal groups": tiny_manifest(),
    "unequal groups": tiny_manifest(groups=(10, 10, 3, 20, 20, 7)),
    "a level without files": tiny_manifest(state_bytes=(2000, 0)),
    "still segments": with_a_still_segment(),
    "a still segment of one level": with_a_still_segment(levels=[2]),
    "a late level": with_a_still_segment(levels=[2], number=0),
}


def representations(m):
    return [s.representations for s in Streams.of(m).sets()]


def reason_of(data: bytes, m: Manifest) -> str:
    with pytest.raises(FormatError) as refused:
        check_mpd(data, m)
    assert "\n" not in str(refused.value)
    return refused.value.reason


@pytest.mark.parametrize("m", MANIFESTS.values(), ids=MANIFESTS)
def test_what_is_written_is_accepted(m):
    check_mpd(write_mpd(m), m)


def spelt_out(data: bytes) -> bytes:
    """The same MPD with nothing inherited and every file in an S of its own."""
    root = ET.fromstring(data)
    for row in root.iter(f"{NS}AdaptationSet"):
        shared = row.findall(f"{NS}SegmentTemplate")
        for element in row.iter(f"{NS}Representation"):
            element.extend(copy.deepcopy(shared))
        for template in shared:
            row.remove(template)
    starts = {template[0]: int(template.attrib["startNumber"]) for template in root.iter(f"{NS}SegmentTemplate")}
    for timeline in root.iter(f"{NS}SegmentTimeline"):
        files, end, number = [], 0, starts[timeline]
        for s in timeline:
            end, number = int(s.get("t", end)), int(s.get("n", number))
            for _ in range(1 + int(s.get("r", "0"))):
                files.append(ET.Element(f"{NS}S", t=str(end), n=str(number), d=s.attrib["d"]))
                end, number = end + int(s.attrib["d"]), number + 1
        timeline[:] = files
    return ET.tostring(root)


@pytest.mark.parametrize("m", MANIFESTS.values(), ids=MANIFESTS)
def test_what_is_inherited_may_also_be_spelt_out(m):
    check_mpd(spelt_out(write_mpd(m)), m)


ALL, LATE = (
    [{"t": "0", "d": "1000"}, {"d": "500"}, {"d": "1000"}],
    [{"t": "1000", "d": "500"}, {"d": "1000"}],
)


@pytest.mark.parametrize(
    ("name", "shared", "own"),
    [
        ("equal groups", [[{"t": "0", "d": "1000", "r": "1"}]], []),
        (
            "unequal groups",
            [[{"t": "0", "d": "1000", "r": "1"}, {"d": "300"}, {"d": "2000", "r": "1"}, {"d": "700"}]],
            [],
        ),
        ("still segments", [ALL], []),
        ("a still segment of one level", [ALL], []),
        ("a late level", [], [ALL, ALL, LATE]),
    ],
)
def test_equal_timelines_stand_once_in_the_set_and_others_in_each_representation(name, shared, own):
    state = ET.fromstring(write_mpd(MANIFESTS[name])).find(f"{NS}Period/{NS}AdaptationSet")
    timeline = f"{NS}SegmentTemplate/{NS}SegmentTimeline"
    assert [[s.attrib for s in t] for t in state.findall(timeline)] == shared
    assert [[s.attrib for s in t] for t in state.findall(f"{NS}Representation/{timeline}")] == own


CLOCK = LiveClock(datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 1, 1, 0, 1, tzinfo=UTC))


def test_a_growing_package_names_its_time():
    m = dataclasses.replace(tiny_manifest(), live=True)
    with pytest.raises(ConfigError, match="available"):
        write_mpd(m)
    assert reason_of(write_mpd(tiny_manifest()), m) == "mpd_mismatch"
    assert reason_of(write_mpd(m, CLOCK), tiny_manifest()) == "mpd_mismatch"
    text = write_mpd(m, CLOCK).decode()
    assert 'availabilityStartTime="2026-01-01T00:00:00+00:00"' in text and "mediaPresentationDuration" not in text
    assert reason_of(text.replace("availabilityStartTime", "x").encode(), m) == "bad_mpd"


def test_a_regular_sequence_makes_no_longer_mpd():
    short, long = (len(write_mpd(tiny_manifest(groups=(10,) * n))) for n in (10, 1000))
    assert long - short < 50


def test_a_still_segment_leaves_no_gap_in_a_timeline():
    """Files are numbered as shaka and dash.js number them: from startNumber on, one after the other."""
    m = with_a_still_segment()
    state, tier, _ = representations(m)
    assert state[0].timeline == tier[0].timeline == (Run(1, 0, 1000), Run(2, 1000, 500), Run(3, 1500, 1000))
    assert not [s for s in ET.fromstring(write_mpd(m)).iter(f"{NS}S") if s.get("n") or s.get("t", "0") != "0"]


def test_a_still_file_is_a_picture_for_as_long_as_nothing_moves():
    stills = dict(still_files(with_a_still_segment()))
    assert list(stills) == ["state/L0/2.m4s", "state/L1/2.m4s", "state/L2/2.m4s"]
    media = stills["state/L1/2.m4s"]
    with av.open(io.BytesIO(init_segment(1000, 64, 64) + media)) as container:
        (frame,) = container.decode(video=0)
        stream = container.streams.video[0]
        assert (frame.pts, stream.time_base, frame.duration) == (1000, Fraction(1, 1000), 500)
    assert (frame.width, frame.height) == (64, 64) and (frame.to_ndarray()[:64] == 128).all()


def test_nothing_stands_for_a_level_before_its_first_file():
    m = MANIFESTS["a late level"]
    assert representations(m)[0][2].timeline == (Run(2, 1000, 500), Run(3, 1500, 1000)) and not list(still_files(m))


def test_growing_and_whole_packages_have_the_same_still_files():
    m = with_a_still_segment()
    streams = Streams(m)
    assert [list(streams.add(group)) for group in m.groups][1] == [path for path, _ in still_files(m)]


def test_a_growing_package_says_whose_clock_counts():
    m = dataclasses.replace(tiny_manifest(), live=True)
    data = write_mpd(m, LiveClock(datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 1, 1, tzinfo=UTC)))
    (timing,) = ET.fromstring(data).iter(f"{NS}UTCTiming")
    assert (timing.get("schemeIdUri"), timing.get("value")) == ("urn:mpeg:dash:utc:http-head:2014", MPD_NAME)
    assert reason_of(data.replace(b'value="manifest.mpd"', b'value="http://clock.example/"'), m) == "foreign_url"
    assert b"UTCTiming" not in write_mpd(dataclasses.replace(m, live=False))


def test_a_level_without_files_is_not_listed():
    assert [r.id for r in representations(tiny_manifest(state_bytes=(2000, 0)))[0]] == ["L0"]
    assert [row[0].id for row in representations(tiny_manifest(state_bytes=(0, 0)))] == ["T0/Q0", "T1/Q0"]


@pytest.mark.parametrize("m", [tiny_manifest(groups=(10, 3, 20, 7)), with_a_still_segment()])
def test_every_run_of_segments_fits_its_bandwidth(m):
    root = ET.fromstring(write_mpd(m))
    stated = {r.get("id"): int(r.get("bandwidth", "0")) for r in root.iter(f"{NS}Representation")}
    stills = dict(still_files(m))
    for row in representations(m):
        for r in row:
            files = [(run.number + i, run.start + i * run.duration) for run in r.timeline for i in range(run.count)]
            starts = [start / m.timescale for _, start in files]
            paths = [r.media.replace("$Number$", str(number)) for number, _ in files]
            sizes = [8 * (len(stills[path]) if path in stills else m.entry(path).bytes) for path in paths]
            needed = max(
                sum(sizes[a : b + 1]) / (MIN_BUFFER_S + starts[b] - starts[a])
                for a in range(len(starts))
                for b in range(a, len(starts))
            )
            assert needed <= stated[r.id]


ELSEWHERE = '<SegmentTemplate media="http://example.com/$Number$.m4s"/>'
EDITS = {
    "doctype": ("<MPD", '<!DOCTYPE MPD [<!ENTITY a "b">]><MPD', "doctype"),
    "doctype in small letters": ("<MPD", "<!doctype MPD><MPD", "doctype"),
    "another encoding": ('encoding="utf-8"', 'encoding="utf-7"', "bad_mpd"),
    "location": ("<Period", "<Location>http://example.com/a.mpd</Location><Period", "foreign_url"),
    "base address": ("<AdaptationSet", "<BaseURL>http://example.com/</BaseURL><AdaptationSet", "foreign_url"),
    "xlink": (
        "<AdaptationSet",
        '<AdaptationSet xmlns:x="http://www.w3.org/1999/xlink" x:href="http://example.com/"',
        "foreign_url",
    ),
    "parent folder": ('media="state/', 'media="../state/', "foreign_url"),
    "absolute path": ('initialization="', 'initialization="/', "foreign_url"),
    "another file": ('media="state/$RepresentationID$/', 'media="state/L1/', "mpd_mismatch"),
    "segment list": ("<SegmentTemplate", "<SegmentList/><SegmentTemplate", "bad_mpd"),
    "template elsewhere": ("</SegmentTemplate>", "</SegmentTemplate>" + ELSEWHERE, "foreign_url"),
    "second template": ("</SegmentTemplate>", "</SegmentTemplate><SegmentTemplate/>", "bad_mpd"),
    "offset": ('startNumber="1"', 'startNumber="1" presentationTimeOffset="9"', "bad_mpd"),
    "second timeline": ("</SegmentTimeline>", "</SegmentTimeline><SegmentTimeline/>", "bad_mpd"),
    "more files": (' r="1"', ' r="2"', "mpd_mismatch"),
    "fewer files": (' r="1"', "", "mpd_mismatch"),
    "files without end": (' r="1"', ' r="-1"', "bad_mpd"),
    "files without number": (' r="1"', ' r="999999999999999"', "mpd_mismatch"),
    "element without a namespace": ("<Period", '<x xmlns=""/><Period', "bad_mpd"),
    "foreign element": ("<Period", '<x xmlns="urn:x"/><Period', "bad_mpd"),
    "same id twice": ('id="L1"', 'id="L0"', "bad_mpd"),
    "unknown id": ('id="L1"', 'id="L9"', "mpd_mismatch"),
    "no number": (' d="1000"', ' d="long"', "bad_mpd"),
    "another init segment": ('initialization="init.mp4"', 'initialization="other.mp4"', "mpd_mismatch"),
    "start number": ('startNumber="1"', 'startNumber="0"', "mpd_mismatch"),
    "duration": ('mediaPresentationDuration="PT', 'mediaPresentationDuration="PT9', "mpd_mismatch"),
    "odd duration": ('mediaPresentationDuration="PT', 'mediaPresentationDuration="P1DT', "bad_mpd"),
    "live": ('type="static"', 'type="dynamic"', "mpd_mismatch"),
    "codecs": ('codecs="avc3.640033"', 'codecs="avc3.64003E"', "mpd_mismatch"),
    "late": ('start="PT0S"', 'start="PT9S"', "mpd_mismatch"),
    "long buffer": ('minBufferTime="PT1S"', 'minBufferTime="PT100000S"', "mpd_mismatch"),
    "no bandwidth": (' bandwidth="', ' x="', "bad_mpd"),
    "one set": ('<AdaptationSet id="2"', '<AdaptationSet id="9"', None),
}


@pytest.mark.parametrize("name", EDITS)
def test_an_mpd_that_leads_elsewhere_is_refused(name):
    m = tiny_manifest()
    old, new, reason = EDITS[name]
    data = apply({MPD_NAME: write_mpd(m)}, edit_text(MPD_NAME, old, new))[MPD_NAME]
    if reason is None:  # ids of sets are free
        check_mpd(data, m)
    else:
        assert reason_of(data, m) == reason


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32"])
def test_a_doctype_cannot_hide_in_another_encoding(encoding):
    m = tiny_manifest()
    text = write_mpd(m).decode().replace("<MPD", '<!DOCTYPE MPD [<!ENTITY a "b">]><MPD')
    assert reason_of(text.replace("utf-8", encoding).encode(encoding), m) in ("bad_mpd", "doctype")


def test_a_template_in_the_set_and_one_in_its_representation_are_refused():
    m = tiny_manifest()
    root = ET.fromstring(write_mpd(m))
    state = root.find(f"{NS}Period/{NS}AdaptationSet")
    state.find(f"{NS}Representation").append(copy.deepcopy(state.find(f"{NS}SegmentTemplate")))
    assert reason_of(ET.tostring(root), m) == "bad_mpd"


def test_without_a_template_nothing_plays():
    m = tiny_manifest()
    root = ET.fromstring(write_mpd(m))
    state = root.find(f"{NS}Period/{NS}AdaptationSet")
    state.remove(state.find(f"{NS}SegmentTemplate"))
    assert reason_of(ET.tostring(root), m) == "bad_mpd"


def test_a_level_in_the_set_of_a_key_tier_is_refused():
    m = tiny_manifest()
    root = ET.fromstring(write_mpd(m))
    state, key = root.findall(f"{NS}Period/{NS}AdaptationSet")[:2]
    moved = state.findall(f"{NS}Representation")[-1]
    state.remove(moved)
    key.append(moved)
    assert reason_of(ET.tostring(root), m) == "mpd_mismatch"


def test_nested_elements_do_not_overflow():
    assert reason_of(b"<a>" * 100_000 + b"</a>" * 100_000, tiny_manifest()) == "bad_mpd"
