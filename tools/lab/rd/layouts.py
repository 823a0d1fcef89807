"""The published layouts that airgs is compared with, written from their descriptions. Not part of the package.

T frames of a group, N rows (in Morton order: a favour to both), C channels. Every layout takes the frames of one group
and gives the bytes it would send and the frames it decodes to. All bytes count: packets, parameter sets, ranges; but
SEI, in which x264 and x265 repeat their options, is left out as it is of our packages.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import cast

import av
import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import colours, split_colours
from airgs_codec.media.h264 import units_without_sei
from airgs_codec.scene.gaussians import Gaussians, sigmoid

RANGE_BYTES = 8  # two float32 for each range that is sent
SMALLEST_SCALE = 1e-6  # world units; a scale that decodes to 0 has no logarithm
V3_CAP = 22  # the highest QP of colour, scales and rotation in V^3
# compress_ckpt_2_image_precompute.py, which V^3's README names, and the one beside it
V3_FORMS = "activated", "stored"
PUBLISHED = "published"  # instead of a preset: FFmpeg's defaults and a QP, as the scripts of both call it
Samples = NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class CodedGroup:
    frame_bytes: list[int]  # of each frame: its packets, and its part of what all share
    frames: list[Gaussians]
    decode_s: float

    @property
    def bytes(self) -> int:
        return sum(self.frame_bytes)


@dataclass(slots=True)
class Video:
    codec: str  # libx264 or libx265
    preset: str  # of both, or PUBLISHED
    packets: Counter[int] = field(default_factory=Counter)  # bytes of the packets of each frame
    shared: int = 0  # bytes of parameter sets and ranges
    decode_s: float = 0.0

    def code(self, samples: NDArray[np.integer], bits: int, qp: int | None) -> NDArray[np.uint16]:
        """(T, N) samples -> what one stream of them decodes to; qp None: lossless."""
        width, height = _raster(samples.shape[1], 16)
        flat = np.zeros((len(samples), height * width), np.uint16)
        flat[:, : samples.shape[1]] = samples
        packets, extradata = self._encode(flat.reshape(-1, height, width), bits, qp)
        self.shared += len(extradata)
        for frame, packet in packets:
            self.packets[frame] += len(packet)
        began = time.perf_counter()
        planes = self._decode([packet for _, packet in packets], extradata, bits)
        self.decode_s += time.perf_counter() - began
        return planes[:, :height, :width].reshape(len(samples), -1)[:, : samples.shape[1]]

    def count_ranges(self, number: int) -> None:
        self.shared += RANGE_BYTES * number

    def frame_bytes(self) -> list[int]:
        """What each frame costs: its packets, and an equal part of what all share; what is left falls to the first."""
        count = len(self.packets)
        return [self.packets[t] + self.shared // count + (self.shared % count if t == 0 else 0) for t in range(count)]

    def _encode(self, pictures: NDArray[np.uint16], bits: int, qp: int | None) -> tuple[list[tuple[int, bytes]], bytes]:
        """Packets in the order of decoding, each with the number of its frame, and parameter sets."""
        encoder = cast(av.VideoCodecContext, av.CodecContext.create(self.codec, "w"))
        count, encoder.height, encoder.width = pictures.shape
        encoder.pix_fmt = "gray10le" if bits == 10 else "gray" if self.codec == "libx265" else "yuv420p"
        encoder.time_base, encoder.framerate = Fraction(1, 30), Fraction(30)
        encoder.gop_size, encoder.thread_count = count, 1
        encoder.flags |= av.codec.context.Flags.global_header
        encoder.options = self._options(count, qp)
        packets: list[av.Packet] = []
        for i, picture in enumerate(pictures):
            frame = _frame_of(picture, encoder.pix_fmt)
            frame.pts = i
            packets += encoder.encode(frame)
        packets += encoder.encode(None)
        extradata = bytes(encoder.extradata or b"")
        strip = _stripped if self.codec == "libx264" else bytes  # x265 is told to write none
        return [(cast(int, p.pts), strip(bytes(p))) for p in packets], extradata

    def _options(self, count: int, qp: int | None) -> dict[str, str]:
        if self.codec == "libx264":
            plain = {"preset": self.preset, "x264-params": f"keyint={count}:scenecut=0:aq-mode=0:psy=0"}
            return {"qp": str(qp)} | ({} if self.preset == PUBLISHED else plain)
        rate = f"{'lossless=1' if qp is None else f'qp={qp}'}:log-level=none:info=0:pools=1:frame-threads=1"
        if self.preset == PUBLISHED:
            return {"x265-params": rate}
        rate += f":keyint={count}:min-keyint={count}:scenecut=0:psy-rd=0:psy-rdoq=0:aq-mode=0"
        return {"preset": self.preset, "x265-params": rate}

    def _decode(self, packets: list[bytes], extradata: bytes, bits: int) -> NDArray[np.uint16]:
        name = {"libx264": "h264", "libx265": "hevc"}[self.codec]
        decoder = cast(av.VideoCodecContext, av.CodecContext.create(name, "r"))
        decoder.extradata, decoder.thread_count = extradata, 1
        frames = [frame for p in packets for frame in decoder.decode(av.Packet(p))] + decoder.decode(None)
        return np.stack([_samples_of(frame, bits).astype(np.uint16) for frame in frames])


def _stripped(packet: bytes) -> bytes:
    return b"".join(b"\0\0\0\1" + unit for unit in units_without_sei(packet))


def _raster(rows: int, multiple: int) -> tuple[int, int]:
    """Width and height of a plane filled line by line: nearly square, sides multiples of `multiple`, at least 64."""
    width = max(64, -(-int(np.ceil(np.sqrt(rows))) // multiple) * multiple)
    return width, max(64, -(-rows // width // multiple) * multiple)


def _frame_of(picture: NDArray[np.uint16], kind: str) -> av.VideoFrame:
    height, width = picture.shape
    frame = av.VideoFrame(width, height, kind)
    _samples_of(frame, 10 if kind.endswith("le") else 8)[:height, :width] = picture
    for plane in frame.planes[1:]:
        np.frombuffer(memoryview(plane), np.uint8)[:] = 128
    return frame


def _samples_of(frame: av.VideoFrame, bits: int) -> NDArray[np.unsignedinteger]:
    """The luma plane as an array that shares its memory; lines may be longer than the picture."""
    kind = np.dtype(np.uint8 if bits == 8 else np.uint16)
    plane = frame.planes[0]
    return np.frombuffer(memoryview(plane), kind).reshape(-1, plane.line_size // kind.itemsize)


def _stack(frames: Sequence[Gaussians], name: str) -> NDArray[np.float64]:
    values = np.stack([getattr(f, name) for f in frames])
    return values.reshape(*values.shape[:2], int(np.prod(values.shape[2:]))).astype(np.float64)


def v3_layout(frames: Sequence[Gaussians], qp: int, preset: str, form: str) -> CodedGroup:
    """V^3 (SIGGRAPH Asia 2024, github.com/AuthorityWang/VideoGS): ranges for every frame and channel, 8 bit, truncated.

    `form`, one of V3_FORMS: scales and opacities activated, or as they are stored, log and logit. Positions as two
    bytes, the high one at QP 0; one H.264 stream a plane (its dead chroma planes are not charged); colour, scales and
    rotation at most at QP 22, SH rest and opacity at `qp`.
    """
    video = Video("libx264", preset)
    capped = min(qp, V3_CAP)
    activated = form == V3_FORMS[0]
    scales, opacity = _stack(frames, "log_scales"), _stack(frames, "opacity_logits")
    scales = _v3_channels(video, np.exp(scales) if activated else scales, capped)
    opacity = _v3_channels(video, sigmoid(opacity) if activated else opacity, qp)
    columns = {
        "means": _v3_means(video, _stack(frames, "means"), qp),
        "quaternions": _v3_channels(video, _stack(frames, "quaternions"), capped),
        "log_scales": np.log(np.maximum(scales, SMALLEST_SCALE)) if activated else scales,
        "opacity_logits": to_logit(opacity) if activated else opacity,
        "sh_dc": _v3_channels(video, _stack(frames, "sh_dc"), capped),
        "sh_rest": _v3_channels(video, _stack(frames, "sh_rest"), qp),
    }
    return CodedGroup(video.frame_bytes(), _as_frames(columns, frames), video.decode_s)


def _v3_channels(video: Video, values: Samples, qp: int) -> NDArray[np.float64]:
    out = np.empty(values.shape)
    for c in range(values.shape[2]):
        low, span = _v3_ranges(video, values[..., c])
        codes = ((values[..., c] - low) / span * 255).astype(np.uint16)  # truncation, as published
        out[..., c] = video.code(codes, 8, qp) / 255 * span + low
    return out


def _v3_means(video: Video, values: Samples, qp: int) -> NDArray[np.float64]:
    out = np.empty(values.shape)
    for axis in range(3):
        low, span = _v3_ranges(video, values[..., axis])
        codes = ((values[..., axis] - low) / span * 65535).astype(np.uint16)
        high, rest = video.code(codes >> 8, 8, 0), video.code(codes & 255, 8, qp)
        out[..., axis] = (high * 256.0 + rest) / 65535 * span + low
    return out


def _v3_ranges(video: Video, values: Samples) -> tuple[Samples, Samples]:
    video.count_ranges(len(values))
    low = values.min(axis=1, keepdims=True)
    span = values.max(axis=1, keepdims=True) - low
    return low, np.where(span > 0, span, 1.0)


def mpeg_anchor_layout(frames: Sequence[Gaussians], qps: dict[str, int], preset: str) -> CodedGroup:
    """The MPEG video anchor (as in GSCodec Studio): ranges over the sequence, positions log-contracted to 16 bit.

    Positions as two lossless 8-bit HEVC planes; the other attributes 10 bit deep at one QP each, opacity logits within
    +-7, log-scales from -10.
    """
    video = Video("libx265", preset)
    colour = np.stack([colours(f.sh_dc, f.sh_rest) for f in frames]).astype(np.float64)
    dc = _mpeg_channels(video, colour[..., :3], qps["sh_dc"])
    rest = _mpeg_channels(video, colour[..., 3:], qps["sh_rest"])
    opacity = _mpeg_channels(video, np.clip(_stack(frames, "opacity_logits"), -7, 7), qps["opacity"])
    columns = {
        "means": _mpeg_means(video, _stack(frames, "means")),
        "quaternions": _mpeg_channels(video, _stack(frames, "quaternions"), qps["quaternions"]),
        "log_scales": _mpeg_channels(video, np.maximum(_stack(frames, "log_scales"), -10), qps["log_scales"]),
        "opacity_logits": to_logit(sigmoid(opacity)),
        "sh_dc": dc,
        "sh_rest": np.stack([split_colours(both)[1] for both in np.concatenate([dc, rest], axis=2)]),
    }
    return CodedGroup(video.frame_bytes(), _as_frames(columns, frames), video.decode_s)


def _mpeg_channels(video: Video, values: Samples, qp: int) -> NDArray[np.float64]:
    out = np.empty(values.shape)
    for c in range(values.shape[2]):
        codes, low, step = _mpeg_codes(video, values[..., c], 10)
        out[..., c] = video.code(codes, 10, qp) * step + low
    return out


def _mpeg_means(video: Video, values: Samples) -> NDArray[np.float64]:
    contracted = np.sign(values) * np.log1p(np.abs(values))
    for axis in range(3):
        codes, low, step = _mpeg_codes(video, contracted[..., axis], 16)
        both = video.code(codes >> 8, 8, None) * 256.0 + video.code(codes & 255, 8, None)
        contracted[..., axis] = both * step + low
    return np.sign(contracted) * np.expm1(np.abs(contracted))


def _mpeg_codes(video: Video, values: Samples, bits: int) -> tuple[NDArray[np.uint16], float, float]:
    video.count_ranges(1)
    low = float(values.min())
    step = (float(values.max()) - low) / (2**bits - 1) or 1.0
    return np.rint((values - low) / step).astype(np.uint16), low, step


def to_logit(opacity: Samples) -> Samples:
    """Logits of opacities in 0..1, which must be finite: 0 and 1 are moved inside by 1e-4."""
    alpha = np.clip(opacity, 1e-4, 1 - 1e-4)
    return np.log(alpha / (1 - alpha))


def _as_frames(columns: dict[str, Samples], like: Sequence[Gaussians]) -> list[Gaussians]:
    """Gaussians of (T, N, C) values of each attribute, shaped as those of `like`."""
    return [
        Gaussians(
            **{n: np.ascontiguousarray(v[t].reshape(getattr(g, n).shape), np.float32) for n, v in columns.items()}
        )
        for t, g in enumerate(like)
    ]
