"""manifest.mpd: a valid DASH MPD over the package's files, one Period. Advisory; airgs.json is normative.

One AdaptationSet for the state (its Representations are the levels) and one for each key tier (the key qualities).
The shape was chosen by what ffmpeg and dash.js read: SegmentTemplate with $Number$ and an explicit SegmentTimeline,
SupplementalProperty only, relative addresses. What all Representations of an AdaptationSet have in common stands there
once: attributes, and the SegmentTemplate if their timelines are equal. Otherwise each has its own, and the set has none
(video.js would play the files of both). `mpd_check` reads an MPD back and refuses others.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from airgs_codec.package.tables import (
    Group,
    Manifest,
    Picture,
    Segment,
    key_init_path,
    key_media_path,
    state_init_path,
    state_media_path,
)

DASH = "urn:mpeg:dash:schema:mpd:2011"
AIRGS = "urn:airgs:mpd:1"
MIN_BUFFER_S = 1.0
NUMBER = "$Number$"  # stands for the number of a file in a SegmentTemplate
ID = "$RepresentationID$"  # stands there for the id, which is the folder of the files below that of all of its kind
INHERITED = ("codecs", "width", "height", "sar", "frameRate")  # a Representation without one has that of its set
Timeline = tuple[tuple[int, int], ...]  # start and duration of each file in ticks, number 1 first
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
class Representation:
    """What the MPD says of one stream: its files and when they play."""

    id: str
    codecs: str
    width: int
    height: int
    init: str
    media: str  # template with $Number$
    timeline: Timeline
    advice: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)  # further attributes


@dataclass(frozen=True, slots=True)
class AdaptationSet:
    """Representations of which a viewer plays one at a time, the best first."""

    role: str  # "state", or the key tier
    priority: int  # a DASH player that knows nothing of this format shows the state
    representations: tuple[Representation, ...]


def adaptation_sets(m: Manifest) -> list[AdaptationSet]:
    """What the tables call for: the state, then each key tier; streams without files and empty sets are left out."""
    keys = [
        AdaptationSet(f"key;tier={t}", 1, tuple(_key(m, t, q, picture) for q, picture in enumerate(row)))
        for t, row in enumerate(m.key_pictures)
    ]
    state = AdaptationSet("state", 10, tuple(_state(m, j, picture) for j, picture in enumerate(m.state_pictures)))
    with_files = [
        AdaptationSet(s.role, s.priority, tuple(r for r in s.representations if r.timeline)) for s in (state, *keys)
    ]
    return [s for s in with_files if s.representations]


def _state(m: Manifest, level: int, picture: Picture) -> Representation:
    entry, rate = m.levels[level], m.fps
    advice = {
        "frameRate": str(rate.numerator) if rate.denominator == 1 else f"{rate.numerator}/{rate.denominator}",
        f"{{{AIRGS}}}pruned": f"{entry.pruned:g}",
        f"{{{AIRGS}}}factor": f"{entry.factor:g}",
        f"{{{AIRGS}}}tiers": str(entry.tiers),
    }
    timeline = _timeline(m, (s for s in m.segments if s.levels[level].number))
    media = state_media_path(level, NUMBER)
    return Representation(
        f"L{level}", picture.codecs, picture.width, picture.height, state_init_path(level), media, timeline, advice
    )


def _key(m: Manifest, tier: int, quality: int, picture: Picture) -> Representation:
    advice = {f"{{{AIRGS}}}factor": f"{m.qualities[quality].factor:g}"}
    timeline = _timeline(m, (g for g in m.groups if g.tiers[tier].number))
    init, media = key_init_path(tier, quality), key_media_path(tier, quality, NUMBER)
    name = f"T{tier}/Q{quality}"
    return Representation(name, picture.codecs, picture.width, picture.height, init, media, timeline, advice)


def _timeline(m: Manifest, spans: Iterable[Group | Segment]) -> Timeline:
    ticks = m.frame_ticks
    return tuple((span.start * ticks, (span.stop - span.start) * ticks) for span in spans)


def write_mpd(m: Manifest) -> bytes:
    """The text of manifest.mpd."""
    ET.register_namespace("", DASH)
    ET.register_namespace("airgs", AIRGS)
    duration = f"PT{float(m.frames / m.fps):.6f}S"
    root = _element(
        None,
        "MPD",
        type="static",
        profiles="urn:mpeg:dash:profile:isoff-live:2011",
        mediaPresentationDuration=duration,
        minBufferTime=f"PT{MIN_BUFFER_S:g}S",
    )
    period = _element(root, "Period", id="p0", start="PT0S", duration=duration)
    for number, adaptation_set in enumerate(adaptation_sets(m), 1):
        _write_set(period, m, number, adaptation_set)
    _element(period, "SupplementalProperty", schemeIdUri="urn:airgs:scene:1", value="airgs.json")
    ET.indent(root, "")  # a line for each element
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _write_set(period: ET.Element, m: Manifest, number: int, adaptation_set: AdaptationSet) -> None:
    listed = adaptation_set.representations
    attributes = [_attributes(m, r, ranking) for ranking, r in enumerate(listed, 1)]
    common = _common(attributes)
    element = _element(
        period,
        "AdaptationSet",
        id=str(number),
        selectionPriority=str(adaptation_set.priority),
        contentType="video",
        mimeType="video/mp4",
        segmentAlignment="true",
        startWithSAP="1",
        **common,
    )
    _element(element, "SupplementalProperty", schemeIdUri="urn:airgs:plane:1", value=adaptation_set.role)
    one_timeline = len({r.timeline for r in listed}) == 1
    if one_timeline:
        _write_template(element, m, listed[0])
    for r, own in zip(listed, attributes, strict=True):
        row = _element(element, "Representation", **{k: v for k, v in own.items() if k not in common})
        if not one_timeline:
            _write_template(row, m, r)


def _attributes(m: Manifest, r: Representation, ranking: int) -> dict[str, str]:
    return {
        "id": r.id,
        "codecs": r.codecs,
        "bandwidth": str(_bandwidth(m, r)),
        "width": str(r.width),
        "height": str(r.height),
        "sar": "1:1",
        "qualityRanking": str(ranking),
        **r.advice,
    }


def _common(rows: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """What all Representations of a set say alike and may leave to it."""
    first = rows[0]
    return {k: first[k] for k in INHERITED if k in first and all(row.get(k) == first[k] for row in rows)}


def _write_template(parent: ET.Element, m: Manifest, r: Representation) -> None:
    template = _element(
        parent,
        "SegmentTemplate",
        timescale=str(m.timescale),
        startNumber="1",
        initialization=r.init.replace(r.id, ID),
        media=r.media.replace(r.id, ID),
    )
    timeline = _element(template, "SegmentTimeline")
    for attributes in _runs(r.timeline):
        _element(timeline, "S", **attributes)


def _runs(timeline: Timeline) -> list[dict[str, str]]:
    """Attributes of an S for each run of equal durations; t where it begins the timeline or follows a gap."""
    runs: list[dict[str, int]] = []
    end = None
    for start, duration in timeline:
        if start == end and runs[-1]["d"] == duration:
            runs[-1]["r"] = runs[-1].get("r", 0) + 1
        else:
            runs.append({"d": duration} if start == end else {"t": start, "d": duration})
        end = start + duration
    return [{name: str(value) for name, value in run.items()} for run in runs]


def _element(parent: ET.Element | None, tag: str, **attributes: str) -> ET.Element:
    name = f"{{{DASH}}}{tag}"
    return ET.Element(name, attributes) if parent is None else ET.SubElement(parent, name, attributes)


def _bandwidth(m: Manifest, r: Representation) -> int:
    """A bit/s above the least b at which every run of segments fits into b * (MIN_BUFFER_S + time since its start)."""
    sizes = [8 * m.files[r.media.replace(NUMBER, str(n))].bytes for n in range(1, len(r.timeline) + 1)]
    starts = [start / m.timescale for start, _ in r.timeline]
    best = 0.0
    for first in range(len(sizes)):
        bits = 0
        for i in range(first, len(sizes)):
            bits += sizes[i]
            best = max(best, bits / (MIN_BUFFER_S + starts[i] - starts[first]))
    return int(best) + 1
