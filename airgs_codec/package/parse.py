"""Tables and the bytes of their files: packing, and strict reading, whose schema is the dataclasses of `tables`.

What is not in their annotations is refused, never ignored or repaired; then what no single field can tell: counts,
spans, and fields that refer to each other. Each check relies on those before it.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
import re
import sys
import types
import typing
import zlib
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from airgs_codec.errors import FormatError, SceneError
from airgs_codec.package import tables
from airgs_codec.package.layout import DELTA, JSON_NAME, Layout, group_path, keyframe_layout
from airgs_codec.package.tables import Atlas, Entry, FileEntry, Group, Header, Region, Root, Spans
from airgs_codec.places.place import got_words

MAX_TABLE_BYTES = 1 << 24  # of JSON: what it may cost is known before it is read
MAX_VALUES = 1 << 21  # commas and opening brackets: a value follows each
LEAST_SCALE, MOST_SCALE = 1e-6, 1e6  # of a transform to the world
MOST_NUMBER = 1e30  # of such a transform, as of all coordinates in tables
TOLERANCE = 1e-5  # of the products of its axes at length 1, and of the bounds of its scale
Bound = tuple[str, float, float, float]  # where, what came, the least and the most that may come

Table = typing.TypeVar("Table")


def parse_root(text: bytes) -> Root:
    """Read airgs.json. Raises FormatError whose `where` names the place.

    Reasons: not_json, unknown_version, unknown_field, missing_field, wrong_type, bad_value, missing_entry.
    """
    data = _typed(dict, _load(text, JSON_NAME), JSON_NAME)
    if (version := data.get("version")) != tables.VERSION:
        raise FormatError("unknown_version", JSON_NAME, f"expected version {tables.VERSION}, got {version!r}")
    root: Root = _parse(Root, data, JSON_NAME)
    check_root(root)
    return root


def parse_page(text: bytes, entry: Entry, where: str) -> Spans:
    """Read the page `where` of the index, of which the level above says `entry`; raises as `parse_root` does."""
    page: Spans = _parse(Spans, _load(text, where), where)
    _check_columns(where, page)
    got = len(page), sum(page.frames), sum(page.segments)
    expected = tables.PAGE, entry.stop - entry.start, entry.segments
    expect(got == expected, where, f"expected {expected} entries, frames and segments, got {got}")
    return page


def parse_group(data: bytes, header: Header, entry: Entry, number: int) -> Group:
    """Read the table of a group, counted from 0, of which the index says `entry`; raises as `parse_root` does."""
    where = group_path(number + 1)
    group: Group = _parse(Group, _load(inflate(data, where), where), where)
    check_group(header, entry, group, where)
    early = (group.base or 0) <= number
    expect(early, f"{where}.base", f"expected a group before {number + 1}, got {group.base}")
    return group


def read_region(path: Path) -> Region:
    """Read a viewing region from a JSON file, as `region` in airgs.json has it. Raises SceneError, FormatError."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot read a viewing region: {error.strerror}") from error
    region: Region = _parse(Region, _load(text, str(path)), str(path))
    _check_region(region, str(path))
    return dataclasses.replace(region, source="file")


def read_as(kind: type[Table], data: bytes, where: str) -> Table:
    """Read JSON as a dataclass, whose annotations are its schema. Raises FormatError as `parse_root` does."""
    value: Table = _parse(kind, _load(data, where), where)
    return value


def check_written(region: Region) -> None:
    """Raise FormatError for a region that no reader would take."""
    _check_region(_parse(Region, json.loads(pack_json(region)), "region"), "region")


def pack_json(table: Root | Spans | Group | Region) -> bytes:
    return json.dumps(table, default=as_plain, separators=(",", ":"), allow_nan=False).encode()


