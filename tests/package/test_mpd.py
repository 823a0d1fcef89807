"""The MPD: bandwidth by its definition, gaps, and refusal of everything that would lead a player elsewhere."""

import copy
import io
import xml.etree.ElementTree as ET
from dataclasses import replace
from datetime import UTC, datetime
from fractions import Fraction

import av
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from airgs_codec.media.mp4 import init_segment
from tests.faces import NO_FILE, ConfigError, FormatError, LiveClock, Streams, check_mpd, still_files, write_mpd
from tests.support.manifests import tiny_manifest, with_segments
from tests.support.mutations import apply, edit_text

NS = "{urn:mpeg:dash:schema:mpd:2011}"
DELTA_SET = f"{NS}Period/{NS}AdaptationSet"


def with_a_still_segment(levels=(0, 1, 2), number=1):
    """Three groups; in these levels nothing moves in one of them, so that it has no files of them."""
    m = tiny_manifest(groups=(10, 5, 10))
    segments = list(m.segments)
    there = enumerate(segments[number].levels)
    still = [replace(level, file=NO_FILE, frame_bytes=[]) if j in levels else level for j, level in there]
    segments[number] = replace(segments[number], levels=still)
    return with_segments(m, segments)


TINY = tiny_manifest()
LIVE = replace(TINY, live=True)
STILL, LATE = with_a_still_segment(), with_a_still_segment(levels=[2], number=0)
TWO = [{"t": "0", "d": "1000", "r": "1"}]
ALL = [{"t": "0", "d": "1000"}, {"d": "500"}, {"d": "1000"}]
MANIFESTS = {  # and the timelines of their deltas: in the set, and in each representation
    "equal groups": (TINY, [TWO], []),
    "unequal groups": (tiny_manifest(groups=(10, 10, 3, 20, 20, 7)),
                       [[*TWO, {"d": "300"}, {"d": "2000", "r": "1"}, {"d": "700"}]], []),
    "a level without files": (tiny_manifest(delta_bytes=(2000, 0)), [TWO], []),
    "still segments": (STILL, [ALL], []),
    "a still segment of one level": (with_a_still_segment(levels=[2]), [ALL], []),
    "a late level": (LATE, [], [ALL, ALL, [{"t": "1000", "d": "500"}, {"d": "1000"}]]),
}  # fmt: skip


def files_of(representation):
    runs = representation.timeline
    return [(run.number + i, run.start + i * run.duration, run.duration) for run in runs for i in range(run.count)]


def reason_of(data, m=TINY):
    with pytest.raises(FormatError) as refused:
        check_mpd(data, m)
    assert "\n" not in str(refused.value)
    return refused.value.reason


@pytest.mark.parametrize(("m", "shared", "own"), MANIFESTS.values(), ids=MANIFESTS)
def test_equal_timelines_stand_once_in_the_set_and_others_in_each_representation(m, shared, own):
    delta = ET.fromstring(write_mpd(m)).find(DELTA_SET)
    timeline = f"{NS}SegmentTemplate/{NS}SegmentTimeline"
    assert [[s.attrib for s in t] for t in delta.findall(timeline)] == shared
    assert [[s.attrib for s in t] for t in delta.findall(f"{NS}Representation/{timeline}")] == own


@pytest.mark.parametrize("m", [m for m, *_ in MANIFESTS.values()], ids=MANIFESTS)
def test_what_is_written_is_accepted_and_so_with_nothing_inherited_and_sets_and_files_spelt_out(m):
    check_mpd(write_mpd(m), m)
    root = ET.fromstring(write_mpd(m))
    for row in root.iter(f"{NS}AdaptationSet"):
        row.set("id", "9" + row.attrib["id"])  # ids of sets are free
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
    check_mpd(ET.tostring(root), m)


def test_a_growing_package_names_its_time_and_whose_clock_counts():
    with pytest.raises(ConfigError, match="available"):
        write_mpd(LIVE)
    data = write_mpd(LIVE, LiveClock(datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 1, 1, 0, 1, tzinfo=UTC)))
    assert reason_of(write_mpd(TINY), LIVE) == "mpd_mismatch" == reason_of(data, TINY)
    assert b'availabilityStartTime="2026-01-01T00:00:00+00:00"' in data and b"mediaPresentationDuration" not in data
    assert reason_of(data.replace(b"availabilityStartTime", b"x"), LIVE) == "bad_mpd"
    (timing,) = ET.fromstring(data).iter(f"{NS}UTCTiming")
    assert (timing.get("schemeIdUri"), timing.get("value")) == ("urn:mpeg:dash:utc:http-head:2014", "manifest.mpd")
    assert reason_of(data.replace(b'value="manifest.mpd"', b'value="http://clock.example/"'), LIVE) == "foreign_url"
    assert b"UTCTiming" not in write_mpd(TINY)


def test_a_still_segment_leaves_no_gap_in_a_timeline_and_nothing_stands_for_a_level_before_its_first_file():
    """Files are numbered as shaka and dash.js number them: from startNumber on, one after the other."""
    delta, tier, _ = (row.representations for row in Streams.of(STILL).sets())
    assert files_of(delta[0]) == files_of(tier[0]) == [(1, 0, 1000), (2, 1000, 500), (3, 1500, 1000)]
    assert delta[0].timeline == tier[0].timeline
    assert not [s for s in ET.fromstring(write_mpd(STILL)).iter(f"{NS}S") if s.get("n") or s.get("t", "0") != "0"]
    levels = next(iter(Streams.of(LATE).sets())).representations
    assert files_of(levels[2]) == [(2, 1000, 500), (3, 1500, 1000)] and not list(still_files(LATE))


