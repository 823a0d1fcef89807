"""manifest.mpd: a valid DASH MPD over the package's files, one Period. Advisory; airgs.json is normative.

One AdaptationSet for the delta (its Representations are the levels), one for each keyframe tier (the keyframe
qualities) and one for the sound, whose timeline is that of the groups: packets meet it to 20 ms. ffmpeg and dash.js
read SegmentTemplate with $Number$ and an explicit SegmentTimeline, SupplementalProperty, relative addresses and one
init segment for all. The SegmentTemplate stands in the AdaptationSet where the timelines of its Representations are
equal; otherwise each has its own, and the set has none (video.js would play the files of both). Runs of equal segments
are one S. DASH players stop at a gap in a timeline, and count files from its beginning: where nothing of a level moves,
a still file of one grey picture, which no table lists, takes its place. Keyframe tiers without a picture in a group
leave gaps.

What only DASH players and pages read is checked against the tables: the MPD, which is refused where a player would
follow it elsewhere, init files, the poster, and the boxes of sound. No video is decoded.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import accumulate
from typing import NamedTuple

from airgs_codec.errors import CodecError, ConfigError, FormatError
from airgs_codec.media import mp4
from airgs_codec.media.image import decode_rgba
from airgs_codec.package import layout
from airgs_codec.package.layout import INIT_NAME, JSON_NAME, MPD_NAME, POSTER_NAME, SOUND_INIT_NAME
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package
from airgs_codec.package.parse import expect
from airgs_codec.package.tables import MAX_POSTER_SIDE, Group, Header, Segment

DASH = "urn:mpeg:dash:schema:mpd:2011"
MIN_BUFFER_S = 1.0
NUMBER = "$Number$"  # stands for the number of a file in a SegmentTemplate
SOUND = "sound"
ID = "$RepresentationID$"  # stands in a template for the id, which is part of the paths of its files
_XLINK = "{http://www.w3.org/1999/xlink}"
_LEAD_AWAY = ("BaseURL", "Location", "PatchLocation")  # elements that change where a player fetches
_ELEMENTS = {  # that this format uses: their attributes, and children in the order of ISO/IEC 23009-1's schema
    "MPD": (
        "type profiles minBufferTime mediaPresentationDuration availabilityStartTime publishTime minimumUpdatePeriod",
        "Period UTCTiming",
    ),
    "UTCTiming": ("schemeIdUri value", ""),
    "Period": ("id start duration", "AdaptationSet SupplementalProperty"),
    "AdaptationSet": (
        "id selectionPriority contentType mimeType codecs segmentAlignment startWithSAP",
        "SupplementalProperty SegmentTemplate Representation",
    ),
    "SupplementalProperty": ("schemeIdUri value", ""),
    "Representation": ("id bandwidth", "SegmentTemplate"),
    "SegmentTemplate": ("timescale startNumber initialization media", "SegmentTimeline"),
    "SegmentTimeline": ("", "S"),
    "S": ("t n d r", ""),
}


@dataclass(frozen=True, slots=True)
class Run:
    """Files of equal duration that follow each other without a gap, in number and in time."""

    number: int  # of the first file
    start: int  # ticks
    duration: int  # ticks, of each
    count: int = 1

    def follows(self, before: Run) -> bool:
        end = before.number + before.count, before.start + before.count * before.duration
        return (self.number, self.start) == end


@dataclass(slots=True)
class Representation:
    """What the MPD says of one stream, to which file after file is added: where they are and when they play."""

    id: str
    media: str  # template with $Number$
    timeline: list[Run] = field(default_factory=list)  # no two of which could be one
    init: str = INIT_NAME
    # Bits a second at which every run of files has arrived MIN_BUFFER_S after its first one begins to play.
    bandwidth: int = field(default=1, compare=False, repr=False)

    def append(self, run: Run) -> None:
        last = self.timeline[-1] if self.timeline else None
        if last and run.follows(last) and run.duration == last.duration:
            self.timeline[-1] = replace(last, count=last.count + run.count)
        else:
            self.timeline.append(run)

    def add(self, m: Header, number: int, span: Group | Segment, size: int) -> None:
        """Add the next file, unless it has no bytes."""
        if size:
            frames, ticks = span.stop - span.start, m.frame_ticks
            self.append(Run(number, span.start * ticks, frames * ticks))
            self.bandwidth = max(self.bandwidth, int(8 * size / min(MIN_BUFFER_S, float(frames / m.fps))) + 1)


def _keyframe_stream(tier: int, quality: int) -> Representation:
    return Representation(f"T{tier}/Q{quality}", layout.keyframe_media_path(tier, quality, NUMBER))


class AdaptationSet(NamedTuple):
    """Representations of which a viewer plays one at a time, the best first."""

    role: str  # "delta", the keyframe tier, or "sound"
    priority: int  # a DASH player that knows nothing of this format shows the delta
    representations: list[Representation]


@dataclass(frozen=True, slots=True)
class LiveClock:
    """The times that the MPD of a growing package names."""

    available: datetime  # of its first frame
    published: datetime  # of this MPD


class Streams:
    """What the MPD says of all groups, which are added one by one; regular ones take no memory."""

    def __init__(self, m: Header) -> None:
        self._header = m
        self._deltas = [Representation(f"L{j}", layout.delta_media_path(j, NUMBER)) for j in range(len(m.levels))]
        self._keyframes = [[_keyframe_stream(t, q) for q in range(len(m.qualities))] for t in range(m.tiers)]
        self._sound = Representation(SOUND, layout.sound_path(NUMBER), init=SOUND_INIT_NAME)
        self._groups = self._segments = 0  # so far
        self.longest = 0  # frames of a group

    @staticmethod
    def of(m: Manifest) -> Streams:
        streams = Streams(m)
        for group in m.groups:
            streams.add(group)
        return streams

    def add(self, group: Group) -> dict[str, bytes]:
        """Add the next group, and return its still files by their paths."""
        m, ticks, stills = self._header, self._header.frame_ticks, dict[str, bytes]()
        self._groups += 1
        for row, tier in zip(self._keyframes, group.tiers, strict=True):
            for stream, picture in zip(row, tier.pictures, strict=True):
                stream.add(m, self._groups, group, picture.bytes)
        self._sound.add(m, self._groups, group, group.sound.bytes if group.sound else 0)
        for segment in group.segments:
            self._segments += 1
            for stream, level in zip(self._deltas, segment.levels, strict=True):
                if not (size := level.file.bytes) and stream.timeline:
                    data = mp4.still_segment(segment.start * ticks, (segment.stop - segment.start) * ticks)
                    stills[stream.media.replace(NUMBER, str(self._segments))], size = data, len(data)
                stream.add(m, self._segments, segment, size)
        self.longest = max(self.longest, group.stop - group.start)
        return stills

    def sets(self) -> list[AdaptationSet]:
        """Return the delta, then each keyframe tier, then the sound, as far as they have files."""
        keyframes = [(f"keyframe;tier={t}", 1, row) for t, row in enumerate(self._keyframes)]
        sets = [("delta", 10, self._deltas), *keyframes, (SOUND, 1, [self._sound])]
        listed = [AdaptationSet(role, priority, [r for r in row if r.timeline]) for role, priority, row in sets]
        return [one for one in listed if one.representations]


def still_files(m: Manifest) -> Iterator[tuple[str, bytes]]:
    streams = Streams(m)
    for group in m.groups:
        yield from streams.add(group).items()


def write_mpd(m: Manifest, clock: LiveClock | None = None, streams: Streams | None = None) -> bytes:
    """Return the text of manifest.mpd. Raises ConfigError for a growing package without a clock.

    `streams`: those of all groups, where they are known; by default the table of every group is read.
    """
    streams = streams or Streams.of(m)
    ET.register_namespace("", DASH)
    duration = {} if m.live else {"duration": f"PT{float(m.frames / m.fps):.6f}S"}
    about = {"profiles": "urn:mpeg:dash:profile:isoff-live:2011", "minBufferTime": f"PT{MIN_BUFFER_S:g}S"}
    if not m.live:
        about = {"type": "static", **about, "mediaPresentationDuration": duration["duration"]}
    elif clock is None:
        raise ConfigError("the MPD of a growing package: expected the time from which it is available")
    else:
        update = f"PT{float(streams.longest / m.fps):.6f}S"
        times = {"availabilityStartTime": clock.available.isoformat(), "publishTime": clock.published.isoformat()}
        about = {"type": "dynamic", **about, **times, "minimumUpdatePeriod": update}
    root = _element(None, "MPD", **about)
    period = _element(root, "Period", id="p0", start="PT0S", **duration)
    for number, adaptation_set in enumerate(streams.sets(), 1):
        _write_set(period, m, number, adaptation_set)
    _element(period, "SupplementalProperty", schemeIdUri="urn:airgs:scene:2", value=JSON_NAME)
    if m.live:  # the clock of whoever serves the package, in the header Date of the answer to HEAD
        _element(root, "UTCTiming", schemeIdUri="urn:mpeg:dash:utc:http-head:2014", value=MPD_NAME)
    ET.indent(root, "")  # a line for each element
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _write_set(period: ET.Element, m: Manifest, number: int, row: AdaptationSet) -> None:
    about = {"id": str(number), "selectionPriority": str(row.priority), **_kind_of(row.role == SOUND)}
    element = _element(period, "AdaptationSet", **about, segmentAlignment="true", startWithSAP="1")
    _element(element, "SupplementalProperty", schemeIdUri="urn:airgs:plane:2", value=row.role)
    one_timeline = all(r.timeline == row.representations[0].timeline for r in row.representations)
    if one_timeline:
        _write_template(element, m, row.representations[0])
    for r in row.representations:
        listed = _element(element, "Representation", id=r.id, bandwidth=str(r.bandwidth))
        if not one_timeline:
            _write_template(listed, m, r)


def _kind_of(sound: bool) -> dict[str, str]:
    kind, codecs = ("audio", mp4.OPUS) if sound else ("video", mp4.CODECS)
    return {"contentType": kind, "mimeType": f"{kind}/mp4", "codecs": codecs}


def _write_template(parent: ET.Element, m: Manifest, r: Representation) -> None:
    about = {"timescale": str(m.timescale), "initialization": r.init, "media": r.media.replace(r.id, ID)}
    template = _element(parent, "SegmentTemplate", **about, startNumber=str(r.timeline[0].number))
    timeline = _element(template, "SegmentTimeline")
    before: Run | None = None
    for run in r.timeline:  # t where it begins the timeline, t and n after a gap
        place = {} if before and run.follows(before) else {"t": run.start}
        gap = {"n": run.number} if place and before else {}
        repeats = {"r": run.count - 1} if run.count > 1 else {}
        numbers = place | {"d": run.duration} | gap | repeats
        _element(timeline, "S", **{name: str(value) for name, value in numbers.items()})
        before = run


def _element(parent: ET.Element | None, tag: str, **attributes: str) -> ET.Element:
    name = f"{{{DASH}}}{tag}"
    return ET.Element(name, attributes) if parent is None else ET.SubElement(parent, name, attributes)


def check_mpd(data: bytes, m: Manifest, streams: Streams | None = None) -> None:
    """Raise FormatError unless an MPD says what the tables say, and nothing else about files and times.

    `streams`: those of all groups, where they are known; by default the table of every group is read.
    Reasons: doctype, bad_mpd, foreign_url, mpd_mismatch.
    """
    root = _read_xml(data)
    periods = root.findall("Period")
    expect(root.tag == "MPD" and len(periods) == 1, MPD_NAME, "expected an MPD with one Period", "bad_mpd")
    for element in root.iter():
        _check_element(element)
    _check_times(root, periods[0], m)
    # By id: the Representations of the set, what kind they are of, and this one.
    found, wanted = dict[str, object](), dict[str, object]()
    for adaptation_set in root.iter("AdaptationSet"):
        rows = adaptation_set.findall("Representation")
        ids = {row.get("id", "") for row in rows}
        for row in rows:
            stream = _read_representation(adaptation_set, row, m)
            expect(stream.id not in found, MPD_NAME, "expected a different id for each Representation", "bad_mpd")
            found[stream.id] = ids, {name: adaptation_set.get(name) for name in _kind_of(False)}, stream
    for role, _, listed in (streams or Streams.of(m)).sets():
        ids = {stream.id for stream in listed}
        wanted |= {stream.id: (ids, _kind_of(role == SOUND), stream) for stream in listed}
    for name in sorted(found.keys() | wanted.keys()):
        expected, got, where = wanted.get(name, "nothing"), found.get(name, "nothing"), f"{MPD_NAME} {name}"
        expect(got == expected, where, f"expected {expected}, got {got}", "mpd_mismatch")


def _read_xml(data: bytes) -> ET.Element:
    """Return the root; DASH elements have their local names, others begin with {}. No encoding hides a DOCTYPE."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError("bad_mpd", MPD_NAME, f"expected UTF-8: {error.reason} at byte {error.start}") from error
    # Of zero bytes the parser would take it for UTF-16, in which the search below finds nothing.
    expect("\0" not in text, MPD_NAME, "expected UTF-8 without zero bytes", "bad_mpd")
    other = re.match(r"""\ufeff?<\?xml[^>]*?\sencoding\s*=\s*["'](?!utf-8["'])""", text, re.IGNORECASE)
    expect(not other, MPD_NAME, "expected UTF-8, got another encoding", "bad_mpd")
    plain = not re.search("<!(DOCTYPE|ENTITY)", text, re.IGNORECASE)
    expect(plain, MPD_NAME, "expected XML without a DOCTYPE", "doctype")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise FormatError("bad_mpd", MPD_NAME, f"expected XML: {error}") from error
    for element in root.iter():
        namespace, _, name = element.tag.rpartition("}")
        element.tag = name if namespace == f"{{{DASH}" else f"{{}}{element.tag}"
    return root


