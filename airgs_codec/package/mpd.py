"""manifest.mpd: a valid DASH MPD over the package's files, one Period. Advisory; airgs.json is normative.

One AdaptationSet for the state (its Representations are the levels) and one for each key tier (the key qualities).
The shape was chosen by what ffmpeg and dash.js read: SegmentTemplate with $Number$ and an explicit SegmentTimeline in
each Representation, SupplementalProperty only, relative addresses. `mpd_check` reads an MPD back and refuses others.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
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
CONTENT = {  # the elements that this format uses, and their children in the order of ISO/IEC 23009-1's schema
    "MPD": ("Period",),
    "Period": ("AdaptationSet", "SupplementalProperty"),
    "AdaptationSet": ("SupplementalProperty", "Representation"),
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
    timeline: tuple[tuple[int, int], ...]  # start and duration in ticks, number 1 first
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
    name = f"T{tier}Q{quality}"
    return Representation(name, picture.codecs, picture.width, picture.height, init, media, timeline, advice)


def _timeline(m: Manifest, spans: Iterable[Group | Segment]) -> tuple[tuple[int, int], ...]:
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
    ET.indent(root, " ")
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _write_set(period: ET.Element, m: Manifest, number: int, adaptation_set: AdaptationSet) -> None:
    element = _element(
        period,
        "AdaptationSet",
        id=str(number),
        selectionPriority=str(adaptation_set.priority),
        contentType="video",
        mimeType="video/mp4",
        segmentAlignment="true",
        startWithSAP="1",
    )
    _element(element, "SupplementalProperty", schemeIdUri="urn:airgs:plane:1", value=adaptation_set.role)
    for ranking, representation in enumerate(adaptation_set.representations, 1):
        _write_representation(element, m, representation, ranking)


def _write_representation(parent: ET.Element, m: Manifest, r: Representation, ranking: int) -> None:
    element = _element(
        parent,
        "Representation",
        id=r.id,
        codecs=r.codecs,
        bandwidth=str(_bandwidth(m, r)),
        width=str(r.width),
        height=str(r.height),
        sar="1:1",
        qualityRanking=str(ranking),
        **r.advice,
    )
    template = _element(
        element,
        "SegmentTemplate",
        timescale=str(m.timescale),
        startNumber="1",
        initialization=r.init,
        media=r.media,
    )
    timeline = _element(template, "SegmentTimeline")
    for start, duration in r.timeline:
        _element(timeline, "S", t=str(start), d=str(duration))


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