def test_a_still_file_is_a_picture_for_as_long_as_nothing_moves_in_growing_and_whole_packages():
    stills, streams = dict(still_files(STILL)), Streams(STILL)
    assert list(stills) == ["delta/L0/2.m4s", "delta/L1/2.m4s", "delta/L2/2.m4s"]
    assert [list(streams.add(group)) for group in STILL.groups] == [[], list(stills), []]
    with av.open(io.BytesIO(init_segment(1000, 64, 64) + stills["delta/L1/2.m4s"])) as container:
        (frame,) = container.decode(video=0)
        stream = container.streams.video[0]
        assert (frame.pts, stream.time_base, frame.duration) == (1000, Fraction(1, 1000), 500)
    assert (frame.width, frame.height) == (64, 64) and (frame.to_ndarray()[:64] == 128).all()


@pytest.mark.parametrize(("sizes", "delta"), [((2000, 0), [["L0"]]), ((0, 0), [])])
def test_a_level_without_files_is_not_listed_and_a_regular_sequence_makes_no_longer_mpd(sizes, delta):
    short, long = (tiny_manifest(delta_bytes=sizes, groups=(10,) * count) for count in (10, 1000))
    found = [[r.id for r in row.representations] for row in Streams.of(short).sets()]
    assert found == [*delta, ["T0/Q0", "T0/Q1"], ["T1/Q0", "T1/Q1"]]
    assert len(write_mpd(long)) - len(write_mpd(short)) < 50


@pytest.mark.parametrize("m", [tiny_manifest(groups=(10, 3, 20, 7)), STILL])
def test_every_run_of_segments_fits_its_bandwidth(m):
    root = ET.fromstring(write_mpd(m))
    stated = {r.get("id"): int(r.get("bandwidth", "0")) for r in root.iter(f"{NS}Representation")}
    stills = dict(still_files(m))
    for r in [r for row in Streams.of(m).sets() for r in row.representations]:
        starts = [start / m.timescale for _, start, _ in files_of(r)]
        paths = [r.media.replace("$Number$", str(number)) for number, _, _ in files_of(r)]
        sizes = [8 * (len(stills[path]) if path in stills else m.entry(path).bytes) for path in paths]
        spans = [(a, b) for b in range(len(starts)) for a in range(b + 1)]
        needed = max(sum(sizes[a : b + 1]) / (1.0 + starts[b] - starts[a]) for a, b in spans)  # a second is buffered
        assert needed <= stated[r.id]


ELSEWHERE = '<SegmentTemplate media="http://example.com/$Number$.m4s"/>'
XLINK = ' xmlns:x="http://www.w3.org/1999/xlink" x:href="http://example.com/"'
DOCTYPE = '<!DOCTYPE MPD [<!ENTITY a "b">]><MPD'
EDITS = {
    "doctype": ("<MPD", DOCTYPE, "doctype"),
    "doctype in small letters": ("<MPD", "<!doctype MPD><MPD", "doctype"),
    "another encoding": ('encoding="utf-8"', 'encoding="utf-7"', "bad_mpd"),
    "location": ("<Period", "<Location>http://example.com/a.mpd</Location><Period", "foreign_url"),
    "base address": ("<AdaptationSet", "<BaseURL>http://example.com/</BaseURL><AdaptationSet", "foreign_url"),
    "xlink": ("<AdaptationSet", "<AdaptationSet" + XLINK, "foreign_url"),
    "parent folder": ('media="delta/', 'media="../delta/', "foreign_url"),
    "absolute path": ('initialization="', 'initialization="/', "foreign_url"),
    "another file": ('media="delta/$RepresentationID$/', 'media="delta/L1/', "mpd_mismatch"),
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
}


@pytest.mark.parametrize(("old", "new", "reason"), EDITS.values(), ids=EDITS)
def test_an_mpd_that_leads_elsewhere_is_refused(old, new, reason):
    assert reason_of(apply({"mpd": write_mpd(TINY)}, edit_text("mpd", old, new))["mpd"]) == reason


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32"])
def test_a_doctype_cannot_hide_in_another_encoding(encoding):
    text = write_mpd(TINY).decode().replace("<MPD", DOCTYPE)
    assert reason_of(text.replace("utf-8", encoding).encode(encoding)) in ("bad_mpd", "doctype")


@pytest.mark.parametrize(("what", "to", "stays", "reason"), [
    ("SegmentTemplate", "a level", True, "bad_mpd"),
    ("SegmentTemplate", "nowhere", False, "bad_mpd"),
    ("Representation", "keyframes", False, "mpd_mismatch"),
])  # fmt: skip
def test_what_stands_in_another_element_is_refused(what, to, stays, reason):
    root = ET.fromstring(write_mpd(TINY))
    delta, keyframes, *_ = root.findall(DELTA_SET)
    places = {"a level": delta.find(f"{NS}Representation"), "keyframes": keyframes, "nowhere": ET.Element("x")}
    moved = delta.findall(NS + what)[-1]
    places[to].append(copy.deepcopy(moved))
    if not stays:
        delta.remove(moved)
    assert reason_of(ET.tostring(root)) == reason


@given(st.binary(max_size=300))
@example(b"<a>" * 100_000 + b"</a>" * 100_000)
def test_any_bytes_as_an_mpd_are_refused(data):
    assert reason_of(data) == "bad_mpd"
