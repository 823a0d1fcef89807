"""The layouts that airgs is compared with, written from their published descriptions. Not part of the package.

T frames of a group, N rows (in Morton order: a favour to both), C channels. Every function takes the frames of one
group and gives the bytes it would send and the frames it decodes to. All bytes count: packets, parameter sets, ranges.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import cast

import av
import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.attributes import to_opacity
from airgs_codec.coding.colour import colours, split_colours
from airgs_codec.scene.gaussians import Gaussians

RANGE_BYTES = 8  # two float32 for each range that is sent


@dataclass(frozen=True, slots=True, eq=False)
class Coded:
    """What a layout makes of one group."""

    bytes: int
    frames: list[Gaussians]
    decode_s: float


@dataclass(slots=True)
class _Bill:
    bytes: int = 0
    decode_s: float = 0.0


def _raster(rows: int, multiple: int) -> tuple[int, int]:
    """Width and height of a plane filled line by line: nearly square, sides multiples of `multiple`, at least 64."""
    width = max(64, -(-int(np.ceil(np.sqrt(rows))) // multiple) * multiple)
    return width, max(64, -(-rows // width // multiple) * multiple)


def _code(samples: NDArray[np.integer], codec: str, bits: int, qp: int | None, bill: _Bill) -> NDArray[np.uint16]:
    """(T, N) samples -> what one video stream of them decodes to; qp None: lossless."""
    width, height = _raster(samples.shape[1], 16)
    flat = np.zeros((len(samples), height * width), np.uint16)
    flat[:, : samples.shape[1]] = samples
    pictures = flat.reshape(-1, height, width)
    kind = {8: "gray" if codec == "libx265" else "yuv420p", 10: "gray10le"}[bits]
    packets, extradata = _encode(pictures, codec, kind, qp)
    bill.bytes += sum(len(p) for p in packets) + len(extradata)
    began = time.perf_counter()
    decoder = cast(av.VideoCodecContext, av.CodecContext.create({"libx264": "h264", "libx265": "hevc"}[codec], "r"))
    decoder.extradata = extradata
    decoder.thread_count = 1
    out = []
    for packet in [*(av.Packet(p) for p in packets), None]:
        for frame in decoder.decode(packet):
            plane = frame.planes[0]
            lines = np.frombuffer(memoryview(plane), np.uint8 if bits == 8 else np.uint16)
            lines = lines.reshape(-1, plane.line_size // (1 if bits == 8 else 2))
            out.append(lines[:height, :width].reshape(-1)[: samples.shape[1]].astype(np.uint16))
    bill.decode_s += time.perf_counter() - began
    return np.stack(out)


def _encode(pictures: NDArray[np.uint16], codec: str, kind: str, qp: int | None) -> tuple[list[bytes], bytes]:
    count, height, width = pictures.shape
    encoder = cast(av.VideoCodecContext, av.CodecContext.create(codec, "w"))
    encoder.width, encoder.height, encoder.pix_fmt = width, height, kind
    encoder.time_base, encoder.framerate = Fraction(1, 30), Fraction(30)
    encoder.gop_size, encoder.thread_count = count, 1
    encoder.flags |= av.codec.context.Flags.global_header
    if codec == "libx264":
        encoder.options = {
            "preset": "medium",
            "qp": str(qp),
            "x264-params": f"keyint={count}:scenecut=0:aq-mode=0:psy=0",
        }
    else:
        rate = "lossless=1" if qp is None else f"qp={qp}"
        common = f"log-level=none:keyint={count}:min-keyint={count}:scenecut=0:info=0:pools=1:frame-threads=1"
        options = f"{rate}:{common}:psy-rd=0:psy-rdoq=0:aq-mode=0"
        encoder.options = {"preset": "medium", "x265-params": options}
    packets: list[bytes] = []
    for i, picture in enumerate(pictures):
        frame = av.VideoFrame(width, height, kind)
        sample = np.uint16 if kind.endswith("le") else np.uint8
        lines = np.frombuffer(memoryview(frame.planes[0]), sample)
        lines.reshape(-1, frame.planes[0].line_size // sample().itemsize)[:height, :width] = picture
        for plane in frame.planes[1:]:
            np.frombuffer(memoryview(plane), np.uint8)[:] = 128
        frame.pts = i
        packets += [bytes(p) for p in encoder.encode(frame)]
    packets += [bytes(p) for p in encoder.encode(None)]
    return packets, bytes(encoder.extradata or b"")


def v3_layout(frames: Sequence[Gaussians], qp: int) -> Coded:
    """V^3 (SIGGRAPH Asia 2024): activated domain, ranges for every frame and channel, 8 bit by truncation.

    Positions as two bytes, the high one at QP 0; one H.264 stream a plane (its dead chroma planes are not charged);
    colour, scales and rotation at most at QP 22, SH rest and opacity at `qp`.
    """
    bill = _Bill()
    rows = len(frames[0])

    def stack(name: str) -> NDArray[np.float64]:
        return np.stack([getattr(f, name) for f in frames]).reshape(len(frames), rows, -1).astype(np.float64)

    def channels(values: NDArray[np.floating], code_qp: int) -> NDArray[np.float64]:
        out = np.empty_like(values)
        for c in range(values.shape[2]):
            low, span = _ranges(values[..., c], bill)
            codes = ((values[..., c] - low) / span * 255).astype(np.uint16)  # truncation, as published
            out[..., c] = _code(codes, "libx264", 8, code_qp, bill) / 255 * span + low
        return out

    capped = min(qp, 22)
    means = np.empty((len(frames), rows, 3))
    for axis, values in enumerate(np.moveaxis(stack("means"), 2, 0)):
        low, span = _ranges(values, bill)
        codes = ((values - low) / span * 65535).astype(np.uint16)
        high, rest = _code(codes >> 8, "libx264", 8, 0, bill), _code(codes & 255, "libx264", 8, qp, bill)
        means[..., axis] = (high * 256.0 + rest) / 65535 * span + low
    scales = channels(np.exp(stack("log_scales")), capped)
    quaternions = channels(stack("quaternions"), capped)
    opacity = channels(to_opacity(stack("opacity_logits")), qp)
    dc = channels(stack("sh_dc"), capped)
    rest_values = channels(stack("sh_rest"), qp) if frames[0].sh_rest.shape[1] else stack("sh_rest")
    smallest = 1e-6  # world units: a scale that decodes to 0 has no logarithm
    shown = [
        _frame(
            frames[t],
            means[t],
            quaternions[t],
            np.log(np.maximum(scales[t], smallest)),
            opacity[t],
            dc[t],
            rest_values[t],
        )
        for t in range(len(frames))
    ]
    return Coded(bill.bytes, shown, bill.decode_s)


def _ranges(values: NDArray[np.floating], bill: _Bill) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Low and span of each frame; a constant frame has span 1."""
    bill.bytes += RANGE_BYTES * len(values)
    low = values.min(axis=1, keepdims=True)
    span = values.max(axis=1, keepdims=True) - low
    return low, np.where(span > 0, span, 1.0)


