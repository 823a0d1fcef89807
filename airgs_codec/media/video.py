"""Pictures <-> H.264 in fragmented MP4, and reading of camera videos. The only importer of av.

Luma carries the samples, chroma is 128, the full-range flag is set, and no frame ever meets swscale.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import av.bitstream
import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import CodecError, FormatError, SceneError

DEFAULT_PRESET = "veryslow"
PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo")
KEY_QP = 14  # 2^((14 - 4) / 6) = 3.17 luma levels
STATE_QP = 20  # 6.35 luma levels
# x264 codes IDR pictures finer and B-pictures coarser than the constant QP by these ratios of quantisers.
# A key unit is one IDR, so its ratio is 1; a state segment's IDR is what its other pictures predict from.
KEY_IP_RATIO = 1.0
STATE_IP_RATIO = 1.2
STATE_PB_RATIO = 1.3


_DATA_OFFSET, _FIRST_SAMPLE_FLAGS, _SAMPLE_SIZE = 0x1, 0x4, 0x200  # trun flags, ISO/IEC 14496-12, 8.8.8


def quantiser(qp: int) -> float:
    """Quantiser step of an H.264 QP in luma levels: the gain of an atlas coded at that QP."""
    return float(2.0 ** ((qp - 4) / 6))


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Pictures that are decoded together: one IDR, then P and B."""

    pictures: Iterable[NDArray[np.uint8]]  # (H, W) each
    start: int  # presentation time of the first, ticks
    ticks: int  # duration of each, ticks


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """A representation: its init segment, a media segment a clip, and H.264 bytes a picture in display order."""

    codecs: str  # RFC 6381
    init: bytes
    media: list[bytes]
    picture_bytes: list[list[int]]


@dataclass(frozen=True, slots=True)
class CodecSettings:
    """What x264 is told."""

    qp: int
    ip_ratio: float
    pb_ratio: float
    preset: str = DEFAULT_PRESET

    def options(self) -> dict[str, str]:
        """AVOptions. AQ, psy and mb-tree off: every sample counts alike. Scene cuts off: clips decide the IDRs.

        Deblocking off: neighbours in a plane are near in space, not parts of a smooth picture (+0.1 dB on the fox).
        """
        params = (
            f"keyint=infinite:scenecut=0:open-gop=0:aq-mode=0:psy=0:mbtree=0:rc-lookahead=0:sync-lookahead=0:"
            f"no-deblock=1:ipratio={self.ip_ratio}:pbratio={self.pb_ratio}:fullrange=on:threads=1"
        )
        return {"preset": self.preset, "qp": str(self.qp), "forced-idr": "1", "x264-params": params}


def key_codec(preset: str) -> CodecSettings:
    """Of key pictures."""
    return CodecSettings(KEY_QP, KEY_IP_RATIO, 1.0, preset)


def state_codec(preset: str) -> CodecSettings:
    """Of state pictures."""
    return CodecSettings(STATE_QP, STATE_IP_RATIO, STATE_PB_RATIO, preset)


def encode_stream(
    clips: Iterable[Clip], size: tuple[int, int], rate: Fraction, timescale: int, settings: CodecSettings
) -> Stream:
    """Code clips of `size` = (width, height) pictures as one representation; each clip is a segment of its own.

    `rate`: pictures a second, from which x264 derives the level; `timescale`: ticks a second.

    Raises CodecError when FFmpeg refuses or a clip did not become one segment.
    """
    output = io.BytesIO()
    options = {"movflags": "cmaf+frag_keyframe+empty_moov+default_base_moof", "video_track_timescale": str(timescale)}
    options |= {"avoid_negative_ts": "disabled"}
    sizes: dict[int, int] = {}
    spans: list[list[int]] = []
    try:
        with av.open(output, "w", format="mp4", options=options) as container:
            stream = container.add_stream("libx264", rate=rate, options=settings.options())
            context = stream.codec_context
            context.width, context.height, context.pix_fmt = *size, "yuv420p"
            context.color_range = 2  # full
            context.time_base = Fraction(1, timescale)
            context.thread_count = 1
            without_sei = None
            durations: dict[int, int] = {}

            def mux(packets: Iterable[av.Packet]) -> None:
                nonlocal without_sei
                for packet in packets:
                    if without_sei is None:  # x264 repeats its version and options in an SEI of every stream
                        without_sei = av.bitstream.BitStreamFilterContext("filter_units=remove_types=6", stream)
                    for kept in without_sei.filter(packet):
                        sizes[_ticks(kept.pts)] = kept.size
                        kept.duration = durations[_ticks(kept.pts)]
                        container.mux(kept)

            for clip in clips:
                spans.append([])
                for number, picture in enumerate(clip.pictures):
                    frame = _frame(picture, clip.start + number * clip.ticks, timescale)
                    frame.pict_type = av.video.frame.PictureType.I if number == 0 else av.video.frame.PictureType.NONE
                    durations[_ticks(frame.pts)] = clip.ticks
                    spans[-1].append(_ticks(frame.pts))
                    mux(stream.encode(frame))
            mux(stream.encode(None))
    except av.FFmpegError as error:
        raise CodecError(f"H.264 encoder refused {size[0]}x{size[1]} pictures: {error}") from error
    boxes = _boxes(output.getvalue())
    init = b"".join(data for kind, data in boxes if kind in (b"ftyp", b"moov"))
    media = _fragments(boxes)
    if len(media) != len(spans):
        raise CodecError(f"expected {len(spans)} segments from the muxer, got {len(media)}")
    return Stream(_codecs_string(init), init, media, [[sizes[pts] for pts in span] for span in spans])


