"""One change by chance somewhere in the layers of a file; what lies around it is made anew.

A layer is what some bytes consist of: a gzip member of its text, an MP4 file of boxes, a .ply of lines and rows. Its
parts are joined again with the lengths, digests and checksums that belong to them, so that what lies behind these is
reached.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from airgs_codec.media.mp4 import OWN_UUID, CodedPicture, box, media_segment, read_segment

Part = tuple[int, bytes]  # which of the parts that were found it was, and what it is now
Layer = tuple[list[bytes], Callable[[list[Part]], bytes]]  # the parts, and what joins some, in any order
VALUES: list[Any] = [
    None, True, -1, 0, 1, 2, 3, 7, 255, 256, 1 << 16, 1 << 24, 1 << 31, (1 << 31) - 1, 1 << 63, 10**30, 10**400, 0.5,
    -0.0, 1e-30, 1e308, -1e308, float("nan"), "", "x", "1/0", "\ud800", "../../etc/passwd", "A" * 32, [], {}, [0],
    [[0]], [1, 2, 3], {"a": 1}, [[]] * 999, "DEEP",
]  # fmt: skip
NUMBERS = (0, 1, 2, 127, 255, 256, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 62, -1, 0x7F800000, 0x7FC00000)


def mutate(chance: random.Random, data: bytes, other: bytes) -> bytes:
    """The bytes after one change in one of their layers; `other`: bytes that may take the place of some."""
    if chance.random() < 0.06 or (layer := _open(chance, data)) is None:
        with suppress(Exception):
            if data.lstrip()[:1] in (b"{", b"[") and chance.random() < 0.93:
                return mutate_json(chance, data)
        return mutate_bytes(chance, data, other)
    parts, join = list(enumerate(layer[0])), layer[1]
    there = chance.randrange(len(parts))
    here = chance.choice((there, chance.randrange(len(parts)), len(parts) - 1))
    match chance.randrange(24):
        case 0:
            del parts[here]
        case 1:
            parts.insert(there, parts[here])
        case 2:
            parts[here], parts[there] = parts[there], parts[here]
        case _:
            parts[here] = parts[here][0], mutate(chance, parts[here][1], other)
    with suppress(Exception):
        return join(parts)
    return mutate_bytes(chance, data, other)  # where a length does not fit its field


def _open(chance: random.Random, data: bytes) -> Layer | None:
    """One of the layers that these bytes are; None where they are none."""
    found = []
    for magic, opener in LAYERS:
        with suppress(Exception):
            if data.startswith(magic) and (layer := opener(data))[0]:
                found.append(layer)
    return chance.choice(found) if found else None


def _plain(parts: list[Part]) -> bytes:
    return b"".join(part for _, part in parts)


def _zip(data: bytes) -> Layer:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        contents = [archive.read(name) for name in names]

    def join(parts: list[Part]) -> bytes:
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as archive:
            for number, part in parts:
                archive.writestr(names[number], part)
        return out.getvalue()

    return contents, join


def _records(at: int, form: str, place: int, more: int, data: bytes, end: bytes = b"") -> Layer:
    """Parts from `at` on, each behind its head in a `form` with its length at a `place`, which counts `more` bytes."""
    start, heads, contents, width = data[:at], [], [], struct.calcsize(form)
    while at < len(data) - len(end):
        heads.append(list(struct.unpack_from(form, data, at)))
        stop = at + width + heads[-1][place] - more
        if not at + width <= stop <= len(data) - len(end):
            raise ValueError("no records")
        contents.append(data[at + width : stop])
        at = stop

    def join(parts: list[Part]) -> bytes:
        out = [start]
        for number, part in parts:
            heads[number][place] = len(part) + more
            out += [struct.pack(form, *heads[number]), part]
        return b"".join(out) + end

    return contents, join


def _headed(at: int, width: int, data: bytes) -> Layer:
    """A header behind its length, `width` bytes from `at` on, and the rest."""
    start = at + width
    stop = start + int.from_bytes(data[at:start], "little")
    if not start < stop < len(data):
        raise ValueError("no header")

    def join(parts: list[Part]) -> bytes:
        size = len(parts[0][1]) if parts else 0
        return data[:at] + size.to_bytes(width, "little") + _plain(parts)

    return [data[start:stop], data[stop:]], join


def _sealed(data: bytes) -> Layer:
    if hashlib.sha256(data[32:]).digest() != data[:32]:
        raise ValueError("no digest")
    return [data[32:]], lambda parts: hashlib.sha256(_plain(parts)).digest() + _plain(parts)


def _segment(data: bytes) -> Layer:
    """Our own bytes, and the samples of a media segment; its boxes are made anew."""
    own = data[8 + len(OWN_UUID) : int.from_bytes(data[:4], "big")]

    def join(parts: list[Part]) -> bytes:
        samples = [part for number, part in parts if number]
        coded = [CodedPicture(sample, at, len(sample), at == 0) for at, sample in enumerate(samples)]
        return box(b"uuid", OWN_UUID, *(part for number, part in parts if not number)) + media_segment(coded, 0, 1)

    return [own, *read_segment(data).samples], join


def _boxes(data: bytes) -> Layer:
    if not re.match(rb"....(uuid|moof|mfhd|traf|tfhd|ftyp|mvhd|tkhd|mdhd|vmhd|dref|stsd|trex|avc3)", data, re.DOTALL):
        raise ValueError("no boxes")
    return _records(0, ">I4s", 0, 8, data)


def _ply(data: bytes) -> Layer:
    head, mark, rows = data.partition(b"end_header\n")
    return [*head.splitlines(True), mark, rows], _plain


LAYERS: tuple[tuple[bytes, Callable[[bytes], Layer]], ...] = (
    (b"\x1f\x8b", lambda data: ([gzip.decompress(data)], lambda parts: gzip.compress(_plain(parts), 1, mtime=0))),
    (b"PK\3\4", _zip),
    (b"ply\n", _ply),
    (b"\x894DGS", lambda data: _records(8, "<BQ", 1, 0, data, data[:8] if data.endswith(data[:8]) else b"")),
    (b"glTF", partial(_records, 12, "<II", 0, 0)),
    (b"SP4D", partial(_headed, 8, 4)),
    (b"Kg\0\0", partial(_headed, 4, 4)),  # .splatv
    (b"\x93NUMPY", partial(_headed, 8, 2)),
    (b"NGSP", lambda data: ([data[:8], data[8:16], data[16:]], _plain)),
    (b"", _sealed),
    (b"", lambda data: _headed(0, 8, data) if data[8:10] == b'{"' else ([], _plain)),  # a stored value
    (b"", _segment),
    (b"", _boxes),
    (b"\0", partial(_records, 0, ">I", 0, 0)),  # NAL units
)


def mutate_bytes(chance: random.Random, data: bytes, other: bytes) -> bytes:
    """One change: bits, bytes, numbers, words, pieces cut, doubled, cut short or taken from elsewhere."""
    at, size = chance.randrange(len(data) + 1), 1 << chance.randrange(7)
    head, piece, rest = data[:at], data[at : at + size], data[at + size :]
    start, width = chance.randrange(len(other) or 1), chance.choice((1, 2, 4, 8))
    number = chance.choice(NUMBERS) & ((1 << 8 * width) - 1)
    match chance.randrange(9):
        case 0:
            flips = b"".join(bytes([byte ^ (1 << chance.randrange(8))]) for byte in piece[:2])
            return head + flips + data[at + len(flips) :]
        case 1:
            return head + number.to_bytes(width, chance.choice(("big", "little"))) + data[at + width :]
        case 2:
            return head + rest
        case 3:
            return head + piece * chance.choice((2, 2, 2, 1 << 14)) + rest
        case 4:
            return head
        case 5:
            return head + other[start : start + size] + rest
        case 6:
            return head + chance.randbytes(len(piece)) + rest
        case 7:
            return head + other[start : start + size] + piece + rest
        case _:
            words = list(re.finditer(rb"\d+", data[: 1 << 14])) or [*re.finditer(b"$", data)]
            word, value = chance.choice(words), str(chance.choice((*NUMBERS, 0.5, 1e308, "x"))).encode()
            return data[: word.start()] + value + data[word.end() :]


def mutate_json(chance: random.Random, text: bytes) -> bytes:
    """One or two values somewhere in a JSON document replaced, dropped, doubled or moved a little."""
    document = json.loads(text)
    for _ in range(chance.choice((1, 1, 1, 2))):
        here = document
        while isinstance(here, (dict, list)) and here:
            key = chance.choice(list(here) if isinstance(here, dict) else range(len(here)))
            if not (isinstance(here[key], (dict, list)) and here[key] and chance.random() < 0.85):
                _change(chance, here, key)
                break
            here = here[key]
    out = json.dumps(document, separators=(",", ":")).encode()
    return out.replace(b'"DEEP"', b"[" * 99_999 + b"]" * 99_999)


def _change(chance: random.Random, here: Any, key: Any) -> None:
    value, kind = here[key], chance.choice((0, 1, 2, 2, 2, 3, 4))
    if kind == 0:
        del here[key]
    elif kind == 1 and isinstance(here, list):
        here[key:key] = [value] * chance.choice((1, 1, 1, 1 + (1 << 20) // len(repr(value))))
    elif kind == 2 and isinstance(value, (int, float)):
        here[key] = value + chance.choice((-1, 1, 16, 256, -value, value))
    elif kind == 3 and isinstance(value, str) and value:
        here[key] = value[:-1] + chance.choice("xA0/")
    else:
        here[key] = chance.choice(VALUES)