def as_plain(table: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are not None; `dataclasses.asdict` would copy every list of numbers."""
    values = ((field.name, getattr(table, field.name)) for field in dataclasses.fields(table))
    return {name: value for name, value in values if value is not None}


def pack_group(group: Group) -> bytes:
    return gzip.compress(pack_json(group), 9, mtime=0)


def inflate(data: bytes, where: str) -> bytes:
    """Unpack a group's table. Raises FormatError: not_json where it is not one gzip member, too_large."""
    inflater = zlib.decompressobj(31)  # window bits: the largest window, in a gzip wrapper
    try:
        text = inflater.decompress(data, MAX_TABLE_BYTES + 1)
    except zlib.error as error:
        raise FormatError("not_json", where, f"expected JSON in gzip: {error}") from error
    expect(len(text) <= MAX_TABLE_BYTES, where, f"expected at most {MAX_TABLE_BYTES} bytes of JSON", "too_large")
    whole = inflater.eof and not inflater.unused_data
    expect(whole, where, "expected JSON in one whole gzip member", "not_json")
    return text


def _load(data: bytes, where: str) -> Any:
    if len(data) > MAX_TABLE_BYTES or sum(map(data.count, (b",", b"[", b"{"))) > MAX_VALUES:
        detail = f"expected at most {MAX_TABLE_BYTES} bytes of JSON with {MAX_VALUES} commas and opening brackets"
        raise FormatError("too_large", where, detail)
    try:
        return json.loads(data.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise FormatError("not_json", where, f"expected JSON in UTF-8, got {got_words(data, str(error))}") from error


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")


def _parse(kind: Any, data: Any, where: str) -> Any:
    """Read `data` as a value of the annotated type `kind`."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        value = _parse(arguments[0], data, where)
        for constraint in arguments[1:]:
            match constraint:
                case tables.Range(low, high):
                    expect(low <= value <= high, where, f"expected {low} to {high}, got {value}")
                case tables.Length(low, high):
                    expect(low <= len(value) <= high, where, f"expected {low} to {high} values, got {len(value)}")
                case tables.OneOf(words):
                    expect(value in words, where, f"expected one of {', '.join(words)}, got {value!r}")
                case tables.Pattern(expression, what):
                    expect(re.fullmatch(expression, value), where, f"expected {what}, got {value!r}")
        return value
    if origin is list:
        return [_parse(arguments[0], d, f"{where}[{i}]") for i, d in enumerate(_typed(list, data, where))]
    if origin is tuple:
        data = _typed(list, data, where)
        kinds = arguments[:1] * len(data) if arguments[-1] is ... else arguments
        expect(len(data) == len(kinds), where, f"expected {len(kinds)} values, got {len(data)}")
        return tuple(_parse(kind, d, f"{where}[{i}]") for i, (kind, d) in enumerate(zip(kinds, data, strict=True)))
    if origin is dict:
        name, item = arguments
        items = _typed(dict, data, where).items()
        return {_parse(name, k, where): _parse(item, d, f"{where}[{k!r}]") for k, d in items}
    if dataclasses.is_dataclass(kind):
        return _parse_dataclass(kind, _typed(dict, data, where), where)
    if kind is float:
        data = _typed(float, data, where) if type(data) is not int else data
        finite = abs(data) <= sys.float_info.max  # an integer may have hundreds of digits
        expect(finite, where, "expected a finite number")
        return float(data)
    if kind is int and isinstance(data, float) and data.is_integer():
        return int(data)  # 4.0, which is 4 in JSON Schema and in browsers
    if kind is str and (half := re.search("[\ud800-\udfff]", _typed(str, data, where))):  # JSON gave it as \ud800
        raise FormatError("bad_value", where, f"expected text, got half a character, {half[0]!r}")
    return _typed(kind, data, where)


def _parse_dataclass(kind: Any, data: dict[str, Any], where: str) -> Any:
    hints, optional = _fields(kind)
    unknown, missing = sorted(data.keys() - hints.keys()), [n for n in hints if n not in data and n not in optional]
    expect(not unknown, where, f"unknown fields {unknown[:8]}", "unknown_field")
    expect(not missing, where, f"missing fields {missing}", "missing_field")
    given = {name: _parse(hints[name], data[name], f"{where}.{name}") for name in hints if name in data}
    return kind(**dict.fromkeys(optional) | given)


@cache
def _fields(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:
    hints = typing.get_type_hints(kind, include_extras=True)
    required = {name: as_required(hint) for name, hint in hints.items()}
    return required, frozenset(name for name in hints if required[name] is not hints[name])


def as_required(hint: Any) -> Any:
    """Return T for the type T | None of a field that may be missing; any other type as it is."""
    union = typing.get_origin(hint) in (types.UnionType, typing.Union)
    return next(kind for kind in typing.get_args(hint) if kind is not type(None)) if union else hint


def _typed(kind: type, data: Any, where: str) -> Any:
    if type(data) is not kind:
        expected = "number" if kind is float else kind.__name__
        raise FormatError("wrong_type", where, f"expected {expected}, got {type(data).__name__}")
    return data


def expect(fits: object, where: str, detail: str, reason: str = "bad_value") -> None:
    """Raise FormatError with a reason, a place and a detail unless `fits` is true."""
    if not fits:
        raise FormatError(reason, where, detail)


def _check_bounds(where: str, bounds: Iterable[Bound]) -> None:
    for name, value, low, high in bounds:
        expected = f"{low}" if low == high else f"{low} to {high}"
        expect(low <= value <= high, f"{where}.{name}", f"expected {expected}, got {value}")


def check_root(m: Root) -> None:
    """Raise FormatError (bad_value, missing_entry) unless what airgs.json says fits together."""
    ids = [*(q.id for q in m.qualities), *(v.id for v in m.levels)]
    expected = [*(f"Q{i}" for i in range(len(m.qualities))), *(f"L{i}" for i in range(len(m.levels)))]
    expect(ids == expected, f"{JSON_NAME}.levels", f"expected {expected}, got {ids}")
    _check_bounds(JSON_NAME, _root_bounds(m))
    _check_region(m.region, f"{JSON_NAME}.region")
    if m.world and (fault := fault_of(m.world.transform)):
        raise FormatError("bad_value", f"{JSON_NAME}.world.transform", fault)
    whole = m.timescale * m.frame_rate[1] % m.frame_rate[0] == 0
    expect(whole, f"{JSON_NAME}.timescale", "a frame is not a whole number of ticks")
    for name, entry in (("init", m.init), ("poster", m.poster), ("sound.init", m.sound and m.sound.init)):
        if entry:
            _check_file(f"{JSON_NAME}.{name}", entry, True)
    _check_bounds(JSON_NAME, [("poster.bytes", m.poster.bytes, 1, tables.MAX_POSTER_BYTES)] if m.poster else [])
    sizes, wanted = [len(levels) for levels in m.rungs], [len(m.levels)] * len(m.qualities) if m.measured else []
    expect(sizes == wanted, f"{JSON_NAME}.rungs", f"expected lists of {wanted} values, got {sizes}")
    _check_index(f"{JSON_NAME}.index", m)


def check_group(m: Header, entry: Entry, group: Group, where: str) -> None:
    """Raise FormatError (bad_value, missing_entry) unless the table of a group fits the package and itself."""
    got, expected = (group.start, group.stop, len(group.segments)), (entry.start, entry.stop, entry.segments)
    expect(got == expected, where, f"expected the start, stop and number of segments {expected}, got {got}")
    _check_bounds(where, _group_bounds(m, group))
    words = "expected an entry where, and only where, airgs.json has sound"
    expect((group.sound is None) == (m.sound is None), f"{where}.sound", words)
    if group.sound:  # there is a file where a packet starts in the time of the group
        _check_file(f"{where}.sound", group.sound, len(m.packets(group.start, group.stop)) > 0)
    for t, tier in enumerate(group.tiers):
        _check_file(f"{where}.tiers[{t}].sidecar", tier.sidecar, tier.count > 0)
        for q, picture in enumerate(tier.pictures):
            _check_file(f"{where}.tiers[{t}].pictures[{q}]", picture, tier.qualities[q].rows > 0)
    stop, measured = group.start, len(m.qualities) if m.measured else 0
    for s, segment in enumerate(group.segments):
        fits = segment.start == stop < segment.stop <= group.stop
        expect(fits, f"{where}.segments[{s}]", f"expected a start at {stop}, got [{segment.start}, {segment.stop})")
        stop = segment.stop
        for j, level in enumerate(segment.levels):
            here, fetched = f"{where}.segments[{s}].levels[{j}]", level.file.bytes > 0
            _check_file(f"{here}.file", level.file, fetched and bool(group.levels[j].planes))
            frames, sent = segment.stop - segment.start if fetched else 0, len(level.frame_bytes)
            bounds = ("frame_bytes", sent, frames, frames), ("slopes", sent, 2 if level.slopes else 0, sent)
            lengths = [(name, len(getattr(level, name)), measured, measured) for name in ("psnr", "delta_e")]
            _check_bounds(here, [*bounds, *lengths])
    expect(stop == group.stop, f"{where}.segments", f"end at {stop}, the group at {group.stop}")


def check_base(group: Group, base: Group, where: str) -> None:
    """Raise FormatError (bad_value) unless the base of a group has no base itself and an equal layout."""
    words = f"expected a base without a base, got {group.base}, whose base is {base.base}"
    expect(base.base is None, f"{where}.base", words)
    shared = attrgetter("grid", "keyframe_steps", "colour_transform")
    tiers, other = ([(tier.count, tier.factor) for tier in g.tiers] for g in (group, base))
    words = f"expected a group of equal tiers, grid, keyframe_steps and colours, got {group.base}"
    expect(shared(group) == shared(base) and tiers == other, f"{where}.base", words)


def _check_region(region: Region, where: str) -> None:
    """Refuse a place without a direction to look in or one that is up."""
    for p, place in enumerate(region.places):
        for name, got, other in (("focus", place.focus, place.position), ("up", place.up, [0.0, 0.0, 0.0])):
            differs = np.linalg.norm(np.subtract(got, other)) != 0
            expect(differs, f"{where}.places[{p}].{name}", f"expected other than {other}, got {got}")


def fault_of(transform: Sequence[float]) -> str | None:
    """Return what is wrong with a transform of 12 numbers, in words; None where it is a similarity without mirror."""
    large = [value for value in transform if not abs(value) <= MOST_NUMBER]
    if len(transform) != 12 or large:
        return f"expected 12 finite numbers of at most {MOST_NUMBER:g}, got {large[0] if large else len(transform)}"
    axes = np.reshape(transform, (3, 4))[:, :3]
    scale = float(np.linalg.norm(axes, axis=1).mean())
    if not LEAST_SCALE * (1 - TOLERANCE) <= scale <= MOST_SCALE * (1 + TOLERANCE):
        return f"expected a scale of {LEAST_SCALE:g} to {MOST_SCALE:g}, got {scale:g}"
    if np.abs(axes @ axes.T / scale**2 - np.eye(3)).max() > TOLERANCE:
        return f"expected a rotation with one scale for all axes, got rows {axes.tolist()}"
    if np.linalg.det(axes / scale) < 0:
        return "expected a right-handed turn, got one that mirrors"
    return None


def _check_columns(where: str, spans: Spans) -> None:
    lengths = [len(spans.frames), len(spans.segments), len(spans.bytes), len(spans.sha256) / tables.DIGEST]
    expect(len(set(lengths)) == 1, where, f"expected columns of one length, got {lengths}")


def _check_index(where: str, m: Root) -> None:
    for level, spans in enumerate(m.index):
        here, fewest = f"{where}[{level}]", tables.PAGE**level
        _check_columns(here, spans)
        expect(len(spans) < tables.PAGE, here, f"expected at most {tables.PAGE - 1} entries, got {len(spans)}")
        least = min([*spans.frames, *spans.segments], default=fewest)
        expect(least >= fewest, here, f"expected {fewest} frames and segments or more in each entry, got {least}")
    expect(len(m.index[-1]) > 0, where, "expected an entry in the last level, got none")
    total = sum(sum(spans.frames) for spans in m.index)
    expect(total == m.frames, where, f"covers {total} of {m.frames} frames")


def _check_file(where: str, entry: FileEntry, wanted: bool) -> None:
    expect(wanted or not entry.bytes, where, "expected no file: nothing is to be fetched")
    expect(entry.bytes or not wanted, where, "expected a file", "missing_entry")
    words = f"expected both a length and a digest or neither, got {entry.bytes} and {entry.sha256!r}"
    expect(bool(entry.bytes) == bool(entry.sha256), where, words)


def _root_bounds(m: Header) -> Iterator[Bound]:
    for q, quality in enumerate(m.qualities):
        least, most = (m.qualities[q - 1].coarser, tables.GRID_BITS) if q else (0, 0)
        yield f"qualities[{q}].coarser", quality.coarser, least, most
    finest, most = 0, m.tiers  # every tier is some level's: the first level has all of them
    for j, level in enumerate(m.levels):
        yield f"levels[{j}].tiers", level.tiers, 1 if j else most, most
        yield f"levels[{j}].quality", level.quality, finest, len(m.qualities) - 1
        most, finest = level.tiers, level.quality


def _group_bounds(m: Header, group: Group) -> Iterator[Bound]:
    fewest, qualities, levels = m.levels[-1].tiers, len(m.qualities), len(m.levels)
    yield "tiers", len(group.tiers), m.tiers, m.tiers
    yield "levels", len(group.levels), levels, levels
    for t, tier in enumerate(group.tiers):
        yield f"tiers[{t}].qualities", len(tier.qualities), qualities, qualities
        yield f"tiers[{t}].pictures", len(tier.pictures), qualities, qualities
    for s, segment in enumerate(group.segments):
        yield f"segments[{s}].levels", len(segment.levels), levels, levels
    yield "static", group.static, 0, group.count
    yield "sum of tier counts", sum(tier.count for tier in group.tiers), group.count, group.count
    first = sum(tier.count for tier in group.tiers[:fewest])
    yield f"rows of the first {fewest} tiers", first, 1, group.count
    layout = keyframe_layout(group)
    yield "grid.step", group.grid.unit, 1 / MOST_NUMBER, MOST_NUMBER
    for t, tier in enumerate(group.tiers):
        for q, atlas in enumerate(tier.qualities):
            where, same = f"tiers[{t}].qualities[{q}]", group.base is not None and not atlas.rows
            yield f"{where}.rows", atlas.rows, 0 if same else tier.count, tier.count
            yield f"len({where}.planes)", len(atlas.planes), min(1, atlas.rows), layout.width(m.colour_channels)
            yield from _atlas_bounds(where, atlas, layout, m.colour_channels)
    for j, atlas in enumerate(group.levels):
        yield f"levels[{j}].rows", atlas.rows, 0, group.count - group.static
        yield from _atlas_bounds(f"levels[{j}]", atlas, DELTA, m.colour_channels)


def _atlas_bounds(where: str, atlas: Atlas, layout: Layout, colours: int) -> Iterator[Bound]:
    channels, attributes = layout.width(colours), len(layout.attributes)
    yield f"len({where}.centres)", len(atlas.centres), channels, channels
    yield f"len({where}.max_error)", len(atlas.max_error), attributes, attributes
    for i, plane in enumerate(atlas.planes):
        yield f"{where}.planes[{i}]", plane, atlas.planes[i - 1] + 1 if i else 0, channels - 1
    if atlas.planes:
        yield f"{where}.plane_width", atlas.plane_width, tables.BLOCK, tables.MAX_PICTURE_SIDE
        yield f"{where}.plane_width % {tables.BLOCK}", atlas.plane_width % tables.BLOCK, 0, 0
        yield f"{where}.columns", atlas.columns, 1, len(atlas.planes)
        yield f"{where}.height", atlas.height, tables.BLOCK, tables.MAX_PICTURE_SIDE
        yield f"{where}.width", atlas.width, tables.BLOCK, max(tables.MIN_PICTURE_SIDE, atlas.size[0])
        yield f"{where}.width % {tables.BLOCK}", atlas.width % tables.BLOCK, 0, 0
        yield f"{where}.height % {tables.BLOCK}", atlas.height % tables.BLOCK, 0, 0
        yield f"{where} macroblocks", atlas.width * atlas.height // tables.BLOCK**2, 1, tables.MAX_MACROBLOCKS
        yield f"{where} width of the planes", atlas.size[0], tables.BLOCK, atlas.width
        yield f"{where} pages", atlas.pages, 1, tables.MAX_PAGES