def check_stream(stream: Stream, clips: Iterable[Clip], settings: CodecSettings) -> list[NDArray[np.uint8]]:
    """Decode what was encoded and compare it with the pictures it was made of, before anything is published.

    Gives for each clip the (H, W) largest difference over its pictures, in luma levels. Encoders have returned wrong
    pixels at odd sizes: root mean square error over a clip was measured at 0.3 quantisers; a whole one means that
    something else was decoded. Raises CodecError.
    """
    differences = []
    for number, (clip, media) in enumerate(zip(clips, stream.media, strict=True)):
        decoded = decode_clip(stream.init, media, f"segment {number}")
        squared, count = 0.0, 0
        largest = np.zeros((1, 1), np.uint8)
        try:
            for picture, shown in zip(clip.pictures, decoded, strict=True):
                off = np.maximum(picture, shown) - np.minimum(picture, shown)
                squared += float(np.mean(np.square(off, dtype=np.float32)))
                largest = np.maximum(largest, off)
                count += 1
        except ValueError as error:  # another number of pictures, or pictures of another size
            raise CodecError(f"segment {number} does not decode to the pictures it was made of: {error}") from error
        if (squared / count) ** 0.5 > quantiser(settings.qp):
            raise CodecError(f"segment {number} decodes {(squared / count) ** 0.5:.1f} levels off the pictures encoded")
        differences.append(largest)
    return differences


def _ticks(pts: int | None) -> int:
    if pts is None:
        raise CodecError("a packet has no presentation time")
    return pts


def _frame(picture: NDArray[np.uint8], pts: int, timescale: int) -> av.VideoFrame:
    height, width = picture.shape
    frame = av.VideoFrame(width, height, "yuv420p")
    luma = np.frombuffer(memoryview(frame.planes[0]), np.uint8).reshape(-1, frame.planes[0].line_size)
    luma[:height, :width] = picture
    for plane in frame.planes[1:]:
        np.frombuffer(memoryview(plane), np.uint8)[:] = 128
    frame.pts = pts
    frame.time_base = Fraction(1, timescale)
    return frame


def _boxes(data: bytes) -> list[tuple[bytes, bytes]]:
    """ISO BMFF boxes one after another, as (type, whole box). Raises CodecError where a size leaves the data."""
    boxes, at = [], 0
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at) if at + 8 <= len(data) else (0, b"")
        if size < 8 or at + size > len(data):
            raise CodecError(f"a box {kind!r} of {size} bytes at {at} of {len(data)}")
        boxes.append((kind, data[at : at + size]))
        at += size
    return boxes


def _fragments(boxes: list[tuple[bytes, bytes]]) -> list[bytes]:
    """Each moof with its mdat."""
    media: list[bytes] = []
    for kind, data in boxes:
        if kind == b"moof":
            media.append(data)
        elif kind == b"mdat":
            media[-1] += data
    return media


def _codecs_string(init: bytes) -> str:
    return "avc1." + _avc_configuration(init)[1:4].hex().upper()


def decode_clip(init: bytes, media: bytes, where: str) -> Iterator[NDArray[np.uint8]]:
    """(H, W) luma of each picture of one segment, in display order; stop iterating to stop decoding.

    The samples are cut out here: opening a segment with FFmpeg's demuxer decodes a picture only to look at it, half of
    the time of a key unit. Raises FormatError(bad_picture) when the bytes do not decode.
    """
    try:
        context = av.CodecContext.create("h264", "r")
        context.extradata = _avc_configuration(init)
        context.thread_count = 1
        packets = [av.Packet(sample) for sample in _samples(media)]
        for packet in [*packets, None]:
            for frame in context.decode(packet):
                yield _luma(frame, where)
    except (av.FFmpegError, CodecError, struct.error) as error:
        raise FormatError("bad_picture", where, f"expected H.264 in fragmented MP4: {error}") from error


def _luma(frame: av.VideoFrame, where: str) -> NDArray[np.uint8]:
    if frame.format.name not in ("yuv420p", "yuvj420p"):
        raise FormatError("bad_picture", where, f"expected 8-bit 4:2:0, got {frame.format.name}")
    plane = frame.planes[0]
    return np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]


