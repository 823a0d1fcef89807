"""Fragmented MP4 as far as a track of H.264 or Opus needs it, read and written: the box tree and coded samples.

Boxes are those of ISO/IEC 14496-12 (the ISO base media file format) with 32-bit sizes: one init segment for all tracks
of a package, and a media segment a closed GOP. The sample entry avc3 of ISO/IEC 14496-15 says that parameter sets
travel with the pictures, so that no segment needs the init segment to be decoded, and pictures may change their size.
A media segment is a uuid box with our own bytes, a moof and an mdat (FORMAT.md, section 2).
"""

from __future__ import annotations

import base64
import struct
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from airgs_codec.errors import CodecError

Box = tuple[bytes, bytes]  # type, and the whole box with its header

HEADER = 8  # bytes of size and type
OWN_UUID = uuid.uuid5(uuid.NAMESPACE_URL, "urn:airgs:media").bytes  # of the uuid box with checksums and a column file
# Flags of a trun box, 8.8.8: which fields it has; those from 0x100 on are repeated for every sample.
DATA_OFFSET, FIRST_SAMPLE_FLAGS, DURATION, SIZE, COMPOSITION_OFFSET = 0x1, 0x4, 0x100, 0x200, 0x800
# Flags of a tfhd box, 8.8.7, as the browser player reads it.
BASE_DATA_OFFSET, DESCRIPTION_INDEX, DEFAULT_DURATION, DEFAULT_SIZE = 0x1, 0x2, 0x8, 0x10
PROFILE, CONSTRAINTS, LEVEL = 100, 0, 51  # High at 5.1: the most that a picture of a package may ask for
CODECS = f"avc3.{PROFILE:02X}{CONSTRAINTS:02X}{LEVEL:02X}"  # RFC 6381
OPUS = "opus"  # RFC 6381
SOUND_RATE = 48_000  # samples, and ticks, a second
PACKET_TICKS = 960  # 20 ms
WARM_UP = 4  # packets that a decoder of Opus needs before the first one that is right
_DEFAULT_BASE_IS_MOOF = 0x020000  # flags of tfhd
_DURATION_AND_FLAGS = DEFAULT_DURATION | 0x20  # of tfhd: defaults of all samples
_SYNC, _OTHER = 0x02000000, 0x01010000  # sample flags: depends on nothing; depends on others and is no sync sample
_GREY = base64.b64decode(  # an IDR picture of 64x64 grey samples with its parameter sets: a sample of a track of H.264
    "AAAAF2dkAAqstCE02QAAAwABAAADADwPEiagAAAABWjvAzywAAAAGGWIhK/+9dnjxcMJ25ojZkJMaU8x1QMnGw=="
)
_PARENTS = (b"moof", b"traf", b"moov", b"trak", b"edts", b"mdia", b"minf", b"dinf", b"stbl", b"mvex")  # boxes of boxes
_UNITY = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)  # the matrix that turns nothing


@dataclass(frozen=True, slots=True)
class MediaSegment:
    checksums: tuple[int, ...]  # of the luma of each sample, each page in display order
    columns: bytes | None  # a column file; None: every number in it is 0
    samples: tuple[bytes, ...]  # coded pictures in decoding order: NAL units, each after its length in 4 bytes


@dataclass(frozen=True, slots=True)
class CodedPicture:
    data: bytes  # its parameter sets and slices: NAL units, each after its length in 4 bytes
    number: int  # its place in display order
    bytes: int  # of its slices with their lengths
    idr: bool


def read_boxes(data: bytes) -> list[Box]:
    """Return the boxes that follow one another in `data`. Raises CodecError where a size leaves the data."""
    boxes, at = [], 0
    while at < len(data):
        size, kind = _unpack(">I4s", data, at)
        if size < HEADER or at + size > len(data):
            raise CodecError(f"a box {kind!r} of {size} bytes at {at} of {len(data)}")
        boxes.append((kind, data[at : at + size]))
        at += size
    return boxes


