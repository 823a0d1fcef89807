"""Tables and the bytes of their files: packing, and strict reading, whose schema is the dataclasses of `tables`.

What is not in their annotations is refused, never ignored or repaired. `references` then checks what no single field
can tell.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
import math
import types
import typing
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from airgs_codec.errors import FormatError, SceneError
from airgs_codec.package.index import Entry
from airgs_codec.package.layout import JSON_NAME, group_path, page_path
from airgs_codec.package.references import check_group, check_keeps, check_page, check_region, check_root
from airgs_codec.package.tables import PAGE, VERSION, Group, Header, Region, Root, Spans, file_entry
from airgs_codec.places.place import got_words


def parse_root(text: bytes) -> Root:
    """The value of an airgs.json. Raises FormatError whose `where` names the place.

    Reasons: not_json, unknown_version, unknown_field, missing_field, wrong_type, bad_value, missing_entry.
    """
    data = _load(text, JSON_NAME)
    if not isinstance(data, dict):
        raise FormatError("wrong_type", JSON_NAME, f"expected an object, got {type(data).__name__}")
    if data.get("version") != VERSION:
        raise FormatError("unknown_version", JSON_NAME, f"expected version {VERSION}, got {data.get('version')!r}")
    root: Root = _parse(Root, data, JSON_NAME)
    check_root(root)
    return root


def parse_page(text: bytes, entry: Entry, where: str) -> Spans:
    """The page of the index with the path `where`, of which the level above says `entry`.

    Raises FormatError as `parse_root` does.
    """
    page: Spans = _parse(Spans, _load(text, where), where)
    check_page(entry, page, where)
    return page


def parse_group(data: bytes, header: Header, entry: Entry, number: int) -> Group:
    """The table of a group, counted from 0, of which the index says `entry`.

    Raises FormatError as `parse_root` does, and too_large.
    """
    where = group_path(number + 1)
    group: Group = _parse(Group, _load(inflate(data, where), where), where)
    check_group(header, entry, group, where)
    check_keeps(group, number, where)
    return group


def _load(data: bytes, where: str) -> Any:
    if len(data) > MAX_TABLE_BYTES or sum(map(data.count, (b",", b"[", b"{"))) > MAX_VALUES:
        detail = f"expected at most {MAX_TABLE_BYTES} bytes of JSON with {MAX_VALUES} commas and opening brackets"
        raise FormatError("too_large", where, detail)
    try:
        return json.loads(data.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise FormatError("not_json", where, f"expected JSON in UTF-8, got {got_words(data, str(error))}") from error


def read_region(path: Path) -> Region:
    """A viewing region from a JSON file, as `region` in airgs.json has it.

    Raises SceneError for a file that cannot be read, FormatError for one that is no region.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot read a viewing region: {error.strerror}") from error
    region: Region = _parse(Region, _load(text, str(path)), str(path))
    check_region(region, str(path))
    return dataclasses.replace(region, source="file")


def read_as(kind: type[Table], data: bytes, where: str) -> Table:
    """Read JSON as a dataclass, whose annotations are its schema. Raises FormatError as `parse_root` does."""
    value: Table = _parse(kind, _load(data, where), where)
    return value


def check_written(region: Region) -> None:
    """Raise FormatError for a region that no reader would take."""
    check_region(_parse(Region, json.loads(_text(region)), "region"), "region")


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")


def _parse(kind: Any, data: Any, where: str) -> Any:
    """`data` as a value of the annotated type `kind`."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        value = _parse(arguments[0], data, where)
        for constraint in arguments[1:]:
            if refusal := constraint.refusal(value):
                raise FormatError("bad_value", where, refusal)
        return value
    if origin is list:
        return [_parse(arguments[0], d, f"{where}[{i}]") for i, d in enumerate(_expect(data, list, where))]
    if origin is tuple:
        data = _expect(data, list, where)
        kinds = arguments[:1] * len(data) if arguments[-1] is ... else arguments
        if len(data) != len(kinds):
            raise FormatError("bad_value", where, f"expected {len(kinds)} values, got {len(data)}")
        return tuple(_parse(kind, d, f"{where}[{i}]") for i, (kind, d) in enumerate(zip(kinds, data, strict=True)))
    if origin is dict:
        name, item = arguments
        data = _expect(data, dict, where)
        return {_parse(name, k, where): _parse(item, d, f"{where}[{k!r}]") for k, d in data.items()}
    if dataclasses.is_dataclass(kind):
        return _parse_dataclass(kind, _expect(data, dict, where), where)
    if kind is float:
        return _parse_float(data, where)
    if kind is int and isinstance(data, float) and data.is_integer():
        return int(data)  # 4.0, which is 4 in JSON Schema and in browsers
    if kind is str and not str.isascii(_expect(data, str, where)):
        return _parse_text(data, where)
    if kind is bool and isinstance(data, bool):
        return data
    return _expect(data, kind, where)


def _parse_dataclass(kind: Any, data: dict[str, Any], where: str) -> Any:
    hints, optional = _fields(kind)
    if unknown := sorted(data.keys() - hints.keys()):
        raise FormatError("unknown_field", where, f"unknown fields {unknown[:8]}")
    if missing := sorted(hints.keys() - optional - data.keys(), key=list(hints).index):
        raise FormatError("missing_field", where, f"missing fields {missing}")
    given = {name: _parse(hints[name], data[name], f"{where}.{name}") for name in hints if name in data}
    return kind(**dict.fromkeys(optional) | given)


@cache
def _fields(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:
    """The types of a dataclass's fields, and which fields may be missing: None stands for them."""
    hints = typing.get_type_hints(kind, include_extras=True)
    required = {name: as_required(hint) for name, hint in hints.items()}
    return required, frozenset(name for name in hints if required[name] is not hints[name])


