"""manifest.mpd: a valid DASH MPD over the package's files, one Period. Advisory; airgs.json is normative.

One AdaptationSet for the state (its Representations are the levels) and one for each key tier (the key qualities).
The shape was chosen by what ffmpeg and dash.js read: SegmentTemplate with $Number$ and an explicit SegmentTimeline,
SupplementalProperty only, relative addresses, one init segment for all. The SegmentTemplate stands in the
AdaptationSet where the timelines of its Representations are equal; otherwise each has its own, and the set has none
(video.js would play the files of both). Runs of equal segments are one S, so that the MPD does not grow with a regular
sequence. `mpd_check` reads an MPD back and refuses others.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.media.fragments import CODECS
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.paths import INIT_NAME, JSON_NAME, key_media_path, state_media_path
from airgs_codec.package.tables import Group, Segment

DASH = "urn:mpeg:dash:schema:mpd:2011"
MIN_BUFFER_S = 1.0
NUMBER = "$Number$"  # stands for the number of a file in a SegmentTemplate
ID = "$RepresentationID$"  # stands there for the id, which is the folder of the files below that of all of its kind
CONTENT = {  # the elements that this format uses, and their children in the order of ISO/IEC 23009-1's schema
    "MPD": ("Period",),
    "Period": ("AdaptationSet", "SupplementalProperty"),
    "AdaptationSet": ("SupplementalProperty", "SegmentTemplate", "Representation"),
    "SupplementalProperty": (),
    "Representation": ("SegmentTemplate",),
    "SegmentTemplate": ("SegmentTimeline",),
    "SegmentTimeline": ("S",),
    "S": (),
}


@dataclass(frozen=True, slots=True)
class Unit:
    """A file and when it plays."""

    number: int
    start: int  # ticks
    duration: int  # ticks


@dataclass(frozen=True, slots=True)
class Representation:
    """What the MPD says of one stream: its files and when they play."""

    id: str
    media: str  # template with $Number$
    timeline: tuple[Unit, ...]
    bandwidth: int = field(default=0, compare=False)  # bit/s


@dataclass(frozen=True, slots=True)
class AdaptationSet:
    """Representations of which a viewer plays one at a time, the best first."""

    role: str  # "state", or the key tier
    priority: int  # a DASH player that knows nothing of this format shows the state
    representations: tuple[Representation, ...]


@dataclass(frozen=True, slots=True)
class LiveClock:
    """The times that the MPD of a growing package names."""

    available: datetime  # when its first frame was, or would have been, there
    published: datetime  # of this MPD


def adaptation_sets(m: Manifest) -> list[AdaptationSet]:
    """What the tables call for: the state, then each key tier; streams without files and empty sets are left out."""
    streams = _streams(m)
    state = [streams[f"L{j}"] for j in range(len(m.levels))]
    keys = [[streams[f"T{t}/Q{q}"] for q in range(len(m.qualities))] for t in range(m.tiers)]
    sets = [("state", 10, state), *((f"key;tier={t}", 1, row) for t, row in enumerate(keys))]
    with_files = [(role, priority, tuple(r.listed() for r in row if r.timeline)) for role, priority, row in sets]
    return [AdaptationSet(role, priority, row) for role, priority, row in with_files if row]


@dataclass(slots=True)
class _Stream:
    """A Representation as its files are found."""

    id: str
    media: str
    timeline: list[Unit] = field(default_factory=list)
    rate: float = 0.0  # bit/s

    def add(self, m: Manifest, number: int, span: Group | Segment, size: int) -> None:
        """The next file; one of no bytes is not there.

        At the largest `rate` every run of files has come MIN_BUFFER_S after its first one begins to play.
        """
        if size:
            frames, ticks = span.stop - span.start, m.frame_ticks
            self.timeline.append(Unit(number, span.start * ticks, frames * ticks))
            self.rate = max(self.rate, 8 * size / min(MIN_BUFFER_S, float(frames / m.fps)))

    def listed(self) -> Representation:
        """What the MPD says of it."""
        return Representation(self.id, self.media, tuple(self.timeline), int(self.rate) + 1)


def _streams(m: Manifest) -> dict[str, _Stream]:
    """Every stream by its id, from one walk over the groups."""
    keys = {
        (t, q): _Stream(f"T{t}/Q{q}", key_media_path(t, q, NUMBER)) for t, q in np.ndindex(m.tiers, len(m.qualities))
    }
    states = [_Stream(f"L{j}", state_media_path(j, NUMBER)) for j in range(len(m.levels))]
    for g, group in enumerate(m.groups):
        for (t, q), stream in keys.items():
            stream.add(m, g + 1, group, group.tiers[t].pictures[q].bytes)
        for number, segment in zip(m.segments_of(g), group.segments, strict=True):
            for stream, level in zip(states, segment.levels, strict=True):
                stream.add(m, number + 1, segment, level.file.bytes)
    return {stream.id: stream for stream in (*keys.values(), *states)}


def write_mpd(m: Manifest, clock: LiveClock | None = None) -> bytes:
    """The text of manifest.mpd. Raises ConfigError for a growing package without a clock."""
    ET.register_namespace("", DASH)
    duration = f"PT{float(m.frames / m.fps):.6f}S"
    root = _element(None, "MPD", **_presentation(m, duration, clock))
    period = _element(root, "Period", id="p0", start="PT0S", **({} if m.live else {"duration": duration}))
    for number, adaptation_set in enumerate(adaptation_sets(m), 1):
        _write_set(period, m, number, adaptation_set)
    _element(period, "SupplementalProperty", schemeIdUri="urn:airgs:scene:2", value=JSON_NAME)
    ET.indent(root, "")  # a line for each element
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _presentation(m: Manifest, duration: str, clock: LiveClock | None) -> dict[str, str]:
    """Attributes of the MPD element."""
    common = {"profiles": "urn:mpeg:dash:profile:isoff-live:2011", "minBufferTime": f"PT{MIN_BUFFER_S:g}S"}
    if not m.live:
        return {"type": "static", **common, "mediaPresentationDuration": duration}
    if clock is None:
        raise ConfigError("the MPD of a growing package: expected the time from which it is available")
    longest = max(group.stop - group.start for group in m.groups)
    return {
        "type": "dynamic",
        **common,
        "availabilityStartTime": clock.available.isoformat(),
        "publishTime": clock.published.isoformat(),
        "minimumUpdatePeriod": f"PT{float(longest / m.fps):.6f}S",
    }


def _write_set(period: ET.Element, m: Manifest, number: int, adaptation_set: AdaptationSet) -> None:
    listed = adaptation_set.representations
    element = _element(
        period,
        "AdaptationSet",
        id=str(number),
        selectionPriority=str(adaptation_set.priority),
        contentType="video",
        mimeType="video/mp4",
        codecs=CODECS,
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
        initialization=INIT_NAME,
        media=r.media.replace(r.id, ID),
        startNumber=str(r.timeline[0].number),
    )
    timeline = _element(template, "SegmentTimeline")
    for attributes in _runs(r.timeline):
        _element(timeline, "S", **attributes)


def _runs(timeline: Iterable[Unit]) -> list[dict[str, str]]:
    """Attributes of an S for each run of equal durations; t where it begins the timeline, t and n after a gap."""
    runs: list[dict[str, int]] = []
    before: Unit | None = None
    for unit in timeline:
        follows = before is not None and (unit.number, unit.start) == (
            before.number + 1,
            before.start + before.duration,
        )
        if before is not None and follows and before.duration == unit.duration:
            runs[-1]["r"] = runs[-1].get("r", 0) + 1
        elif follows:
            runs.append({"d": unit.duration})
        else:
            runs.append({"t": unit.start, "d": unit.duration} | ({"n": unit.number} if before else {}))
        before = unit
    return [{name: str(value) for name, value in run.items()} for run in runs]


def _element(parent: ET.Element | None, tag: str, **attributes: str) -> ET.Element:
    name = f"{{{DASH}}}{tag}"
    return ET.Element(name, attributes) if parent is None else ET.SubElement(parent, name, attributes)