def read_segment(media: bytes) -> MediaSegment:
    """Return the parts of a media segment. Raises CodecError when it is built otherwise or a sample leaves the mdat."""
    boxes = read_boxes(media)
    if not boxes or not (own := boxes[0][1][HEADER:]).startswith(OWN_UUID):
        raise CodecError(f"expected a box of the uuid {uuid.UUID(bytes=OWN_UUID)} at the start")
    samples = read_samples(media[len(boxes[0][1]) :])
    columns = len(OWN_UUID) + 4 * len(samples)
    return MediaSegment(_unpack(f">{len(samples)}I", own, len(OWN_UUID)), own[columns:] or None, samples)


def read_samples(fragment: bytes) -> tuple[bytes, ...]:
    """Return the samples of a moof and its mdat, in decoding order. Raises CodecError as `read_segment` does."""
    boxes = read_boxes(fragment)
    if (kinds := [kind for kind, _ in boxes]) != [b"moof", b"mdat"]:
        raise CodecError(f"expected one moof and one mdat, got {kinds[:8]}")
    moof, payload = boxes[0][1], boxes[1][1][HEADER:]
    run = _inside(moof, b"traf", b"trun")
    flags, count, offset = _unpack(">IIi", run, 0)
    if not flags & DATA_OFFSET or not flags & SIZE or offset != len(moof) + HEADER:
        raise CodecError("the samples do not follow the moof, or have no sizes")
    stride = 4 * (flags >> 8 & 0xF).bit_count()
    first = 12 + 4 * bool(flags & FIRST_SAMPLE_FLAGS) + 4 * bool(flags & DURATION)
    samples, at = [], 0
    for number in range(count):
        size = _unpack(">I", run, first + number * stride)[0]
        if not 0 < size <= len(payload) - at:
            raise CodecError(f"sample {number} of {size} bytes at {at} of {len(payload)}")
        samples.append(payload[at : at + size])
        at += size
    return tuple(samples)


def read_start(fragment: bytes) -> int:
    """Return when the first sample of a moof is decoded, ticks. Raises CodecError as `read_segment` does."""
    return int(_unpack(">Q", _inside(read_boxes(fragment)[0][1], b"traf", b"tfdt"), 4)[0])


def units_of(sample: bytes) -> list[bytes]:
    """Return the NAL units of a sample, each without its length. Raises CodecError when a length leaves the sample."""
    units, at = [], 0
    while at < len(sample):
        size, at = _unpack(">I", sample, at)[0], at + 4
        if not 0 < size <= len(sample) - at:
            raise CodecError(f"a NAL unit of {size} bytes at {at - 4} of {len(sample)}")
        units.append(sample[at : at + size])
        at += size
    return units


def start_codes(sample: bytes) -> bytes:
    """Return the NAL units of a sample as a byte stream (ISO/IEC 14496-10, Annex B). Raises CodecError."""
    return b"".join(b"\0\0\0\1" + unit for unit in units_of(sample))