def _check_element(element: ET.Element) -> None:
    """Refuse what this format does not use, and addresses outside the package: a player might follow them."""
    name = element.tag
    where, (attributes, children) = f"{MPD_NAME} {name}", _ELEMENTS[name]
    for attribute, value in element.attrib.items():
        expect(not attribute.startswith(_XLINK), where, "expected no xlink", "foreign_url")
        expect(attribute in attributes.split(), where, f"unknown attribute {attribute!r}", "bad_mpd")
        clock = name == "UTCTiming" and attribute == "value"
        expect(not clock or value == MPD_NAME, where, f"expected {MPD_NAME}, got {value!r}", "foreign_url")
        inside = not (":" in value or value.startswith("/") or ".." in value.split("/"))
        words = f"expected a relative address inside the package, got {value!r}"
        expect(inside or name != "SegmentTemplate", MPD_NAME, words, "foreign_url")
    for child in (inner.tag for inner in element):
        expect(child not in _LEAD_AWAY, where, f"expected relative addresses without {child}", "foreign_url")
        expect(child in children.split(), where, f"unknown element {child!r}", "bad_mpd")


def _check_times(root: ET.Element, period: ET.Element, m: Manifest) -> None:
    kind, text = root.get("type", "static"), root.get("mediaPresentationDuration")
    words = f"airgs.json says live: {m.live}, got a {kind} presentation"
    expect(kind == ("dynamic" if m.live else "static"), MPD_NAME, words, "mpd_mismatch")
    if m.live:
        named = not text and root.get("availabilityStartTime")
        expect(named, MPD_NAME, "expected an availabilityStartTime and no duration", "bad_mpd")
    else:
        fits, seconds = re.fullmatch(r"PT\d{1,12}(\.\d{1,12})?S", text or "", re.ASCII), float(m.frames / m.fps)
        expect(fits, MPD_NAME, f"expected mediaPresentationDuration as PT…S, got {text or ''!r}", "bad_mpd")
        words = f"expected a presentation of {seconds:.6f} s, got {text}"
        expect(abs(float((text or "")[2:-1]) - seconds) <= 1e-5, MPD_NAME, words, "mpd_mismatch")
    got = period.get("start", "PT0S"), period.get("duration", text), root.get("minBufferTime")
    expected = "PT0S", text, f"PT{MIN_BUFFER_S:g}S"
    words = f"expected the start and duration of the Period and minBufferTime {expected}, got {got}"
    expect(got == expected, MPD_NAME, words, "mpd_mismatch")


