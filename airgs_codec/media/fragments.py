"""Fragmented MP4, written: one init segment for all tracks of a package, and a media segment a closed GOP.

Boxes are those of ISO/IEC 14496-12; the sample entry avc3 of ISO/IEC 14496-15 says that parameter sets travel with the
pictures, so that no segment needs the init segment to be decoded, and pictures may change their size.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from airgs_codec.media.mp4 import COLUMNS, COMPOSITION_OFFSET, DATA_OFFSET, DURATION, FIRST_SAMPLE_FLAGS, HEADER, SIZE

PROFILE, CONSTRAINTS, LEVEL = 100, 0, 51  # High at 5.1: the most that a picture of a package may ask for
CODECS = f"avc3.{PROFILE:02X}{CONSTRAINTS:02X}{LEVEL:02X}"  # RFC 6381
_DEFAULT_BASE_IS_MOOF = 0x020000  # flags of tfhd
_DURATION_AND_FLAGS = 0x8 | 0x20  # of tfhd: defaults of all samples
_SYNC, _OTHER = 0x02000000, 0x01010000  # sample flags: depends on nothing; depends on others and is no sync sample
_UNITY = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)  # the matrix that turns nothing


@dataclass(frozen=True, slots=True)
class CodedPicture:
    """One picture of a closed GOP."""

    data: bytes  # its parameter sets and slices: NAL units, each after its length in 4 bytes
    number: int  # its place in display order
    bytes: int  # of its slices with their lengths
    idr: bool


def init_segment(timescale: int, width: int, height: int) -> bytes:
    """ftyp and moov of a track without samples; `timescale` ticks a second, pictures of about this size."""
    return box(b"ftyp", b"iso6", struct.pack(">I", 0), b"iso6", b"cmfc", b"dash") + box(
        b"moov",
        full_box(b"mvhd", 0, struct.pack(">4I", 0, 0, timescale, 0), _PLAYBACK, _UNITY, bytes(24), _word(2)),
        _track(timescale, width, height),
        box(b"mvex", full_box(b"trex", 0, struct.pack(">5I", 1, 1, 0, 0, 0))),
    )


_PLAYBACK = struct.pack(">IH", 0x10000, 0x100) + bytes(10)  # rate 1, volume 1


def _track(timescale: int, width: int, height: int) -> bytes:
    header = struct.pack(">5I", 0, 0, 1, 0, 0) + bytes(16) + _UNITY + struct.pack(">2I", width << 16, height << 16)
    return box(
        b"trak",
        full_box(b"tkhd", 3, header),
        box(
            b"mdia",
            full_box(b"mdhd", 0, struct.pack(">4I2H", 0, 0, timescale, 0, 0x55C4, 0)),
            full_box(b"hdlr", 0, bytes(4), b"vide", bytes(12), b"\0"),
            box(
                b"minf",
                full_box(b"vmhd", 1, bytes(8)),
                box(b"dinf", full_box(b"dref", 0, _word(1), full_box(b"url ", 1))),
                _sample_table(width, height),
            ),
        ),
    )


def _sample_table(width: int, height: int) -> bytes:
    record = bytes([1, PROFILE, CONSTRAINTS, LEVEL, 0xFF, 0xE0, 0, 0xFD, 0xF8, 0xF8, 0])  # no sets; 4:2:0 of 8 bits
    colour = box(b"colr", b"nclx", struct.pack(">3HB", 2, 2, 2, 0x80))  # unspecified but for the full range
    entry = bytes(6) + struct.pack(">H", 1) + bytes(16) + struct.pack(">2H", width, height)
    entry += struct.pack(">3IH", 0x480000, 0x480000, 0, 1) + bytes(32) + struct.pack(">Hh", 24, -1)
    empty = [full_box(kind, 0, _word(0)) for kind in (b"stts", b"stsc", b"stco")]
    return box(
        b"stbl",
        full_box(b"stsd", 0, _word(1), box(b"avc3", entry, box(b"avcC", record), colour)),
        *empty,
        full_box(b"stsz", 0, bytes(8)),
    )


def media_segment(pictures: Sequence[CodedPicture], start: int, ticks: int) -> bytes:
    """moof and mdat of pictures in decoding order, from an IDR on, which begin at `start` and last `ticks` each.

    Every further IDR begins the next page of the same pictures: together the pages of a picture last as long as one
    would.
    """
    pages = sum(picture.idr for picture in pictures)
    durations = [ticks // pages] * (len(pictures) - len(pictures) // pages)
    durations += [ticks - ticks // pages * (pages - 1)] * (len(pictures) // pages)
    offsets = [(p.number - place) * lasts for place, (p, lasts) in enumerate(zip(pictures, durations, strict=True))]
    columns = {
        DURATION: (durations if pages > 1 else []),
        SIZE: [len(picture.data) for picture in pictures],
        COMPOSITION_OFFSET: (offsets if any(offsets) else []),
    }
    flags = DATA_OFFSET | FIRST_SAMPLE_FLAGS | sum(flag for flag, column in columns.items() if column)
    rows = [struct.pack(f">{len(row)}i", *row) for row in zip(*filter(None, columns.values()), strict=True)]
    traf = _DEFAULT_BASE_IS_MOOF | _DURATION_AND_FLAGS
    head = full_box(b"tfhd", traf, struct.pack(">3I", 1, ticks, _OTHER))
    head += full_box(b"tfdt", 1 << 24, struct.pack(">Q", start))
    moof_bytes = HEADER + 16 + HEADER + len(head) + 24 + sum(map(len, rows))
    run = struct.pack(">IiI", len(rows), moof_bytes + HEADER, _SYNC)
    traf_box = box(b"traf", head, full_box(b"trun", 1 << 24 | flags, run, *rows))
    moof = box(b"moof", full_box(b"mfhd", 0, _word(1)), traf_box)
    return moof + box(b"mdat", *(picture.data for picture in pictures))


def with_columns(media: bytes, columns: bytes) -> bytes:
    """A media segment behind a column file in a uuid box; empty columns make none."""
    return (box(b"uuid", COLUMNS, columns) if columns else b"") + media


def box(kind: bytes, *content: bytes) -> bytes:
    """A box of a type around its content."""
    data = b"".join(content)
    return struct.pack(">I4s", HEADER + len(data), kind) + data


def full_box(kind: bytes, version_and_flags: int, *content: bytes) -> bytes:
    """A box whose content begins with a version and flags."""
    return box(kind, _word(version_and_flags), *content)


def _word(number: int) -> bytes:
    return struct.pack(">I", number)
