"""manifest.mpd: a valid DASH MPD over the package's files, one Period. Advisory; airgs.json is normative.

One AdaptationSet for the state (its Representations are the levels), one for each key tier (the key qualities) and one
for the sound, whose timeline is that of the groups: packets meet it to 20 ms. The shape was chosen by what ffmpeg and
dash.js read: SegmentTemplate with $Number$ and an explicit SegmentTimeline, SupplementalProperty only, relative
addresses, one init segment for all. The SegmentTemplate stands in the AdaptationSet where the timelines of its
Representations are equal; otherwise each has its own, and the set has none (video.js would play the files of both).
Runs of equal segments are one S, so that the MPD does not grow with a regular sequence. DASH players stop at a gap in a
timeline, and count files from its beginning: where nothing of a level moves, and the tables have no file, a still file
of one grey picture takes its place, which only DASH players fetch. Key tiers without a picture in a group leave gaps.
`dash_check` reads an MPD back and refuses others.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime

from airgs_codec.errors import ConfigError
from airgs_codec.media.mp4 import CODECS, OPUS, still_segment
from airgs_codec.package.layout import (
    INIT_NAME,
    JSON_NAME,
    MPD_NAME,
    SOUND_INIT_NAME,
    key_media_path,
    sound_path,
    state_media_path,
)
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.tables import Group, Header, Segment

DASH = "urn:mpeg:dash:schema:mpd:2011"
MIN_BUFFER_S = 1.0
NUMBER = "$Number$"  # stands for the number of a file in a SegmentTemplate
SOUND = "sound"
ID = "$RepresentationID$"  # stands there for the id, which is the folder of the files below that of all of its kind
CONTENT = {  # the elements that this format uses, and their children in the order of ISO/IEC 23009-1's schema
    "MPD": ("Period", "UTCTiming"),
    "UTCTiming": (),
    "Period": ("AdaptationSet", "SupplementalProperty"),
    "AdaptationSet": ("SupplementalProperty", "SegmentTemplate", "Representation"),
    "SupplementalProperty": (),
    "Representation": ("SegmentTemplate",),
    "SegmentTemplate": ("SegmentTimeline",),
    "SegmentTimeline": ("S",),
    "S": (),
}


@dataclass(frozen=True, slots=True)
class Run:
    """Files of equal duration that follow each other without a gap, in number and in time."""

    number: int  # of the first file
    start: int  # ticks
    duration: int  # ticks, of each
    count: int = 1

    def follows(self, before: Run) -> bool:
        """Whether it begins, in number and in time, where another run ends."""
        end = before.number + before.count, before.start + before.count * before.duration
        return (self.number, self.start) == end


def append(timeline: list[Run], run: Run) -> None:
    """Add what plays next, as part of the last run where it goes on like that."""
    last = timeline[-1] if timeline else None
    if last and run.follows(last) and run.duration == last.duration:
        timeline[-1] = replace(last, count=last.count + run.count)
    else:
        timeline.append(run)


@dataclass(frozen=True, slots=True)
class Representation:
    """What the MPD says of one stream: its files and when they play."""

    id: str
    media: str  # template with $Number$
    timeline: tuple[Run, ...]  # no two of which could be one
    init: str = INIT_NAME
    bandwidth: int = field(default=0, compare=False)  # bit/s


@dataclass(frozen=True, slots=True)
class AdaptationSet:
    """Representations of which a viewer plays one at a time, the best first."""

    role: str  # "state", the key tier, or "sound"
    priority: int  # a DASH player that knows nothing of this format shows the state
    representations: tuple[Representation, ...]


@dataclass(frozen=True, slots=True)
class LiveClock:
    """The times that the MPD of a growing package names."""

    available: datetime  # when its first frame was, or would have been, there
    published: datetime  # of this MPD


@dataclass(slots=True)
class _Stream:
    """A Representation as its files are found."""

    id: str
    media: str
    init: str = INIT_NAME
    timeline: list[Run] = field(default_factory=list)
    rate: float = 0.0  # bit/s

    def add(self, m: Header, number: int, span: Group | Segment, size: int) -> None:
        """The next file; one of no bytes is not there.

        At the largest `rate` every run of files has come MIN_BUFFER_S after its first one begins to play.
        """
        if size:
            frames, ticks = span.stop - span.start, m.frame_ticks
            append(self.timeline, Run(number, span.start * ticks, frames * ticks))
            self.rate = max(self.rate, 8 * size / min(MIN_BUFFER_S, float(frames / m.fps)))

    def listed(self) -> Representation:
        """Return what the MPD says of it."""
        return Representation(self.id, self.media, tuple(self.timeline), self.init, int(self.rate) + 1)


class Streams:
    """What the MPD says of all groups, whose tables are looked at once, in their order; regular ones take no room."""

    def __init__(self, m: Header) -> None:
        """`m`: the package, whose groups are added one by one."""
        self._header = m
        self._states = [_Stream(f"L{j}", state_media_path(j, NUMBER)) for j in range(len(m.levels))]
        self._keys = [
            [_Stream(f"T{t}/Q{q}", key_media_path(t, q, NUMBER)) for q in range(len(m.qualities))]
            for t in range(m.tiers)
        ]
        self._sound = _Stream(SOUND, sound_path(NUMBER), SOUND_INIT_NAME)
        self._groups = self._segments = 0  # so far
        self.longest = 0  # frames of a group

    @staticmethod
    def of(m: Manifest) -> Streams:
        """Those of all groups of a package."""
        streams = Streams(m)
        for group in m.groups:
            streams.add(group)
        return streams

    def add(self, group: Group) -> dict[str, bytes]:
        """The next group; gives its still files by their paths."""
        m = self._header
        self._groups += 1
        for row, tier in zip(self._keys, group.tiers, strict=True):
            for stream, picture in zip(row, tier.pictures, strict=True):
                stream.add(m, self._groups, group, picture.bytes)
        self._sound.add(m, self._groups, group, group.sound.bytes if group.sound else 0)
        stills: dict[str, bytes] = {}
        for segment in group.segments:
            self._segments += 1
            for stream, level in zip(self._states, segment.levels, strict=True):
                size = level.file.bytes
                if not size and stream.timeline:
                    ticks = m.frame_ticks
                    data = still_segment(segment.start * ticks, (segment.stop - segment.start) * ticks)
                    stills[stream.media.replace(NUMBER, str(self._segments))], size = data, len(data)
                stream.add(m, self._segments, segment, size)
        self.longest = max(self.longest, group.stop - group.start)
        return stills

    def sets(self) -> list[AdaptationSet]:
        """The state, then each key tier, then the sound, as far as they have files."""
        keys = [(f"key;tier={t}", 1, row) for t, row in enumerate(self._keys)]
        sets = [("state", 10, self._states), *keys, (SOUND, 1, [self._sound])]
        listed = [(role, priority, tuple(r.listed() for r in row if r.timeline)) for role, priority, row in sets]
        return [AdaptationSet(role, priority, row) for role, priority, row in listed if row]


def still_files(m: Manifest) -> Iterator[tuple[str, bytes]]:
    """Path and bytes of every still file of a package, for which no table has an entry."""
    streams = Streams(m)
    for group in m.groups:
        yield from streams.add(group).items()


def write_mpd(m: Manifest, clock: LiveClock | None = None, streams: Streams | None = None) -> bytes:
    """The text of manifest.mpd. Raises ConfigError for a growing package without a clock.

    `streams`: those of all groups, where they are known; by default the table of every group is read.
    """
    streams = streams or Streams.of(m)
    ET.register_namespace("", DASH)
    duration = f"PT{float(m.frames / m.fps):.6f}S"
    root = _element(None, "MPD", **_presentation(m, duration, clock, streams.longest))
    period = _element(root, "Period", id="p0", start="PT0S", **({} if m.live else {"duration": duration}))
    for number, adaptation_set in enumerate(streams.sets(), 1):
        _write_set(period, m, number, adaptation_set)
    _element(period, "SupplementalProperty", schemeIdUri="urn:airgs:scene:2", value=JSON_NAME)
    if m.live:  # the clock of whoever serves the package, in the header Date of the answer to HEAD
        _element(root, "UTCTiming", schemeIdUri="urn:mpeg:dash:utc:http-head:2014", value=MPD_NAME)
    ET.indent(root, "")  # a line for each element
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _presentation(m: Manifest, duration: str, clock: LiveClock | None, longest: int) -> dict[str, str]:
    common = {"profiles": "urn:mpeg:dash:profile:isoff-live:2011", "minBufferTime": f"PT{MIN_BUFFER_S:g}S"}
    if not m.live:
        return {"type": "static", **common, "mediaPresentationDuration": duration}
    if clock is None:
        raise ConfigError("the MPD of a growing package: expected the time from which it is available")
    return {
        "type": "dynamic",
        **common,
        "availabilityStartTime": clock.available.isoformat(),
        "publishTime": clock.published.isoformat(),
        "minimumUpdatePeriod": f"PT{float(longest / m.fps):.6f}S",
    }


def _write_set(period: ET.Element, m: Manifest, number: int, adaptation_set: AdaptationSet) -> None:
    listed = adaptation_set.representations
    kind, codecs = ("audio", OPUS) if adaptation_set.role == SOUND else ("video", CODECS)
    element = _element(
        period,
        "AdaptationSet",
        id=str(number),
        selectionPriority=str(adaptation_set.priority),
        contentType=kind,
        mimeType=f"{kind}/mp4",
        codecs=codecs,
        segmentAlignment="true",
        startWithSAP="1",
    )
    _element(element, "SupplementalProperty", schemeIdUri="urn:airgs:plane:2", value=adaptation_set.role)
    one_timeline = len({r.timeline for r in listed}) == 1
    if one_timeline:
        _write_template(element, m, listed[0])
    for r in listed:
        row = _element(element, "Representation", id=r.id, bandwidth=str(r.bandwidth))
        if not one_timeline:
            _write_template(row, m, r)


def _write_template(parent: ET.Element, m: Manifest, r: Representation) -> None:
    template = _element(
        parent,
        "SegmentTemplate",
        timescale=str(m.timescale),
        initialization=r.init,
        media=r.media.replace(r.id, ID),
        startNumber=str(r.timeline[0].number),
    )
    timeline = _element(template, "SegmentTimeline")
    for attributes in _runs(r.timeline):
        _element(timeline, "S", **attributes)


def _runs(timeline: Iterable[Run]) -> Iterator[dict[str, str]]:
    """Attributes of an S for each run; t where it begins the timeline, t and n after a gap."""
    before: Run | None = None
    for run in timeline:
        place = {} if before and run.follows(before) else {"t": run.start}
        gap = {"n": run.number} if place and before else {}
        repeats = {"r": run.count - 1} if run.count > 1 else {}
        yield {name: str(value) for name, value in (place | {"d": run.duration} | gap | repeats).items()}
        before = run


def _element(parent: ET.Element | None, tag: str, **attributes: str) -> ET.Element:
    name = f"{{{DASH}}}{tag}"
    return ET.Element(name, attributes) if parent is None else ET.SubElement(parent, name, attributes)