def _read_representation(adaptation_set: ET.Element, element: ET.Element, m: Manifest) -> Representation:
    """Return a Representation with what it has from its AdaptationSet, where one template has to stand in the two."""
    found = [template for parent in (adaptation_set, element) for template in parent.findall("SegmentTemplate")]
    where = f"{MPD_NAME} {(name := element.get('id', ''))}"
    expect(len(found) == 1, where, f"expected one SegmentTemplate, got {len(found)}", "bad_mpd")
    template = found[0]
    expect(len(template) == 1, where, f"expected one SegmentTimeline, got {len(template)}", "bad_mpd")
    expect(_whole(element.get("bandwidth"), where), where, "expected a bandwidth above 0, got 0", "bad_mpd")
    ticks = _whole(template.get("timescale"), where)
    expect(ticks == m.timescale, where, f"expected timescale {m.timescale}, got {ticks}", "mpd_mismatch")
    init, media = (template.get(which, "").replace(ID, name) for which in ("initialization", "media"))
    out, end, number = Representation(name, media, init=init), 0, _whole(template.get("startNumber", "1"), where)
    for s in template.iter("S"):
        start, duration, repeats = (_whole(a, where) for a in (s.get("t", str(end)), s.get("d"), s.get("r", "0")))
        number = _whole(s.get("n", str(number)), where)
        out.append(Run(number, start, duration, 1 + repeats))
        end, number = start + (1 + repeats) * duration, number + 1 + repeats
    return out


