"""Fragmented MP4, as far as one H.264 track needs it: the box tree, segments, coded samples.

Boxes are those of ISO/IEC 14496-12 (the ISO base media file format) with 32-bit sizes; the decoder configuration is
that of ISO/IEC 14496-15. FFmpeg writes the files (`h264.encode_stream`); reading them here saves its demuxer, which
decodes a picture only to look at it: half of the time of a key unit.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from airgs_codec.errors import CodecError

Box = tuple[bytes, bytes]  # type, and the whole box with its header

HEADER = 8  # bytes of size and type
# The way to the decoder configuration: box types, and the bytes before the boxes inside each.
_TO_AVCC = ((b"moov", 8), (b"trak", 8), (b"mdia", 8), (b"minf", 8), (b"stbl", 8), (b"stsd", 16), (b"avc1", 86))
_LEAST_AVCC = 7  # bytes of an AVCDecoderConfigurationRecord without parameter sets
# Flags of a trun box, 8.8.8: which fields it has; those from 0x100 on are repeated for every sample.
_DATA_OFFSET, _FIRST_SAMPLE_FLAGS, _DURATION, _SIZE = 0x1, 0x4, 0x100, 0x200
# Flags of a tfhd box, 8.8.7.
_BASE_DATA_OFFSET, _DESCRIPTION_INDEX, _DEFAULT_DURATION, _DEFAULT_SIZE = 0x1, 0x2, 0x8, 0x10


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


def split_segments(data: bytes) -> tuple[bytes, list[bytes]]:
    """The init segment (ftyp and moov) of a fragmented file, and its media segments (moof and mdat each)."""
    boxes = read_boxes(data)
    media: list[bytes] = []
    for kind, box in boxes:
        if kind == b"moof":
            media.append(box)
        elif kind == b"mdat":
            media[-1] += box
    return b"".join(box for kind, box in boxes if kind in (b"ftyp", b"moov")), media


def avc_configuration(init: bytes) -> bytes:
    """The AVCDecoderConfigurationRecord of an init segment's first track. Raises CodecError when it is not whole."""
    data = init
    for kind, skipped in _TO_AVCC:
        data = _child(data, kind)[skipped:]
    record = _child(data, b"avcC")[HEADER:]
    if len(record) < _LEAST_AVCC:
        raise CodecError(f"the avcC box of the init segment has {len(record)} bytes, expected at least {_LEAST_AVCC}")
    return record


def codecs_string(init: bytes) -> str:
    """The codecs parameter (RFC 6381) of an init segment: avc1, then profile, constraints and level in hexadecimal."""
    return "avc1." + avc_configuration(init)[1:4].hex().upper()


def read_samples(media: bytes) -> Iterator[bytes]:
    """The coded pictures of a media segment of one moof and one mdat, in decoding order.

    Raises CodecError when the segment is built otherwise or a sample leaves the mdat.
    """
    boxes = read_boxes(media)
    if [kind for kind, _ in boxes] != [b"moof", b"mdat"]:
        raise CodecError(f"expected one moof and one mdat, got {[kind for kind, _ in boxes]}")
    moof, payload = boxes[0][1], boxes[1][1][HEADER:]
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
    if not flags & _DATA_OFFSET or offset != payload_offset:
        raise CodecError("the samples do not follow the moof")
    stride = 4 * (flags >> 8 & 0xF).bit_count()
    first = 20 + 4 * bool(flags & _FIRST_SAMPLE_FLAGS) + 4 * bool(flags & _DURATION)
    for number in range(count):
        yield _unpack(">I", run, first + number * stride)[0] if flags & _SIZE else default


def _default_sample_size(header: bytes) -> int:
    """The default sample size of a tfhd box; 0 when it has none."""
    flags = _unpack(">I", header, 8)[0]
    at = 16 + 8 * bool(flags & _BASE_DATA_OFFSET) + 4 * bool(flags & _DESCRIPTION_INDEX)
    at += 4 * bool(flags & _DEFAULT_DURATION)
    return int(_unpack(">I", header, at)[0]) if flags & _DEFAULT_SIZE else 0


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
