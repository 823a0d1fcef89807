"""Fragmented MP4, read as far as one H.264 track needs it: the box tree, coded samples, and what stands beside them.

Boxes are those of ISO/IEC 14496-12 (the ISO base media file format) with 32-bit sizes. `fragments` writes them. A media
segment is a moof and an mdat, and in front of them at most one uuid box with bytes of our own (FORMAT.md, section 4).
"""

from __future__ import annotations

import struct
import uuid
from collections.abc import Iterator
from dataclasses import dataclass

from airgs_codec.errors import CodecError

Box = tuple[bytes, bytes]  # type, and the whole box with its header

HEADER = 8  # bytes of size and type
COLUMNS = uuid.uuid5(uuid.NAMESPACE_URL, "urn:airgs:columns").bytes  # 3ecfa94e-…: the uuid box holds a column file
# Flags of a trun box, 8.8.8: which fields it has; those from 0x100 on are repeated for every sample.
DATA_OFFSET, FIRST_SAMPLE_FLAGS, DURATION, SIZE, COMPOSITION_OFFSET = 0x1, 0x4, 0x100, 0x200, 0x800
# Flags of a tfhd box, 8.8.7.
BASE_DATA_OFFSET, DESCRIPTION_INDEX, DEFAULT_DURATION, DEFAULT_SIZE = 0x1, 0x2, 0x8, 0x10


@dataclass(frozen=True, slots=True)
class Segment:
    """What a media segment holds."""

    columns: bytes | None  # of its uuid box; None: it has none
    samples: tuple[bytes, ...]  # coded pictures in decoding order: NAL units, each after its length in 4 bytes


def read_boxes(data: bytes) -> list[Box]:
    """The boxes that follow one another in `data`. Raises CodecError where a size leaves the data."""
    boxes, at = [], 0
    while at < len(data):
        size, kind = _unpack(">I4s", data, at)
        if size < HEADER or at + size > len(data):
            raise CodecError(f"a box {kind!r} of {size} bytes at {at} of {len(data)}")
        boxes.append((kind, data[at : at + size]))
        at += size
    return boxes


def read_segment(media: bytes) -> Segment:
    """The parts of a media segment.

    Raises CodecError when the segment is built otherwise or a sample leaves the mdat.
    """
    boxes = read_boxes(media)
    columns = None
    if boxes and boxes[0][0] == b"uuid":
        own = boxes.pop(0)[1][HEADER:]
        columns = own[len(COLUMNS) :]
        if not own.startswith(COLUMNS):
            raise CodecError(f"expected the uuid {uuid.UUID(bytes=COLUMNS)}, got {own[: len(COLUMNS)].hex()}")
    if [kind for kind, _ in boxes] != [b"moof", b"mdat"]:
        raise CodecError(f"expected one moof and one mdat, got {[kind for kind, _ in boxes]}")
    return Segment(columns, tuple(_samples(boxes[0][1], boxes[1][1][HEADER:])))


def start_codes(sample: bytes) -> bytes:
    """A sample as a stream of its own (ISO/IEC 14496-10, Annex B): a start code in place of every length.

    Raises CodecError where a NAL unit leaves the sample.
    """
    units, at = [], 0
    while at < len(sample):
        (size,) = _unpack(">I", sample, at)
        if not 0 < size <= len(sample) - at - 4:
            raise CodecError(f"a NAL unit of {size} bytes at {at} of {len(sample)}")
        units.append(b"\0\0\0\1" + sample[at + 4 : at + 4 + size])
        at += 4 + size
    return b"".join(units)


def _samples(moof: bytes, payload: bytes) -> Iterator[bytes]:
    """The samples that a moof finds in the payload of the mdat behind it."""
    fragment = _child(moof[HEADER:], b"traf")[HEADER:]
    at = 0
    for number, size in enumerate(_sample_sizes(fragment, len(moof) + HEADER)):
        if not 0 < size <= len(payload) - at:
            raise CodecError(f"sample {number} of {size} bytes at {at} of {len(payload)}")
        yield payload[at : at + size]
        at += size


def _sample_sizes(fragment: bytes, payload_offset: int) -> Iterator[int]:
    """Bytes of each sample of a track fragment; the first must begin `payload_offset` bytes after the moof begins."""
    default = _default_sample_size(_child(fragment, b"tfhd"))
    run = _child(fragment, b"trun")
    flags, count, offset = _unpack(">IIi", run, 8)
    if not flags & DATA_OFFSET or offset != payload_offset:
        raise CodecError("the samples do not follow the moof")
    stride = 4 * (flags >> 8 & 0xF).bit_count()
    first = 20 + 4 * bool(flags & FIRST_SAMPLE_FLAGS) + 4 * bool(flags & DURATION)
    for number in range(count):
        yield _unpack(">I", run, first + number * stride)[0] if flags & SIZE else default


def _default_sample_size(header: bytes) -> int:
    """The default sample size of a tfhd box; 0 when it has none."""
    flags = _unpack(">I", header, 8)[0]
    at = 16 + 8 * bool(flags & BASE_DATA_OFFSET) + 4 * bool(flags & DESCRIPTION_INDEX)
    at += 4 * bool(flags & DEFAULT_DURATION)
    return int(_unpack(">I", header, at)[0]) if flags & DEFAULT_SIZE else 0


def _child(data: bytes, kind: bytes) -> bytes:
    """The first box of this type in `data`. Raises CodecError when there is none."""
    for found, box in read_boxes(data):
        if found == kind:
            return box
    raise CodecError(f"expected a box {kind.decode()}, got none")


def _unpack(form: str, data: bytes, at: int) -> tuple:
    """`struct.unpack_from` that says where a box ends too early. Raises CodecError."""
    if at + struct.calcsize(form) > len(data):
        raise CodecError(f"a box ends after {len(data)} bytes, expected {struct.calcsize(form)} at {at}")
    return struct.unpack_from(form, data, at)