def _whole(text: str | None, where: str) -> int:
    words = f"expected a whole number of at most 18 digits, got {text!r}"
    expect(re.fullmatch(r"\d{1,18}", text or "", re.ASCII), where, words, "bad_mpd")
    return int(text or "")


def largest_picture(groups: Sequence[Group]) -> tuple[int, int]:
    atlases = [a for g in groups for row in (*(tier.qualities for tier in g.tiers), g.levels) for a in row]
    return max(atlas.width for atlas in atlases), max(atlas.height for atlas in atlases)


def check_shared(package: Package, path: str) -> None:
    """Raise FormatError unless a file that is no group's, the poster or what tracks begin with, is what it should be.

    Reasons: bad_picture, bad_sound, and what `Package.read` raises.
    """
    m, data = package.manifest, package.read(path)
    if path == POSTER_NAME:
        try:
            decode_rgba(data, "JPEG", MAX_POSTER_SIDE)
        except ValueError as error:
            raise FormatError("bad_picture", path, f"expected a JPEG: {error}") from error
        return
    # init.mp4 is made for the largest picture of the groups at the time when it is written.
    sizes = accumulate((largest_picture([g]) for g in m.groups), lambda a, b: (max(a[0], b[0]), max(a[1], b[1])))
    wanted = [mp4.init_segment(m.timescale, *size) for size in dict.fromkeys(sizes)]
    if m.sound and path == SOUND_INIT_NAME:
        wanted = [mp4.sound_init(m.sound.channels, m.sound.pre_skip)]
    try:
        if data not in wanted:
            mp4.check_boxes(wanted[-1], data)
    except CodecError as error:
        raise FormatError("bad_picture" if path == INIT_NAME else "bad_sound", path, str(error)) from error


def check_sound(package: Package, group: int) -> None:
    """Raise FormatError(bad_sound) unless the sound of a group is the boxes and times of its packets."""
    m = package.manifest
    span = m.packets(m.groups[group].start, m.groups[group].stop)
    for path in m.sound_files(group):
        data = package.read(path)
        try:
            mp4.check_boxes(mp4.sound_segment(mp4.read_samples(data), span.start), data)
        except CodecError as error:
            raise FormatError("bad_sound", path, str(error)) from error