def as_required(hint: Any) -> Any:
    """T for the type T | None of a field that may be missing; any other type as it is."""
    if typing.get_origin(hint) not in (types.UnionType, typing.Union):
        return hint
    (kind,) = (argument for argument in typing.get_args(hint) if argument is not type(None))
    return kind


def _parse_float(data: Any, where: str) -> float:
    try:
        number = float(_expect(data, (int, float), where))
    except OverflowError:  # an integer of hundreds of digits
        number = math.inf
    if not math.isfinite(number):
        raise FormatError("bad_value", where, "expected a finite number")
    return number


def _parse_text(text: str, where: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError as error:  # half a pair that JSON gave as \ud800
        raise FormatError("bad_value", where, f"expected text, got {text[error.start]!r} alone") from error
    return text


def _expect(data: Any, kind: type | tuple[type, ...], where: str) -> Any:
    if not isinstance(data, kind) or isinstance(data, bool):
        names = kind.__name__ if isinstance(kind, type) else "number"
        raise FormatError("wrong_type", where, f"expected {names}, got {type(data).__name__}")
    return data


Table = typing.TypeVar("Table")
MAX_TABLE_BYTES = 1 << 24  # of JSON: what it may cost is known before it is read
MAX_VALUES = 1 << 21  # commas and opening brackets: a value follows each
_GZIP = 31  # zlib's window bits: the largest window, in a gzip wrapper


def pack_json(table: Root | Spans) -> bytes:
    """The text of airgs.json or of a page."""
    return _text(table)


def pack_group(group: Group) -> bytes:
    """The bytes of group/{n}.json.gz, the same for the same table."""
    return gzip.compress(_text(group), 9, mtime=0)


def _text(table: Any) -> bytes:
    """The JSON of a table; fields that may be missing are left out where they are None."""
    return json.dumps(table, default=as_plain, separators=(",", ":"), allow_nan=False).encode()


def as_plain(table: Any) -> dict[str, Any]:
    """The fields of a dataclass, which JSON knows nothing of. `dataclasses.asdict` would copy every list of numbers."""
    values = ((field.name, getattr(table, field.name)) for field in dataclasses.fields(table))
    return {name: value for name, value in values if value is not None}


def inflate(data: bytes, where: str) -> bytes:
    """The text of a group's table. Raises FormatError: not_json where it is not one gzip member, too_large."""
    inflater = zlib.decompressobj(_GZIP)
    try:
        text = inflater.decompress(data, MAX_TABLE_BYTES + 1)
    except zlib.error as error:
        raise FormatError("not_json", where, f"expected JSON in gzip: {error}") from error
    if len(text) > MAX_TABLE_BYTES:
        raise FormatError("too_large", where, f"expected at most {MAX_TABLE_BYTES} bytes of JSON")
    if not inflater.eof or inflater.unused_data:
        raise FormatError("not_json", where, "expected JSON in one whole gzip member")
    return text


EMPTY = Spans([], [], [], "")


def build_index(groups: Sequence[Group], tables: Sequence[bytes]) -> tuple[list[Spans], dict[str, Spans]]:
    """The index of groups whose tables are these bytes, and its pages by their paths."""
    index: list[Spans] = []
    pages: dict[str, Spans] = {}
    for number, (group, table) in enumerate(zip(groups, tables, strict=True)):
        index, filled = extend_index(index, number, group, table)
        pages |= filled
    return index, pages


def extend_index(
    index: Sequence[Spans], number: int, group: Group, table: bytes
) -> tuple[list[Spans], dict[str, Spans]]:
    """The index with one more group, counted from 0, whose table is these bytes, and the pages that it has filled.

    As with the digits of a number in base PAGE: a level that would have PAGE entries has none, and the one above has
    one more, which is the page that they stand on.
    """
    entry = (group.stop - group.start, len(group.segments), table)
    pages: dict[str, Spans] = {}
    for level, spans in enumerate([*index, EMPTY]):
        full = _with(spans, *entry)
        if len(full) < PAGE:
            return [*[EMPTY] * level, full, *index[level + 1 :]], pages
        pages[page_path(level + 1, (number + 1) // PAGE ** (level + 1))] = full
        entry = sum(full.frames), sum(full.segments), pack_json(full)
    raise AssertionError("the level above all others has one entry")


def _with(spans: Spans, frames: int, segments: int, data: bytes) -> Spans:
    """The columns with one more part, whose file has these bytes."""
    file = file_entry(data)
    return Spans(
        [*spans.frames, frames], [*spans.segments, segments], [*spans.bytes, file.bytes], spans.sha256 + file.sha256
    )
