"""Tables <-> the bytes of their files. `parse` reads the JSON within."""

from __future__ import annotations

import dataclasses
import gzip
import json
import zlib
from collections.abc import Sequence
from typing import Any

from airgs_codec.errors import FormatError
from airgs_codec.package.tables import PAGE, Group, Index, Root, Spans, file_entry

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
    return json.dumps(dataclasses.asdict(table), separators=(",", ":"), allow_nan=False).encode()


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


def build_index(groups: Sequence[Group], tables: Sequence[bytes]) -> tuple[Index, list[Spans]]:
    """The index of groups whose tables are these bytes, and its pages."""
    whole = len(groups) // PAGE * PAGE
    cuts = [slice(start, start + PAGE) for start in range(0, whole, PAGE)]
    pages = [_spans(groups[cut], tables[cut]) for cut in cuts]
    frames, segments = ([sum(getattr(page, name)) for page in pages] for name in ("frames", "segments"))
    columns = _columns(frames, segments, [pack_json(page) for page in pages])
    return Index(columns, _spans(groups[whole:], tables[whole:])), pages


def _spans(groups: Sequence[Group], tables: Sequence[bytes]) -> Spans:
    return _columns([g.stop - g.start for g in groups], [len(g.segments) for g in groups], tables)


def _columns(frames: list[int], segments: list[int], files: Sequence[bytes]) -> Spans:
    entries = [file_entry(data) for data in files]
    return Spans(frames, segments, [e.bytes for e in entries], "".join(e.sha256 for e in entries))
