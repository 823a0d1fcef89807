"""A sample of the rows of one group, and what coding it costs.

T frames, N rows of a group, n rows of the sample, c channels, C colour channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.sensitivity import Sensitivity
from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import (
    assemble,
    centre_codes,
    fit_atlas,
    from_codes,
    picture_size,
    read_codes,
    slope_times,
    to_codes,
)
from airgs_codec.coding.channels import (
    Canonical,
    colour_transform,
    delta_channels,
    dequantise_keyframe,
    keyframe_channels,
)
from airgs_codec.coding.motion import StepSettings, channel_weights, withheld_error
from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.coding.sidecar import KeyframeSidecar, fit_grid, grid_codes, pack_keyframe_sidecar
from airgs_codec.media.h264 import (
    ClosedGop,
    CodecSettings,
    delta_codec,
    encode_gop,
    keyframe_codec,
    qp_step,
)
from airgs_codec.package.layout import DELTA, KEYFRAME
from airgs_codec.scene.columns import SHARED, Columns
from airgs_codec.scene.gaussians import Gaussians

Weights = NDArray[np.float64]
BLOCK_ROWS = 256  # a block of an atlas
PRESET = "fast"  # of x264, for trial encodes

LEAST_SLOPED = 4  # frames that slopes are tried for: its picture is one more
LEAST_ERROR = 1e-12  # of pictures: below it nobody sees a difference
RATE_OF_ERROR = 0.4  # bytes fall with this power of the error that steps make, as single-rung packages show


@dataclass(frozen=True, slots=True)
class Cost:
    """Bytes a frame of the group, and mean squared error over picture samples."""

    bytes: float
    keyframe_error: float  # of rows that show the canonical frame
    delta_error: float  # of rows that are updated


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationSample(Columns):
    """Blocks of rows of a group in file order, over some of its frames; some of its rows are a sample of a group that
    has fewer by the same share.
    """

    index: NDArray[np.intp]  # (n,) rows of the group in file order
    keyframe: Gaussians  # n rows of the canonical frame
    frames: list[Gaussians]  # T, one after the other
    classes: NDArray[np.int16]  # (n,)
    sensitivity: Sensitivity  # (n,)
    moving: NDArray[np.bool_]  # (n,) rows that some level carries
    factors: NDArray[np.float64]  # (n,) on the keyframe steps
    row_ratio: float = field(metadata=SHARED)  # rows of the group for each of the sample
    group_frames: int = field(metadata=SHARED)  # frames of the group
    segment_frames: int = field(metadata=SHARED)  # frames of a delta segment
    sloped: bool = field(default=False, metadata=SHARED)  # whether segments have slopes

    def cost(self, steps: StepSettings, attributes: Sequence[str] = DELTA.attributes) -> Cost:
        """Estimate what coding the keyframes and deltas of these attributes costs at `steps`."""
        size, errors = 0.0, np.zeros(len(self.classes))
        for attribute in attributes:
            keyframe_bytes, base = self.code_keyframe(steps, 1.0, (attribute,))
            deltas = self.deltas(base, steps)
            delta_bytes, shown = self.code_deltas(deltas, 1.0, DELTA.slice(attribute))
            size += keyframe_bytes + delta_bytes
            errors += self.error(shown, steps)
        return Cost(size, float(errors[~self.moving].sum()), float(errors[self.moving].sum()))

    def code_keyframe(
        self, steps: StepSettings, factor: float, attributes: Sequence[str] = DELTA.attributes
    ) -> tuple[float, Canonical]:
        """Return bytes a frame, and the canonical space as decoded; attributes that are not named stay exact."""
        transform = self._transform(steps)
        channels, size = self._code_keyframe_channels(steps, transform, factor, attributes)
        grid = fit_grid(self.keyframe.means, self.classes, steps.grid)
        codes, wider = grid_codes(self.keyframe.means, self.classes, grid)
        still = np.zeros(len(codes), np.uint8)
        if "means" in attributes:
            order = np.argsort(codes, kind="stable")
            sorted_rows = KeyframeSidecar(codes[order], self.classes[order], wider[order], still)
            size += len(pack_keyframe_sidecar(sorted_rows, grid))
        base = dequantise_keyframe(
            channels, KeyframeSidecar(codes, self.classes, wider, still), transform, grid, steps.keyframe
        )
        return self.row_ratio * size / self.group_frames, base

    def _code_keyframe_channels(
        self, steps: StepSettings, transform: NDArray[np.float64], factor: float, attributes: Sequence[str]
    ) -> tuple[NDArray[np.float32], float]:
        """Return (7 + C, n) keyframe channels, some attributes as decoded, and the bytes of their picture."""
        values = keyframe_channels(self.keyframe, transform, steps.keyframe, steps.grid)
        channels = values.astype(np.float32)
        chosen = np.zeros(len(values), bool)
        for attribute in set(attributes) & set(KEYFRAME.attributes):
            chosen[KEYFRAME.slice(attribute)] = True
        if not chosen.any():
            return channels, 0.0
        step = KEYFRAME.steps(steps.keyframe, len(transform))[chosen] * factor
        centres = np.median(values[chosen], axis=1, keepdims=True)
        apart = (values[chosen] - centres) / self.factors
        sizes, decoded = encode_and_decode(apart[None], step, keyframe_codec(PRESET))
        channels[chosen] = centres + decoded[0] * self.factors
        return channels, float(sizes[0])

    def error(self, errors: NDArray[np.float64], steps: StepSettings) -> NDArray[np.float64]:
        """Return (n,) what errors (T, 10 + C, n), in steps, add to the mean squared error of pictures of the group."""
        weights = channel_weights(self.classes, self.sensitivity.by_attribute(), steps.delta, self._transform(steps))
        return self.row_ratio * withheld_error(errors, weights)

    def _transform(self, steps: StepSettings) -> NDArray[np.float64]:
        return colour_transform(self.keyframe, steps.keyframe, steps.colours)

    def deltas(self, base: Canonical, steps: StepSettings) -> NDArray[np.float64]:
        """Return (1 + T, 10 + C, n) differences of the canonical frame and others to a canonical space, in steps."""
        values = delta_channels([self.keyframe, *self.frames], base, steps.delta)
        return values / DELTA.steps(steps.delta, base.colour.shape[1])[:, None]

    def with_slopes(self, deltas: NDArray[np.float64], steps: StepSettings) -> CalibrationSample:
        """Return the sample, with slopes if its moving Gaussians take fewer bytes at equal error with them.

        `deltas` are those of `self.deltas`.
        """
        moving = np.flatnonzero(self.moving)
        if len(deltas) - 1 < LEAST_SLOPED or not len(moving):
            return self
        weights = channel_weights(
            self.classes[moving], self.sensitivity.take(moving).by_attribute(), steps.delta, self._transform(steps)
        )
        costs, values, ones = [], deltas[1:, :, moving], np.ones(deltas.shape[1])
        for slopes in (False, True):
            sizes, decoded = encode_and_decode(values, ones, delta_codec(PRESET), slopes)
            error = float(withheld_error(decoded - values, weights).sum())
            costs.append(sum(sizes) * max(error, LEAST_ERROR) ** RATE_OF_ERROR)
        return replace(self, sloped=costs[1] < costs[0])

    def code_deltas(
        self, deltas: NDArray[np.float64], factor: float, part: slice = slice(None)
    ) -> tuple[float, NDArray[np.float64]]:
        """Return bytes a frame of moving rows, and (T, 10 + C, n) errors in steps of what is shown, in the channels
        `part`.

        `deltas` are those of `self.deltas`. A row that is not moving has the error of its canonical frame.
        """
        errors = np.zeros_like(deltas[1:])
        channels = np.arange(deltas.shape[1])[part]
        still, moving = np.flatnonzero(~self.moving), np.flatnonzero(self.moving)
        errors[:, channels[:, None], still] = deltas[0][channels[:, None], still]
        if not len(moving):
            return 0.0, errors
        values = deltas[1:, channels[:, None], moving]
        steps, codec = np.full(len(channels), factor), delta_codec(PRESET)
        sizes, decoded = encode_and_decode(values, steps, codec, self.sloped)
        errors[:, channels[:, None], moving] = decoded - values
        others = float(np.mean(sizes[1:])) if len(sizes) > 1 else 0.0
        return self.row_ratio * (sizes[0] + (self.segment_frames - 1) * others) / self.segment_frames, errors


def fit_slopes(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (...,) what values (T, ...) of a segment rise by from its middle to its end, by least squares."""
    times = slope_times(len(values))
    slopes: NDArray[np.float64] = np.tensordot(times / (times @ times), values, 1)
    return slopes


