"""manifest.mpd: a valid DASH MPD over the package's files, one Period. Advisory; airgs.json is normative.

One AdaptationSet for the state (its Representations are the levels) and one for each key tier (the key qualities).
The shape was chosen by what ffmpeg and dash.js read: SegmentTemplate with $Number$ and an explicit SegmentTimeline in
each Representation, SupplementalProperty only, relative addresses.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from airgs_codec.errors import FormatError
from airgs_codec.package.tables import (
    MPD_NAME,
    Manifest,
    Picture,
    key_init_path,
    key_media_path,
    state_init_path,
    state_media_path,
)

DASH = "urn:mpeg:dash:schema:mpd:2011"
AIRGS = "urn:airgs:mpd:1"
MIN_BUFFER_S = 1.0

_XLINK = "{http://www.w3.org/1999/xlink}"
_PARENTS = {
    "Period": ("MPD",),
    "AdaptationSet": ("Period",),
    "SupplementalProperty": ("Period", "AdaptationSet"),
    "Representation": ("AdaptationSet",),
    "SegmentTemplate": ("Representation",),
    "SegmentTimeline": ("SegmentTemplate",),
    "S": ("SegmentTimeline",),
}
_LEAD_AWAY = ("BaseURL", "Location", "PatchLocation")  # elements that change where a player fetches
_ATTRIBUTES = {  # of the elements that say which file plays when; the others' are advisory
    "SegmentTemplate": {"timescale", "startNumber", "initialization", "media"},
    "SegmentTimeline": set[str](),
    "S": {"t", "d"},
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


def representations(m: Manifest) -> list[list[Representation]]:
    """The AdaptationSets that the tables call for: the state, then each key tier; empty ones left out."""
    ticks = m.frame_ticks
    state = []
    for j, picture in enumerate(m.state_pictures):
        times = [(s.start * ticks, (s.stop - s.start) * ticks) for s in m.segments if s.levels[j].number]
        state.append(_representation(f"L{j}", picture, state_init_path(j), state_media_path(j, 0), times))
    sets = [state]
    for t, row in enumerate(m.key_pictures):
        times = [(g.start * ticks, (g.stop - g.start) * ticks) for g in m.groups if g.tiers[t].number]
        keys = enumerate(row)
        sets.append(
            [_representation(f"T{t}Q{q}", p, key_init_path(t, q), key_media_path(t, q, 0), times) for q, p in keys]
        )
    return [[r for r in row if r.timeline] for row in sets if any(r.timeline for r in row)]


def _representation(name: str, picture: Picture, init: str, first: str, times: list[tuple[int, int]]) -> Representation:
    media = first.removesuffix("0.m4s") + "$Number$.m4s"
    return Representation(name, picture.codecs, picture.width, picture.height, init, media, tuple(times))


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
    _element(period, "SupplementalProperty", schemeIdUri="urn:airgs:scene:1", value="airgs.json")
    for number, row in enumerate(representations(m), 1):
        state = row[0].id.startswith("L")
        adaptation = _element(
            period,
            "AdaptationSet",
            id=str(number),
            selectionPriority="10" if state else "1",
            contentType="video",
            mimeType="video/mp4",
            segmentAlignment="true",
            startWithSAP="1",
        )
        role = "state" if state else f"key;tier={row[0].id[1 : row[0].id.index('Q')]}"
        _element(adaptation, "SupplementalProperty", schemeIdUri="urn:airgs:plane:1", value=role)
        for ranking, representation in enumerate(row, 1):
            _write_representation(adaptation, m, representation, ranking, state)
    ET.indent(root, " ")
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _write_representation(parent: ET.Element, m: Manifest, r: Representation, ranking: int, state: bool) -> None:
    rate = m.fps
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
    )
    if state:
        level = m.levels[int(r.id[1:])]
        element.set(
            "frameRate", str(rate.numerator) if rate.denominator == 1 else f"{rate.numerator}/{rate.denominator}"
        )
        element.set(f"{{{AIRGS}}}pruned", f"{level.pruned:g}")
        element.set(f"{{{AIRGS}}}factor", f"{level.factor:g}")
        element.set(f"{{{AIRGS}}}tiers", str(level.tiers))
    else:
        element.set(f"{{{AIRGS}}}factor", f"{m.qualities[int(r.id.partition('Q')[2])].factor:g}")
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
    sizes = [8 * m.files[r.media.replace("$Number$", str(n))].bytes for n in range(1, len(r.timeline) + 1)]
    starts = [start / m.timescale for start, _ in r.timeline]
    best = 0.0
    for first in range(len(sizes)):
        bits = 0
        for i in range(first, len(sizes)):
            bits += sizes[i]
            best = max(best, bits / (MIN_BUFFER_S + starts[i] - starts[first]))
    return int(best) + 1


def check_mpd(data: bytes, m: Manifest) -> None:
    """Raise FormatError unless an MPD says what the tables say, and nothing else about files and times.

    Reasons: doctype, bad_mpd, foreign_url, mpd_mismatch.
    """
    root = _parse(data)
    _check_shape(root)
    _check_duration(root, m)
    rows = [
        _read_representations(element, m) for element in root.findall(f"./{{{DASH}}}Period/{{{DASH}}}AdaptationSet")
    ]
    found = {r.id: r for row in rows for r in row}
    if len(found) != sum(len(row) for row in rows):
        raise FormatError("bad_mpd", MPD_NAME, "expected a different id for each Representation")
    expected = {r.id: r for row in representations(m) for r in row}
    for name in sorted(found.keys() ^ expected.keys()):
        raise FormatError("mpd_mismatch", f"{MPD_NAME} {name}", "is not in both the MPD and airgs.json")
    for name, representation in expected.items():
        if found[name] != representation:
            raise FormatError("mpd_mismatch", f"{MPD_NAME} {name}", f"expected {representation}, got {found[name]}")
    sets, wanted = ({frozenset(r.id for r in row) for row in part if row} for part in (rows, representations(m)))
    if sets != wanted:
        raise FormatError("mpd_mismatch", MPD_NAME, "expected an AdaptationSet for the state and one for each key tier")


def _parse(data: bytes) -> ET.Element:
    """The root element. One encoding, so that a DOCTYPE cannot hide from the search in another one."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError("bad_mpd", MPD_NAME, f"expected UTF-8: {error.reason} at byte {error.start}") from error
    if "\0" in text:  # the parser would take it for UTF-16, in which the search below finds nothing
        raise FormatError("bad_mpd", MPD_NAME, "expected UTF-8 without zero bytes")
    declared = re.match(r"""\ufeff?<\?xml[^>]*?\sencoding\s*=\s*["']([^"']*)""", text)
    if declared and declared[1].lower() != "utf-8":
        raise FormatError("bad_mpd", MPD_NAME, f"expected UTF-8, got {declared[1]!r}")
    if re.search("<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise FormatError("doctype", MPD_NAME, "expected XML without a DOCTYPE")
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise FormatError("bad_mpd", MPD_NAME, f"expected XML: {error}") from error


def _check_shape(root: ET.Element) -> None:
    """Refuse elements and attributes that this format does not use: a player might follow them, a check would not."""
    if root.tag != f"{{{DASH}}}MPD" or len(root.findall(f"{{{DASH}}}Period")) != 1:
        raise FormatError("bad_mpd", MPD_NAME, "expected an MPD with one Period")
    waiting = [root]
    while waiting:
        parent = waiting.pop()
        name = _local(parent)
        for attribute in parent.attrib:
            if attribute.startswith(_XLINK):
                raise FormatError("foreign_url", f"{MPD_NAME} {name}", "expected no xlink")
            if attribute not in _ATTRIBUTES.get(name, {attribute}):
                raise FormatError("bad_mpd", f"{MPD_NAME} {name}", f"unknown attribute {attribute!r}")
        for child in parent:
            if _local(child) in _LEAD_AWAY:
                detail = f"expected relative addresses without {_local(child)}"
                raise FormatError("foreign_url", f"{MPD_NAME} {name}", detail)
            if name not in _PARENTS.get(_local(child), ()):
                raise FormatError("bad_mpd", f"{MPD_NAME} {name}", f"unknown element {child.tag!r}")
            waiting.append(child)


def _local(element: ET.Element) -> str:
    """Name of a DASH element without its namespace; empty for any other element."""
    prefix = f"{{{DASH}}}"
    return element.tag.removeprefix(prefix) if element.tag.startswith(prefix) else ""


def _check_duration(root: ET.Element, m: Manifest) -> None:
    text = root.get("mediaPresentationDuration", "")
    if not re.fullmatch(r"PT\d{1,12}(\.\d{1,12})?S", text, re.ASCII):
        raise FormatError("bad_mpd", MPD_NAME, f"expected mediaPresentationDuration as PT…S, got {text!r}")
    seconds = float(m.frames / m.fps)
    if abs(float(text[2:-1]) - seconds) > 1e-5 or root.get("type") != "static":
        raise FormatError("mpd_mismatch", MPD_NAME, f"expected a static presentation of {seconds:.6f} s, got {text}")


def _read_representations(adaptation: ET.Element, m: Manifest) -> list[Representation]:
    out = []
    for element in adaptation.findall(f"{{{DASH}}}Representation"):
        where = f"{MPD_NAME} {element.get('id')}"
        templates = element.findall(f"{{{DASH}}}SegmentTemplate")
        if len(templates) != 1:
            raise FormatError("bad_mpd", where, f"expected one SegmentTemplate, got {len(templates)}")
        template = templates[0]
        addresses = [template.get("initialization", ""), template.get("media", "")]
        for address in addresses:
            if ":" in address or address.startswith("/") or ".." in address.split("/"):
                raise FormatError(
                    "foreign_url", where, f"expected a relative address inside the package, got {address!r}"
                )
        try:
            scale = int(template.get("timescale", ""))
            times = tuple((int(s.attrib["t"]), int(s.attrib["d"])) for s in template.iter(f"{{{DASH}}}S"))
            size = int(element.get("width", "")), int(element.get("height", ""))
        except (ValueError, KeyError) as error:
            raise FormatError("bad_mpd", where, f"expected whole numbers: {error}") from error
        if scale != m.timescale or template.get("startNumber") != "1":
            raise FormatError("mpd_mismatch", where, f"expected timescale {m.timescale} and startNumber 1")
        name, codecs = element.get("id", ""), element.get("codecs", "")
        out.append(Representation(name, codecs, size[0], size[1], addresses[0], addresses[1], times))
    return out
