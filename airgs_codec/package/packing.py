"""Tables <-> the bytes of their files. `parse` reads the JSON within."""

from __future__ import annotations

import dataclasses
import gzip
import json
import zlib
from collections.abc import Sequence
from typing import Any

from airgs_codec.errors import FormatError
from airgs_codec.package.paths import page_path
from airgs_codec.package.tables import PAGE, Group, Root, Spans, file_entry

MAX_ROOT_BYTES = 1 << 24
MAX_TABLE_BYTES = 1 << 28  # of a group's table, inflated
_GZIP = 31  # zlib's window bits: the largest window, in a gzip wrapper


def pack_json(table: Root | Spans) -> bytes:
    """The text of airgs.json or of a page."""
    return _text(table)


def pack_group(group: Group) -> bytes:
    """The bytes of group/{n}.json.gz, the same for the same table."""
    return gzip.compress(_text(group), 9, mtime=0)


def _text(table: Any) -> bytes:
    """The JSON of a table; fields that may be missing are left out where they are None."""
    return json.dumps(table, default=_as_dict, separators=(",", ":"), allow_nan=False).encode()


def _as_dict(table: Any) -> dict[str, Any]:
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
