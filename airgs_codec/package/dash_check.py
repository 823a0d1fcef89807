"""Does what only DASH players and pages read say what the tables say: the MPD, init files, the poster, the sound?

An MPD that a DASH player would follow elsewhere is refused with its reason. No video is decoded.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from itertools import accumulate

from airgs_codec.errors import CodecError, FormatError
from airgs_codec.media.image import decode_rgba
from airgs_codec.media.mp4 import CODECS, OPUS, check_boxes, init_segment, read_samples, sound_init, sound_segment
from airgs_codec.package.layout import INIT_NAME, MPD_NAME, POSTER_NAME, SOUND_INIT_NAME
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import CONTENT, DASH, ID, MIN_BUFFER_S, SOUND, Representation, Run, Streams, append
from airgs_codec.package.package import Package
from airgs_codec.package.tables import MAX_POSTER_SIDE, Group

_XLINK = "{http://www.w3.org/1999/xlink}"
_LEAD_AWAY = ("BaseURL", "Location", "PatchLocation")  # elements that change where a player fetches
_ATTRIBUTES = {  # that this format uses, of each element
    "MPD": "type profiles minBufferTime mediaPresentationDuration "
    "availabilityStartTime publishTime minimumUpdatePeriod",
    "UTCTiming": "schemeIdUri value",
    "Period": "id start duration",
    "AdaptationSet": "id selectionPriority contentType mimeType codecs segmentAlignment startWithSAP",
    "SupplementalProperty": "schemeIdUri value",
    "Representation": "id bandwidth",
    "SegmentTemplate": "timescale startNumber initialization media",
    "SegmentTimeline": "",
    "S": "t n d r",
}


def check_mpd(data: bytes, m: Manifest, streams: Streams | None = None) -> None:
    """Raise FormatError unless an MPD says what the tables say, and nothing else about files and times.

    `streams`: those of all groups, where they are known; by default the table of every group is read.
    Reasons: doctype, bad_mpd, foreign_url, mpd_mismatch.
    """
    root = _parse(data)
    _check_shape(root)
    _check_duration(root, m)
    _check_period(root)
    found = [(row, row.findall(f"{{{DASH}}}Representation")) for row in root.iter(f"{{{DASH}}}AdaptationSet")]
    expected = [s.representations for s in (streams or Streams.of(m)).sets()]
    _check_ids([[r.get("id", "") for r in rows] for _, rows in found], [[r.id for r in rows] for rows in expected])
    wanted = {r.id: r for rows in expected for r in rows}
    for row, rows in found:
        _check_kind(row, rows)
        for element in rows:
            expects = wanted[element.get("id", "")]
            if (got := _read(row, element, m, expects)) != expects:
                raise FormatError("mpd_mismatch", f"{MPD_NAME} {expects.id}", f"expected {expects}, got {got}")


def _check_kind(row: ET.Element, rows: list[ET.Element]) -> None:
    """A player decides by these whether it can play an AdaptationSet, and which of its Representations."""
    kind, codecs = ("audio", OPUS) if any(r.get("id") == SOUND for r in rows) else ("video", CODECS)
    expected = {"contentType": kind, "mimeType": f"{kind}/mp4", "codecs": codecs}
    if (got := {name: row.get(name) for name in expected}) != expected:
        raise FormatError("mpd_mismatch", f"{MPD_NAME} AdaptationSet", f"expected {expected}, got {got}")
    for r in rows:
        if not _whole(r.get("bandwidth"), f"{MPD_NAME} {r.get('id')}"):
            raise FormatError("bad_mpd", f"{MPD_NAME} {r.get('id')}", "expected a bandwidth above 0, got 0")


def _check_ids(found: list[list[str]], expected: list[list[str]]) -> None:
    """The same Representations in the same AdaptationSets; the order of either is free."""
    got, wanted = ([name for row in rows for name in row] for rows in (found, expected))
    if len(set(got)) != len(got):
        raise FormatError("bad_mpd", MPD_NAME, "expected a different id for each Representation")
    for name in sorted(set(got) ^ set(wanted)):
        raise FormatError("mpd_mismatch", f"{MPD_NAME} {name}", "is not in both the MPD and the tables")
    if {frozenset(row) for row in found if row} != {frozenset(row) for row in expected}:
        wanted_sets = "an AdaptationSet for the state, for each key tier and for the sound"
        raise FormatError("mpd_mismatch", MPD_NAME, f"expected {wanted_sets}")


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
    for parent in root.iter():
        _check_attributes(parent)
        for child in parent:
            _check_child(_local(parent), child)


def _check_attributes(element: ET.Element) -> None:
    name = _local(element)
    for attribute, value in element.attrib.items():
        if attribute.startswith(_XLINK):
            raise FormatError("foreign_url", f"{MPD_NAME} {name}", "expected no xlink")
        if attribute not in _ATTRIBUTES.get(name, attribute).split():
            raise FormatError("bad_mpd", f"{MPD_NAME} {name}", f"unknown attribute {attribute!r}")
        if name == "UTCTiming" and attribute == "value" and value != MPD_NAME:
            raise FormatError("foreign_url", f"{MPD_NAME} {name}", f"expected {MPD_NAME}, got {value!r}")
        if name == "SegmentTemplate" and (":" in value or value.startswith("/") or ".." in value.split("/")):
            raise FormatError("foreign_url", MPD_NAME, f"expected a relative address inside the package, got {value!r}")


def _check_child(parent: str, child: ET.Element) -> None:
    name = _local(child)
    if name in _LEAD_AWAY:
        raise FormatError("foreign_url", f"{MPD_NAME} {parent}", f"expected relative addresses without {name}")
    if name not in CONTENT[parent]:
        raise FormatError("bad_mpd", f"{MPD_NAME} {parent}", f"unknown element {child.tag!r}")


def _local(element: ET.Element) -> str:
    """Name of a DASH element without its namespace; empty for any other element."""
    namespace, _, name = element.tag.rpartition("}")
    return name if namespace == f"{{{DASH}" else ""


def _check_duration(root: ET.Element, m: Manifest) -> None:
    kind, text = root.get("type", "static"), root.get("mediaPresentationDuration", "")
    if kind != ("dynamic" if m.live else "static"):
        raise FormatError("mpd_mismatch", MPD_NAME, f"airgs.json says live: {m.live}, got a {kind} presentation")
    if m.live:
        if text or not root.get("availabilityStartTime"):
            raise FormatError("bad_mpd", MPD_NAME, "expected an availabilityStartTime and no duration")
        return
    if not re.fullmatch(r"PT\d{1,12}(\.\d{1,12})?S", text, re.ASCII):
        raise FormatError("bad_mpd", MPD_NAME, f"expected mediaPresentationDuration as PT…S, got {text!r}")
    seconds = float(m.frames / m.fps)
    if abs(float(text[2:-1]) - seconds) > 1e-5:
        raise FormatError("mpd_mismatch", MPD_NAME, f"expected a presentation of {seconds:.6f} s, got {text}")


def _check_period(root: ET.Element) -> None:
    """Where the Period begins, and how much is fetched before anything plays."""
    (period,), text = root.findall(f"{{{DASH}}}Period"), root.get("mediaPresentationDuration")
    got = period.get("start", "PT0S"), period.get("duration", text), root.get("minBufferTime")
    if got != (expected := ("PT0S", text, f"PT{MIN_BUFFER_S:g}S")):
        detail = f"expected the start and duration of the Period and minBufferTime {expected}, got {got}"
        raise FormatError("mpd_mismatch", MPD_NAME, detail)


def _read(row: ET.Element, element: ET.Element, m: Manifest, wanted: Representation) -> Representation:
    """A Representation with what it has from its AdaptationSet `row`."""
    where = f"{MPD_NAME} {wanted.id}"
    template = _template(row, element, where)
    init, media = (template.get(name, "").replace(ID, wanted.id) for name in ("initialization", "media"))
    if _whole(template.get("timescale"), where) != m.timescale:
        raise FormatError("mpd_mismatch", where, f"expected timescale {m.timescale}")
    return Representation(wanted.id, media, _timeline(template, where), init)


def _template(row: ET.Element, element: ET.Element, where: str) -> ET.Element:
    """The SegmentTemplate of a Representation or of its AdaptationSet: players disagree on what two would mean."""
    found = [template for parent in (row, element) for template in parent.findall(f"{{{DASH}}}SegmentTemplate")]
    if len(found) != 1:
        raise FormatError("bad_mpd", where, f"expected one SegmentTemplate, got {len(found)}")
    template = found[0]
    if len(template) != 1:
        raise FormatError("bad_mpd", where, f"expected one SegmentTimeline, got {len(template)}")
    return template


def _timeline(template: ET.Element, where: str) -> tuple[Run, ...]:
    out: list[Run] = []
    end, number = 0, _whole(template.get("startNumber", "1"), where)
    for s in template.iter(f"{{{DASH}}}S"):
        start, duration, repeats = (_whole(a, where) for a in (s.get("t", str(end)), s.get("d"), s.get("r", "0")))
        number = _whole(s.get("n", str(number)), where)
        append(out, Run(number, start, duration, 1 + repeats))
        end, number = start + (1 + repeats) * duration, number + 1 + repeats
    return tuple(out)


def _whole(text: str | None, where: str) -> int:
    if not re.fullmatch(r"\d{1,18}", text or "", re.ASCII):
        raise FormatError("bad_mpd", where, f"expected a whole number of at most 18 digits, got {text!r}")
    return int(text or "")


def largest_picture(groups: Sequence[Group]) -> tuple[int, int]:
    """Give the width and height that no picture of the groups exceeds."""
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
    wanted = [sound_init(m.sound.channels, m.sound.pre_skip)] if m.sound and path == SOUND_INIT_NAME else _inits(m)
    try:
        if data not in wanted:
            check_boxes(wanted[-1], data)
    except CodecError as error:
        raise FormatError("bad_picture" if path == INIT_NAME else "bad_sound", path, str(error)) from error


def _inits(m: Manifest) -> list[bytes]:
    """What init.mp4 may be: it is made for the largest picture of the groups that were there when it was written."""
    sizes = accumulate((largest_picture([g]) for g in m.groups), lambda a, b: (max(a[0], b[0]), max(a[1], b[1])))
    return [init_segment(m.timescale, *size) for size in dict.fromkeys(sizes)]


def check_sound(package: Package, group: int) -> None:
    """Raise FormatError(bad_sound) unless the sound of a group is the boxes and times of its packets."""
    m = package.manifest
    span = m.packets(m.groups[group].start, m.groups[group].stop)
    for path in m.sound_files(group):
        data = package.read(path)
        try:
            check_boxes(sound_segment(read_samples(data), span.start), data)
        except CodecError as error:
            raise FormatError("bad_sound", path, str(error)) from error