def check_boxes(expected: bytes, got: bytes, inside: str = "the file") -> None:
    """Raise CodecError with the first box of `got`, and the number in it, that is not as in `expected`."""
    boxes, others = read_boxes(expected), read_boxes(got)
    if (kinds := [kind for kind, _ in boxes]) != (found := [kind for kind, _ in others]):
        raise CodecError(f"expected the boxes {kinds} in {inside}, got {found[:8]}")
    for (kind, box_), (_, other) in zip(boxes, others, strict=True):
        name = kind.decode()
        if box_ != other and kind in _PARENTS:
            check_boxes(box_[HEADER:], other[HEADER:], name)
        elif len(box_) != len(other):
            raise CodecError(f"expected a box {name} of {len(box_)} bytes, got {len(other)}")
        elif box_ != other:
            at = next(at for at, (byte, other_byte) in enumerate(zip(box_, other, strict=True)) if byte != other_byte)
            at, stop = (12, 20) if kind == b"tfdt" and at >= 12 else (at // 4 * 4, at // 4 * 4 + 4)
            wanted, number = (int.from_bytes(data[at:stop]) for data in (box_, other))
            raise CodecError(f"box {name}, byte {at}: expected {wanted}, got {number}")


def _inside(whole: bytes, *kinds: bytes) -> bytes:
    for kind in kinds:
        boxes = [box for found, box in read_boxes(whole[HEADER:]) if found == kind]
        if not boxes:
            raise CodecError(f"expected a box {kind.decode()}, got none")
        whole = boxes[0]
    return whole[HEADER:]


def _unpack(form: str, data: bytes, at: int) -> tuple:
    """Unpack as `struct.unpack_from`. Raises CodecError where a box ends too early."""
    if at + struct.calcsize(form) > len(data):
        raise CodecError(f"a box ends after {len(data)} bytes, expected {struct.calcsize(form)} at {at}")
    return struct.unpack_from(form, data, at)


def init_segment(timescale: int, width: int, height: int) -> bytes:
    """Return ftyp and moov of a track without samples; `timescale` ticks a second, pictures of about this size."""
    size = struct.pack(">2I", width << 16, height << 16)
    record = bytes([1, PROFILE, CONSTRAINTS, LEVEL, 0xFF, 0xE0, 0, 0xFD, 0xF8, 0xF8, 0])  # no sets; 4:2:0 of 8 bits
    colour = box(b"colr", b"nclx", struct.pack(">3HB", 2, 2, 2, 0x80))  # unspecified but for the full range
    entry = bytes(6) + struct.pack(">H", 1) + bytes(16) + struct.pack(">2H", width, height)
    entry += struct.pack(">3IH", 0x480000, 0x480000, 0, 1) + bytes(32) + struct.pack(">Hh", 24, -1)
    media = _handler(b"vide"), full_box(b"vmhd", 1, bytes(8)), box(b"avc3", entry, box(b"avcC", record), colour), b""
    return _init(timescale, bytes(16) + _UNITY + size, b"", media)


def sound_init(channels: int, pre_skip: int) -> bytes:
    """Return ftyp and moov of a track of Opus in which `pre_skip` ticks are not heard (Opus in ISO BMFF)."""
    header = bytes(12) + struct.pack(">2H", 0x100, 0) + _UNITY + bytes(8)
    edit = box(b"edts", full_box(b"elst", 0, struct.pack(">2Ii2h", 1, 0, pre_skip, 1, 0)))
    description = box(b"dOps", struct.pack(">2BHIhB", 0, channels, pre_skip, SOUND_RATE, 0, 0))
    entry = bytes(6) + struct.pack(">H", 1) + bytes(8) + struct.pack(">4HI", channels, 16, 0, 0, SOUND_RATE << 16)
    warm_up = full_box(b"sgpd", 1 << 24, b"roll", struct.pack(">2Ih", 2, 1, -WARM_UP))
    media = _handler(b"soun"), full_box(b"smhd", 0, bytes(4)), box(b"Opus", entry, description), warm_up
    return _init(SOUND_RATE, header, edit, media)


def _init(timescale: int, header: bytes, edit: bytes, media: tuple[bytes, bytes, bytes, bytes]) -> bytes:
    """Return ftyp and moov; `header`: the end of its tkhd; `media`: hdlr, media header, sample entry, groups."""
    handler, kind, entry, groups = media
    playback = struct.pack(">IH", 0x10000, 0x100) + bytes(10)  # rate 1, volume 1
    empty = [full_box(name, 0, _word(0)) for name in (b"stts", b"stsc", b"stco")]
    table = box(b"stbl", full_box(b"stsd", 0, _word(1), entry), *empty, full_box(b"stsz", 0, bytes(8)), groups)
    data = box(b"dinf", full_box(b"dref", 0, _word(1), full_box(b"url ", 1)))
    clock = full_box(b"mdhd", 0, struct.pack(">4I2H", 0, 0, timescale, 0, 0x55C4, 0))
    track = box(b"mdia", clock, handler, box(b"minf", kind, data, table))
    return box(b"ftyp", b"iso6", struct.pack(">I", 0), b"iso6", b"cmfc", b"dash") + box(
        b"moov",
        full_box(b"mvhd", 0, struct.pack(">4I", 0, 0, timescale, 0), playback, _UNITY, bytes(24), _word(2)),
        box(b"trak", full_box(b"tkhd", 3, struct.pack(">5I", 0, 0, 1, 0, 0), header), edit, track),
        box(b"mvex", full_box(b"trex", 0, struct.pack(">5I", 1, 1, 0, 0, 0))),
    )


def _handler(kind: bytes) -> bytes:
    return full_box(b"hdlr", 0, bytes(4), kind, bytes(12), b"\0")


def media_segment(pictures: Sequence[CodedPicture], start: int, ticks: int, slopes: int = 0) -> bytes:
    """Return moof and mdat of pictures in decoding order, from an IDR on, that begin at `start` and last `ticks` each.

    Every further IDR begins the next page of the same pictures: together the pages of a picture last as long as one
    would. The first `slopes` are none of these, and with them all share the time of the others evenly.
    """
    pages = sum(picture.idr for picture in pictures) - slopes
    each, frames = ticks // pages, len(pictures) // pages
    durations = [each] * (len(pictures) - frames) + [ticks - each * (pages - 1)] * frames
    if slopes:
        ticks = ticks * (frames - 1) // len(pictures)
        durations = [ticks] * len(pictures)
    offsets = [(p.number - place) * lasts for place, (p, lasts) in enumerate(zip(pictures, durations, strict=True))]
    columns = {DURATION: durations if pages > 1 and not slopes else [], SIZE: [len(p.data) for p in pictures]}
    columns[COMPOSITION_OFFSET] = offsets if any(offsets) else []
    return _fragment(start, (ticks, _OTHER), columns, [picture.data for picture in pictures], b"")


def still_segment(start: int, ticks: int) -> bytes:
    """Return moof and mdat of one grey picture of 64x64 samples that lasts `ticks`. Raises CodecError for too long."""
    return media_segment([CodedPicture(_GREY, 0, len(_GREY), idr=True)], start, ticks)


def sound_segment(packets: Sequence[bytes], first: int) -> bytes:
    """Return moof and mdat of packets of sound that follow each other; `first`: the number of the first."""
    warm_up = full_box(b"sbgp", 0, b"roll", struct.pack(">3I", 1, len(packets), 1))
    sizes = {SIZE: [len(packet) for packet in packets]}
    return _fragment(first * PACKET_TICKS, (PACKET_TICKS, _SYNC), sizes, packets, warm_up)


def _fragment(
    start: int, defaults: tuple[int, int], columns: Mapping[int, list[int]], samples: Sequence[bytes], groups: bytes
) -> bytes:
    """Return moof and mdat of samples from `start` on, the first a sync sample.

    `defaults`: of the others, ticks and flags; `columns`: by the flag of a field of trun, its values or none.
    """
    flags = DATA_OFFSET | FIRST_SAMPLE_FLAGS | sum(flag for flag, column in columns.items() if column)
    try:
        rows = [struct.pack(f">{len(row)}i", *row) for row in zip(*filter(None, columns.values()), strict=True)]
        head = full_box(b"tfhd", _DEFAULT_BASE_IS_MOOF | _DURATION_AND_FLAGS, struct.pack(">3I", 1, *defaults))
        head += full_box(b"tfdt", 1 << 24, struct.pack(">Q", start))
    except struct.error as error:
        got = f"a start at {start} and {defaults[0]} a picture"
        raise CodecError(f"a media segment: expected ticks that fit 32 bits, got {got}") from error
    moof_bytes = HEADER + 16 + HEADER + len(head) + 24 + sum(map(len, rows)) + len(groups)
    run = struct.pack(">IiI", len(rows), moof_bytes + HEADER, _SYNC)
    traf_box = box(b"traf", head, full_box(b"trun", 1 << 24 | flags, run, *rows), groups)
    moof = box(b"moof", full_box(b"mfhd", 0, _word(1)), traf_box)
    return moof + box(b"mdat", *samples)


def with_own_box(fragment: bytes, checksums: Sequence[int], columns: bytes) -> bytes:
    """Return a media segment: a moof and its mdat behind a uuid box with a checksum a sample and a column file."""
    return box(b"uuid", OWN_UUID, struct.pack(f">{len(checksums)}I", *checksums), columns) + fragment


def box(kind: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I4s", HEADER + len(data), kind) + data


def full_box(kind: bytes, version_and_flags: int, *content: bytes) -> bytes:
    return box(kind, _word(version_and_flags), *content)


def _word(number: int) -> bytes:
    return struct.pack(">I", number)