def block_rows(rows: int, most: int) -> NDArray[np.intp]:
    """Return (n,) rows of at most `most` evenly spaced blocks of BLOCK_ROWS."""
    blocks = np.array(evenly_spaced(-(-rows // BLOCK_ROWS), most))
    index = (blocks[:, None] * BLOCK_ROWS + np.arange(BLOCK_ROWS)).ravel()
    return index[index < rows]


def encode_and_decode(
    values: NDArray[np.float64], steps: NDArray[np.float64], codec: CodecSettings, slopes: bool = False
) -> tuple[list[int], NDArray[np.float64]]:
    """Code values as one atlas, with or without slopes, as a trial, and decode them again.

    (T, C, N) values, (C,) steps -> bytes of each of T pictures, escapes and slopes in the first, and the decoded
    (T, C, N).
    """
    if slopes:
        (rising,), rises = encode_and_decode(fit_slopes(values)[None], steps, codec)
        lines = slope_times(len(values))[:, None, None] * rises
        sizes, left = encode_and_decode(values - lines, steps, codec)
        return [sizes[0] + rising, *sizes[1:]], left + lines
    gain = qp_step(codec.qp)
    codes = to_codes(values, steps, gain)
    atlas = fit_atlas(codes, gain / 2)
    if not atlas.planes:
        centres = np.array(atlas.centres, np.int32)[:, None]
        return [0] * len(codes), np.broadcast_to(from_codes(centres, steps, gain), values.shape).astype(np.float64)
    luma, bases = escapes.split(centre_codes(codes, atlas))
    size = picture_size(atlas)
    coded = encode_gop(ClosedGop(assemble(luma, atlas, *size), 0, 1), size, Fraction(30), codec)
    sizes = list(coded.picture_bytes)
    sizes[0] += len(encode_columns(escapes.Escapes.of(bases).columns()))
    pictures = coded.pictures("a trial")
    shown = [from_codes(read_codes(p, atlas, b), steps, gain) for p, b in zip(pictures, bases, strict=True)]
    return sizes, np.stack(shown).astype(np.float64)