def mpeg_anchor_layout(frames: Sequence[Gaussians], qps: dict[str, int], bits: int = 10) -> Coded:
    """The MPEG video anchor (as in GSCodec Studio): ranges over the sequence, positions log-contracted to 16 bit.

    Positions as two lossless 8-bit HEVC planes; the other attributes `bits` deep at one QP each, opacity logits within
    +-7, log-scales from -10.
    """
    bill = _Bill()
    count, rows = len(frames), len(frames[0])

    def grid(values: NDArray[np.float64], depth: int) -> tuple[NDArray[np.uint16], float, float]:
        low = float(values.min())
        step = (float(values.max()) - low) / (2**depth - 1) or 1.0
        bill.bytes += RANGE_BYTES
        return np.rint((values - low) / step).astype(np.uint16), low, step

    def channels(values: NDArray[np.float64], qp: int) -> NDArray[np.float64]:
        out = np.empty_like(values)
        for c in range(values.shape[2]):
            codes, low, step = grid(values[..., c], bits)
            out[..., c] = _code(codes, "libx265", bits, qp, bill) * step + low
        return out

    def stack(name: str) -> NDArray[np.float64]:
        return np.stack([getattr(f, name) for f in frames]).reshape(count, rows, -1).astype(np.float64)

    contracted = np.sign(stack("means")) * np.log1p(np.abs(stack("means")))
    means = np.empty_like(contracted)
    for axis in range(3):
        codes, low, step = grid(contracted[..., axis], 16)
        both = _code(codes >> 8, "libx265", 8, None, bill) * 256.0 + _code(codes & 255, "libx265", 8, None, bill)
        means[..., axis] = both * step + low
    means = np.sign(means) * np.expm1(np.abs(means))
    quaternions = channels(stack("quaternions"), qps["quaternions"])
    log_scales = channels(np.maximum(stack("log_scales"), -10), qps["log_scales"])
    opacity = to_opacity(channels(np.clip(stack("opacity_logits"), -7, 7), qps["opacity"]))
    colour = np.stack([colours(f.sh_dc, f.sh_rest) for f in frames]).astype(np.float64)
    dc = channels(colour[..., :3], qps["sh_dc"])
    rest = channels(colour[..., 3:], qps["sh_rest"]) if colour.shape[2] > 3 else colour[..., 3:]
    rest = np.stack(
        [split_colours(np.concatenate([d, r], axis=1))[1].reshape(rows, -1) for d, r in zip(dc, rest, strict=True)]
    )
    shown = [
        _frame(frames[t], means[t], quaternions[t], log_scales[t], opacity[t], dc[t], rest[t]) for t in range(count)
    ]
    return Coded(bill.bytes, shown, bill.decode_s)


def _frame(
    like: Gaussians,
    means: NDArray[np.float64],
    quaternions: NDArray[np.float64],
    log_scales: NDArray[np.float64],
    opacity: NDArray[np.float64],
    dc: NDArray[np.float64],
    rest: NDArray[np.float64],
) -> Gaussians:
    alpha = np.clip(opacity.reshape(-1), 1e-4, 1 - 1e-4)  # a logit must be finite
    columns = (means, quaternions, log_scales, np.log(alpha / (1 - alpha)), dc, rest.reshape(like.sh_rest.shape))
    return Gaussians(*(np.ascontiguousarray(c, np.float32) for c in columns))
