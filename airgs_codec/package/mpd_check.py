"""Does an MPD say what the tables say? An MPD that a DASH player would follow elsewhere is refused with its reason."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from airgs_codec.errors import FormatError
from airgs_codec.package.mpd import CONTENT, DASH, Representation, adaptation_sets
from airgs_codec.package.tables import MPD_NAME, Manifest

_XLINK = "{http://www.w3.org/1999/xlink}"
_LEAD_AWAY = ("BaseURL", "Location", "PatchLocation")  # elements that change where a player fetches
_ATTRIBUTES = {  # of the elements that say which file plays when; the others' are advisory
    "SegmentTemplate": {"timescale", "startNumber", "initialization", "media"},
    "SegmentTimeline": set[str](),
    "S": {"t", "d"},
}


def check_mpd(data: bytes, m: Manifest) -> None:
    """Raise FormatError unless an MPD says what the tables say, and nothing else about files and times.

    Reasons: doctype, bad_mpd, foreign_url, mpd_mismatch.
    """
    root = _parse(data)
    _check_shape(root)
    _check_duration(root, m)
    sets = root.findall(f"./{{{DASH}}}Period/{{{DASH}}}AdaptationSet")
    found = [[_read(element, m) for element in row.findall(f"{{{DASH}}}Representation")] for row in sets]
    _compare(found, [list(s.representations) for s in adaptation_sets(m)])


def _compare(found: list[list[Representation]], expected: list[list[Representation]]) -> None:
    """The same Representations in the same AdaptationSets; the order of either is free."""
    got, wanted = ({r.id: r for row in rows for r in row} for rows in (found, expected))
    if len(got) != sum(len(row) for row in found):
        raise FormatError("bad_mpd", MPD_NAME, "expected a different id for each Representation")
    for name in sorted(got.keys() ^ wanted.keys()):
        raise FormatError("mpd_mismatch", f"{MPD_NAME} {name}", "is not in both the MPD and airgs.json")
    for name, representation in wanted.items():
        if got[name] != representation:
            raise FormatError("mpd_mismatch", f"{MPD_NAME} {name}", f"expected {representation}, got {got[name]}")
    got_sets, wanted_sets = ({frozenset(r.id for r in row) for row in rows if row} for rows in (found, expected))
    if got_sets != wanted_sets:
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
        _check_attributes(parent)
        for child in parent:
            _check_child(_local(parent), child)
            waiting.append(child)


def _check_attributes(element: ET.Element) -> None:
    name = _local(element)
    for attribute in element.attrib:
        if attribute.startswith(_XLINK):
            raise FormatError("foreign_url", f"{MPD_NAME} {name}", "expected no xlink")
        if attribute not in _ATTRIBUTES.get(name, {attribute}):
            raise FormatError("bad_mpd", f"{MPD_NAME} {name}", f"unknown attribute {attribute!r}")


def _check_child(parent: str, child: ET.Element) -> None:
    name = _local(child)
    if name in _LEAD_AWAY:
        raise FormatError("foreign_url", f"{MPD_NAME} {parent}", f"expected relative addresses without {name}")
    if name not in CONTENT[parent]:
        raise FormatError("bad_mpd", f"{MPD_NAME} {parent}", f"unknown element {child.tag!r}")


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


def _read(element: ET.Element, m: Manifest) -> Representation:
    where = f"{MPD_NAME} {element.get('id')}"
    templates = element.findall(f"{{{DASH}}}SegmentTemplate")
    if len(templates) != 1:
        raise FormatError("bad_mpd", where, f"expected one SegmentTemplate, got {len(templates)}")
    template = templates[0]
    init, media = (_relative(template.get(name, ""), where) for name in ("initialization", "media"))
    try:
        scale = int(template.get("timescale", ""))
        timeline = tuple((int(s.attrib["t"]), int(s.attrib["d"])) for s in template.iter(f"{{{DASH}}}S"))
        width, height = int(element.get("width", "")), int(element.get("height", ""))
    except (ValueError, KeyError) as error:
        raise FormatError("bad_mpd", where, f"expected whole numbers: {error}") from error
    if scale != m.timescale or template.get("startNumber") != "1":
        raise FormatError("mpd_mismatch", where, f"expected timescale {m.timescale} and startNumber 1")
    return Representation(element.get("id", ""), element.get("codecs", ""), width, height, init, media, timeline)


def _relative(address: str, where: str) -> str:
    if ":" in address or address.startswith("/") or ".." in address.split("/"):
        raise FormatError("foreign_url", where, f"expected a relative address inside the package, got {address!r}")
    return address
