"""Pictures <-> H.264 in fragmented MP4. H x W samples a picture.

Luma carries the samples, chroma is 128, the full-range flag is set, and no frame ever meets swscale.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, repeat
from typing import NamedTuple
from zlib import crc32

import av
import numpy as np
from numpy.typing import NDArray

from airgs_codec._settings import available_cores
from airgs_codec.errors import CodecError, FormatError
from airgs_codec.media import mp4
from airgs_codec.media.mp4 import CodedPicture

DEFAULT_PRESET = "veryslow"
PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo")
KEYFRAME_QP = 20  # a step of 6.35 luma levels
DELTA_QP = 20  # a step of 6.35 luma levels
DELTA_PB_RATIO = 1.3  # of the steps of B-pictures, to those of others: most are predicted from by none
FULL_RANGE = 2  # AVCOL_RANGE_JPEG
# Decoders and screens that take full-range pictures for limited ones clip what is outside: no decoded luma is.
DARKEST, BRIGHTEST = 16, 235
_LEVEL = "5.1"  # the highest that every phone decodes, and its limits (ISO/IEC 14496-10, table A-1):
_LEVEL_BUFFER = 184_320  # macroblocks of the pictures that a decoder holds
_LEVEL_RATE = 983_040  # macroblocks a second
_MOST_REFERENCES = 4  # more take time and save no bytes
BETWEEN = 3  # B-pictures in a row between deltas
_SERIAL = 1 << 21  # most bytes of pictures that one thread decodes
_IDR = 5  # type of the NAL units of an IDR picture
_SLICES = (1, _IDR)  # of all pictures
_SEI = 6  # type of the NAL unit in which x264 repeats its version and options in every stream
_PARAMETERS = [7, 8]  # types of the NAL units of an SPS and of a PPS
_PROFILES = (66, 77, mp4.PROFILE)  # Baseline and Main ask a decoder of High for nothing more
_LEVELS = {  # most macroblocks of a picture, by level
    10: 99, 11: 396, 12: 396, 13: 396, 20: 396, 21: 792, 22: 1620, 30: 1620, 31: 3600, 32: 5120, 40: 8192, 41: 8192,
    42: 8704, 50: 22_080, mp4.LEVEL: 36_864,
}  # fmt: skip


def qp_step(qp: int) -> float:
    """Return the quantiser step of an H.264 QP in luma levels, 2^((qp - 4) / 6): the gain of an atlas of that QP."""
    return float(2.0 ** ((qp - 4) / 6))


@dataclass(frozen=True, slots=True, eq=False)
class ClosedGop:
    """Pictures that are decoded together and without any others: one IDR, then P and B.

    Taller pictures than those of the stream are coded in pages: their first H lines as such a sequence, then their next
    H lines as another, and so on.
    """

    pictures: Iterable[NDArray[np.uint8]]  # (pages * H, W) each; may be iterated over more than once
    start: int  # presentation time of the first, ticks
    ticks: int  # duration of each, ticks
    slopes: CodedGop | None = None  # of one picture, coded before, which goes in front of them


@dataclass(frozen=True, slots=True, eq=False)
class CodedGop:
    """A closed GOP, which decodes by itself."""

    fragment: bytes  # a moof and its mdat
    pages: int
    picture_bytes: list[int]  # of the slices of each picture, all pages together, in display order
    checksums: tuple[int, ...] = ()  # see `Pictures`; none before it was decoded
    slopes: CodedGop | None = None  # in front of them; its bytes count with those of the first picture

    def pictures(self, where: str) -> Pictures:
        """Return what it decodes to, without the slopes; `where` names it in errors."""
        samples = mp4.read_samples(self.fragment)[self.slopes.pages if self.slopes else 0 :]
        return Pictures(samples, where, self.pages, self.checksums or None)

    def media(self, columns: bytes) -> bytes:
        """Return the media segment, with a column file."""
        slopes = self.slopes.checksums if self.slopes else ()
        return mp4.with_own_box(self.fragment, slopes + self.checksums, columns)


@dataclass(frozen=True, slots=True)
class CodecSettings:
    qp: int
    pb_ratio: float
    preset: str = DEFAULT_PRESET
    between: int = BETWEEN  # B-pictures in a row; 0: every GOP is one picture: nothing is referred to or reordered

    def options(self, size: tuple[int, int], rate: Fraction) -> dict[str, str]:
        """Return AVOptions for pictures of `size` (width, height), `rate` a second.

        AQ, psy and mb-tree are off: every sample counts equally. Scene cuts are off: `ClosedGop`s decide the IDRs.
        Deblocking is off: neighbours in a plane are near in space, not parts of a smooth picture (+0.1 dB on the fox).
        Nothing moves across a plane, so a wide search for motion finds chance: with these searches, references and
        B-pictures, deltas of the fox took 4 % fewer bytes at equal error than with the preset's. x264 derives the level
        from the pictures that it reorders and refers to; above 5.1 it is set to 5.1, which limits the references.
        """
        references = _MOST_REFERENCES if self.between else 1
        macroblocks = -(-size[0] // 16) * -(-size[1] // 16)
        suits_level = macroblocks * references <= _LEVEL_BUFFER and macroblocks * rate <= _LEVEL_RATE
        params = (
            f"keyint=infinite:scenecut=0:open-gop=0:aq-mode=0:psy=0:mbtree=0:rc-lookahead=0:sync-lookahead=0:"
            f"no-deblock=1:ipratio=1:pbratio={self.pb_ratio}:fullrange=on:threads=1:b-adapt=0:me=dia:merange=4"
        )
        options = {"preset": self.preset, "qp": str(self.qp), "forced-idr": "1", "x264-params": params}
        options |= {"refs": str(references), "bf": str(self.between)}
        return options if suits_level else options | {"level": _LEVEL}


def keyframe_codec(preset: str) -> CodecSettings:
    return CodecSettings(KEYFRAME_QP, 1.0, preset, between=0)


def delta_codec(preset: str) -> CodecSettings:
    return CodecSettings(DELTA_QP, DELTA_PB_RATIO, preset)


def encode_gop(gop: ClosedGop, size: tuple[int, int], rate: Fraction, settings: CodecSettings) -> CodedGop:
    """Return a closed GOP coded as pictures of `size` (width, height), parameter sets in front of every IDR.

    `rate`: pictures a second, for the level. Raises CodecError when FFmpeg refuses or loses a picture.
    """
    front, coded = mp4.read_samples(gop.slopes.fragment) if gop.slopes else (), list[CodedPicture]()
    number, kinds = len(front), av.video.frame.PictureType
    try:
        encoder = av.CodecContext.create("libx264", "w")
        assert isinstance(encoder, av.VideoCodecContext)
        encoder.width, encoder.height, encoder.pix_fmt, encoder.color_range = *size, "yuv420p", FULL_RANGE
        encoder.framerate, encoder.time_base, encoder.options = rate, 1 / rate, settings.options(size, rate)
        encoder.thread_count = 1
        for top in range(0, len(next(iter(gop.pictures))), size[1]):
            for place, picture in enumerate(gop.pictures):
                frame = _frame(picture[top : top + size[1]])
                frame.pts, frame.time_base = number, encoder.time_base
                frame.pict_type = kinds.NONE if place else kinds.I
                coded += map(_coded, encoder.encode(frame))
                number += 1
        coded += map(_coded, encoder.encode(None))
    except av.FFmpegError as error:
        raise CodecError(f"H.264 encoder refused {size[0]}x{size[1]} pictures: {error}") from error
    if len(coded) != number - len(front):
        raise CodecError(f"expected {number - len(front)} coded pictures, got {len(coded)}")
    pages = sum(picture.idr for picture in coded)
    shown = [picture.bytes for picture in sorted(coded, key=lambda picture: picture.number)]
    frame_bytes = np.reshape(shown, (pages, -1)).sum(axis=0).tolist()
    if gop.slopes:
        frame_bytes[0] += gop.slopes.picture_bytes[0]
    coded = [CodedPicture(data, place, len(data), idr=True) for place, data in enumerate(front)] + coded
    return CodedGop(mp4.media_segment(coded, gop.start, gop.ticks, len(front)), pages, frame_bytes, slopes=gop.slopes)


def _coded(packet: av.Packet) -> CodedPicture:
    if packet.pts is None:
        raise CodecError("a packet has no presentation time")
    units = [(unit[0] & 31, struct.pack(">I", len(unit)) + unit) for unit in units_without_sei(bytes(packet))]
    size = sum(len(unit) for kind, unit in units if kind in _SLICES)
    return CodedPicture(b"".join(unit for _, unit in units), packet.pts, size, any(kind == _IDR for kind, _ in units))


def units_without_sei(stream: bytes) -> list[bytes]:
    """Return the NAL units of a byte stream (ISO/IEC 14496-10, Annex B) but SEI; none of them ends in a zero byte."""
    units = [unit.rstrip(b"\0") for unit in stream.split(b"\0\0\1")[1:]]
    return [unit for unit in units if unit[0] & 31 != _SEI]


def _frame(picture: NDArray[np.uint8]) -> av.VideoFrame:
    height, width = picture.shape
    frame = av.VideoFrame(width, height, "yuv420p")
    luma = np.frombuffer(memoryview(frame.planes[0]), np.uint8).reshape(-1, frame.planes[0].line_size)
    luma[:height, :width] = picture
    for plane in frame.planes[1:]:
        np.frombuffer(memoryview(plane), np.uint8)[:] = 128
    return frame


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    samples: Sequence[bytes]  # those of its first page, then those of the next
    where: str  # names the segment in errors
    pages: int = 1
    checksums: Sequence[int] | None = None  # CRC-32 of the luma of as many pictures, each page in display order

    def cut(self) -> tuple[Pictures, Pictures]:
        """Return the first picture, of which all pages are in front, and the others."""
        samples, known, pages = self.samples, self.checksums or (), self.pages
        first = replace(self, samples=samples[:pages], checksums=known[:pages])
        return first, replace(self, samples=samples[pages:], checksums=known[pages:])

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        """Yield (pages * H, W) luma of each picture in display order, its pages one below another.

        Pages are decoded in parallel. Raises FormatError(bad_picture) when the bytes do not decode, or luma differs
        from its checksum or pages in size.
        """
        if self.pages == 1:
            yield from self._decode_page(0, len(self.samples))
            return
        length = -(-len(self.samples) // self.pages)
        decoders = [self._decode_page(page * length, length) for page in range(self.pages)]
        with ThreadPoolExecutor(min(self.pages, available_cores())) as pool:
            while True:
                parts = list(pool.map(next, decoders, repeat(None)))
                shapes = {None if part is None else part.shape for part in parts}
                if shapes == {None}:
                    return
                if len(shapes) > 1:
                    detail = f"expected {self.pages} pages of equal pictures, got {shapes}"
                    raise FormatError("bad_picture", self.where, detail)
                yield np.concatenate(parts)

    def _decode_page(self, first: int, length: int) -> Iterator[NDArray[np.uint8]]:
        checksums = None if self.checksums is None else self.checksums[first:][:length]
        for number, frame in enumerate(_decode(self.samples[first:][:length], self.where)):
            luma = _luma(frame, self.where)
            if checksums is not None and (number >= len(checksums) or crc32(luma.data) != checksums[number]):
                raise FormatError("bad_picture", self.where, f"picture {number} differs from its checksum")
            yield luma


def _decode(samples: Sequence[bytes], where: str) -> Iterator[av.VideoFrame]:
    """Yield each picture in display order; its `pts` is the place of its sample. Raises FormatError(bad_picture)."""
    try:
        context = av.CodecContext.create("h264", "r")
        context.thread_type, many = "FRAME", sum(map(len, samples)) > _SERIAL
        context.thread_count = min(4, available_cores()) if many else 1
        for number, sample in enumerate(samples):
            packet = av.Packet(mp4.start_codes(sample))
            packet.pts = number
            yield from context.decode(packet)
        yield from context.decode(None)
    except (av.FFmpegError, CodecError) as error:
        raise FormatError("bad_picture", where, f"expected H.264: {error}") from error


def open_segment(media: bytes, where: str, pages: int = 1) -> tuple[bytes | None, Pictures]:
    """Return the column file of a media segment, if it has one, and its pictures. Raises FormatError(bad_picture)."""
    try:
        segment = mp4.read_segment(media)
    except CodecError as error:
        raise FormatError("bad_picture", where, f"expected H.264 in fragmented MP4: {error}") from error
    return segment.columns, Pictures(segment.samples, where, pages, segment.checksums)


def check_segment(media: bytes, where: str, start: int, ticks: int, pages: int, slopes: bool) -> None:
    """Raise FormatError(bad_picture) unless a media segment is built as `encode_gop` builds it, and plays anywhere.

    Pictures have `pages`, begin at `start` and last `ticks` each; one of `slopes` may precede them.
    """
    try:
        coded = _read_coded(mp4.read_segment(media).samples, where)
        frames = len(coded) // pages - slopes
        begins = [*range(pages * slopes), *range(pages * slopes, len(coded), frames)]
        if [place for place, picture in enumerate(coded) if picture.idr] != begins:
            raise CodecError(f"expected IDR pictures as the samples {begins[:8]} alone")
        _, *fragment = (whole for _, whole in mp4.read_boxes(media))
        mp4.check_boxes(mp4.media_segment(coded, start, ticks, pages * slopes), b"".join(fragment))
    except CodecError as error:
        raise FormatError("bad_picture", where, str(error)) from error


def _read_coded(samples: Sequence[bytes], where: str) -> list[CodedPicture]:
    """Return the samples of a segment with their places in display order by decoding, whatever boxes say.

    Raises CodecError for what is neither a slice nor a parameter set, and for those that some decoder refuses.
    """
    shown = {frame.pts: (number, frame) for number, frame in enumerate(_decode(samples, where))}
    coded = []
    for place, sample in enumerate(samples):
        units = mp4.units_of(sample)
        kinds = [unit[0] & 31 for unit in units]
        front = _PARAMETERS if (idr := _IDR in kinds) else []
        if kinds != [*front, *(_SLICES[idr] for _ in kinds[len(front) :])]:
            raise CodecError(f"sample {place}: expected slices, parameter sets before an IDR, got units {kinds[:8]}")
        if any(unit.endswith((b"\0", b"\0\0\3")) for unit in units):
            raise CodecError(f"sample {place}: expected NAL units without zeros at the end")
        if place not in shown:
            raise CodecError(f"sample {place}: expected a picture, got none")
        number, frame = shown[place]
        if frame.color_range != FULL_RANGE:
            raise CodecError(f"sample {place}: expected samples of full range")
        _, profile, _, level = units[0][:4].ljust(4) if idr else (0, mp4.PROFILE, 0, mp4.LEVEL)
        if profile not in _PROFILES or _LEVELS.get(level, 0) * 256 < frame.width * frame.height:
            wanted = f"a profile of {_PROFILES} and a level up to {mp4.LEVEL} for {frame.width}x{frame.height}"
            raise CodecError(f"sample {place}: expected {wanted}, got {profile} and {level}")
        coded.append(CodedPicture(sample, number, len(sample), idr))
    return coded


def _luma(frame: av.VideoFrame, where: str) -> NDArray[np.uint8]:
    """Return (H, W) luma of a picture without padding. Raises FormatError(bad_picture)."""
    if frame.format.name not in ("yuv420p", "yuvj420p"):
        raise FormatError("bad_picture", where, f"expected 8-bit 4:2:0, got {frame.format.name}")
    plane = frame.planes[0]
    lines = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
    return np.ascontiguousarray(lines[: frame.height, : frame.width])


def in_range(picture: NDArray[np.uint8]) -> bool:
    """Return whether every sample of decoded luma lies within DARKEST and BRIGHTEST."""
    return bool(picture.min() >= DARKEST and picture.max() <= BRIGHTEST)


class DecodedGop(NamedTuple):
    difference: NDArray[np.uint8]  # (pages * H, W) largest of any picture, luma levels
    in_range: bool  # see `in_range`; all samples count, also those that carry nothing
    checksums: tuple[int, ...]  # see `Pictures`


def check_gop(coded: CodedGop, gop: ClosedGop, settings: CodecSettings) -> DecodedGop:
    """Decode what was encoded and compare it with the pictures it was made of. Raises CodecError.

    Encoders have returned wrong pixels at odd sizes: the root mean square error over a GOP was measured at 0.3 steps of
    its QP; a whole step means that something else was decoded.
    """
    where = f"the segment at {gop.start} ticks"
    squared, largest, inside = list[float](), np.zeros((1, 1), np.uint8), True
    checksums: list[list[int]] = []  # of the pages of each picture
    try:
        for picture, shown in zip(gop.pictures, coded.pictures(where), strict=True):
            checksums.append([crc32(page.data) for page in np.split(shown, coded.pages)])
            difference = np.maximum(picture, shown) - np.minimum(picture, shown)
            squared.append(float(np.mean(np.square(difference, dtype=np.float32))))
            largest, inside = np.maximum(largest, difference), inside and in_range(shown)
    except (ValueError, FormatError) as error:  # another number of pictures, or pictures of another size
        raise CodecError(f"{where} does not decode to the pictures it was made of: {error}") from error
    if (error_levels := (sum(squared) / len(squared)) ** 0.5) > qp_step(settings.qp):
        raise CodecError(f"{where} decodes {error_levels:.1f} levels off the pictures encoded")
    return DecodedGop(largest, inside, tuple(chain.from_iterable(zip(*checksums, strict=True))))


def library_versions() -> dict[str, str]:
    """Return versions of PyAV and the FFmpeg libraries, which decide the encoder's bytes."""
    return {"av": av.__version__, **{name: ".".join(map(str, v)) for name, v in av.library_versions.items()}}