def _avc_configuration(init: bytes) -> bytes:
    """The AVCDecoderConfigurationRecord (ISO/IEC 14496-15) of an init segment."""
    at = init.find(b"avcC")
    size = struct.unpack_from(">I", init, at - 4)[0] if at >= 4 else 0
    if size < 15 or at - 4 + size > len(init):
        raise CodecError("the init segment has no whole avcC box")
    return init[at + 4 : at - 4 + size]


def _samples(media: bytes) -> Iterator[bytes]:
    """The coded pictures of a media segment of one moof and one mdat, in decoding order (ISO/IEC 14496-12, 8.8)."""
    boxes = _boxes(media)
    if [kind for kind, _ in boxes] != [b"moof", b"mdat"]:
        raise CodecError(f"expected one moof and one mdat, got {[kind for kind, _ in boxes]}")
    fragment = dict(_boxes(dict(_boxes(boxes[0][1][8:])).get(b"traf", b"")[8:]))
    if b"tfhd" not in fragment or b"trun" not in fragment:
        raise CodecError("the moof has no track fragment with a run of samples")
    default = _default_sample_size(fragment[b"tfhd"])
    flags, count, offset = struct.unpack_from(">IIi", fragment[b"trun"], 8)
    if not flags & _DATA_OFFSET or offset != len(boxes[0][1]) + 8:
        raise CodecError("the samples do not follow the moof")
    record = 4 * (flags >> 8 & 0xF).bit_count()
    before = 4 * (flags >> 8 & 1)  # a duration comes before the size
    first = 20 + 4 * bool(flags & _FIRST_SAMPLE_FLAGS)
    at = 0
    payload = boxes[1][1][8:]
    for number in range(count):
        size = default
        if flags & _SAMPLE_SIZE:
            size = struct.unpack_from(">I", fragment[b"trun"], first + number * record + before)[0]
        if not 0 < size <= len(payload) - at:
            raise CodecError(f"sample {number} of {size} bytes at {at} of {len(payload)}")
        yield payload[at : at + size]
        at += size


def _default_sample_size(header: bytes) -> int:
    """Of a tfhd box; 0 when it has none."""
    flags = struct.unpack_from(">I", header, 8)[0] & 0xFFFFFF
    at = 16 + 8 * (flags & 1) + 4 * (flags >> 1 & 1) + 4 * (flags >> 3 & 1)
    return int(struct.unpack_from(">I", header, at)[0]) if flags & 0x10 else 0


def write_movie(path: Path, frames: Iterable[NDArray[np.uint8]], fps: Fraction) -> None:
    """(H, W, 3) RGB frames as an H.264 film for people to watch. Raises CodecError."""
    try:
        with av.open(str(path), "w") as container:
            stream = None
            for picture in frames:
                if stream is None:
                    stream = container.add_stream("libx264", rate=fps, options={"crf": "18", "preset": "medium"})
                    stream.height, stream.width = (side - side % 2 for side in picture.shape[:2])
                    stream.pix_fmt = "yuv420p"
                even = np.ascontiguousarray(picture[: stream.height, : stream.width])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(even, "rgb24")))
            if stream is None:
                raise CodecError(f"{path}: expected at least one frame")
            container.mux(stream.encode(None))
    except (av.FFmpegError, OSError) as error:
        raise CodecError(f"{path}: cannot write the film: {error}") from error


def library_versions() -> dict[str, str]:
    """Versions that decide the encoder's bytes."""
    return {"av": av.__version__, **{name: ".".join(map(str, v)) for name, v in av.library_versions.items()}}


class VideoReader:
    """Frames of any video FFmpeg reads, by number, as RGB; made for reading forward."""

    def __init__(self, path: Path) -> None:
        """Opens the first video stream. Raises SceneError."""
        self._path = path
        self._open()
        stream = self._container.streams.video[0]
        self.size = (stream.codec_context.width, stream.codec_context.height)
        self.fps = stream.average_rate
        self.frames = stream.frames or self._count()

    def read(self, number: int) -> NDArray[np.uint8]:
        """(H, W, 3) frame `number`. Raises SceneError when the video ends before it or cannot be decoded."""
        if number < self._next:
            self._container.close()
            self._open()
        try:
            while True:
                frame = next(self._decoded)
                self._next += 1
                if self._next > number:
                    return np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
        except StopIteration:
            raise SceneError(f"{self._path}: expected frame {number}, the video ends after {self._next}") from None
        except av.FFmpegError as error:
            raise SceneError(f"{self._path}: cannot decode frame {self._next}: {error}") from error

    def close(self) -> None:
        """Free the decoder."""
        self._container.close()

    def _open(self) -> None:
        try:
            self._container = av.open(str(self._path))
            if not self._container.streams.video:
                raise SceneError(f"{self._path}: expected a video, got a file without a picture stream")
            self._decoded = self._container.decode(video=0)
        except (av.FFmpegError, OSError) as error:
            raise SceneError(f"{self._path}: expected a video: {error}") from error
        self._next = 0

    def _count(self) -> int:
        """Frames of a container that does not say."""
        count = sum(1 for packet in self._container.demux(video=0) if packet.size)
        self._container.close()
        self._open()
        return count
