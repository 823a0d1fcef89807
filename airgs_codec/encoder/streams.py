"""Atlases -> coded and checked streams, several at a time, and what each may be off by. H x W samples a picture.

The largest error of an attribute has the codec in it, and the units of its channels. A sample that was sent as code c
for value v, |v - c s| <= s / 2 with s = step * factor / gain, and decoded d luma levels off, is off by at most
(1/2 + d) s. Codes stay whole numbers through the decoder, and two roundings to float32 (code * s) add at most
FLOAT_ROUNDING of the value. T frames, P planes, n rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Decimal
from fractions import Fraction
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.atlas import assemble, extract, picture_size
from airgs_codec.errors import CodecError
from airgs_codec.media.h264 import (
    BRIGHTEST,
    DARKEST,
    ClosedGop,
    CodecSettings,
    CodedGop,
    check_gop,
    encode_gop,
)
from airgs_codec.package.layout import Layout
from airgs_codec.package.tables import Atlas

Item = TypeVar("Item")
Result = TypeVar("Result")
FLOAT_ROUNDING = 2.0**-22
DIGITS = 3  # of a bound, which is rounded up to them


@dataclass(frozen=True, slots=True)
class FrameClock:
    fps: Fraction  # frames a second
    timescale: int  # ticks a second, at least 1000
    frame_ticks: int  # ticks a frame

    @staticmethod
    def of(fps: Fraction) -> FrameClock:
        """Return a clock in which a frame takes a whole number of ticks."""
        factor = 1 if fps.numerator >= 1000 else 1000
        return FrameClock(fps, fps.numerator * factor, fps.denominator * factor)


@dataclass(frozen=True, slots=True, eq=False)
class AtlasPictures:
    """The pictures of an atlas, made as they are asked for."""

    samples: Iterable[NDArray[np.uint8]]  # (P, n) of each picture; may be iterated over more than once
    atlas: Atlas
    size: tuple[int, int]  # width and height of a page

    @staticmethod
    def of(samples: Iterable[NDArray[np.uint8]], atlas: Atlas) -> AtlasPictures:
        return AtlasPictures(samples, atlas, picture_size(atlas))

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        for picture in self.samples:
            yield assemble(picture[None], self.atlas, *self.size)[0]


@dataclass(frozen=True, slots=True, eq=False)
class CodedPictures:
    """The coded pictures of a keyframe tier in a keyframe quality, or of a level, of one group."""

    gops: tuple[CodedGop, ...]  # none: there is nothing to show
    size: tuple[int, int]  # width and height of its pictures, samples
    differences: tuple[NDArray[np.uint8], ...]  # (pages * H, W) largest luma error of each closed GOP

    def described(self, atlas: Atlas, error: ErrorModel | None, layout: Layout) -> Atlas:
        """Return the atlas with the size of its pictures and its `max_error`: zeros where `error` is None."""
        width, height = self.size if atlas.planes else (0, 0)
        errors = [0.0] * len(layout.attributes) if error is None else error.bound(atlas, self.differences, layout)
        return replace(atlas, max_error=errors, width=width, height=height)


NO_PICTURES = CodedPictures((), (0, 0), ())


def encode_checked(
    gops: Iterable[ClosedGop], size: tuple[int, int], clock: FrameClock, codec: CodecSettings
) -> CodedPictures:
    """Encode closed GOPs one by one, decode each again and compare. Raises CodecError."""
    checked = [_encode_checked(gop, size, clock, codec) for gop in gops]
    return CodedPictures(tuple(coded for coded, _ in checked), size, tuple(decoded for _, decoded in checked))


def _encode_checked(
    gop: ClosedGop, size: tuple[int, int], clock: FrameClock, codec: CodecSettings
) -> tuple[CodedGop, NDArray[np.uint8]]:
    """Return a coded GOP and its (pages * H, W) largest luma error. Raises CodecError.

    Where decoded luma leaves its range the pictures are coded once more with a finer quantiser, which errs by less;
    the steps of the atlas and its escapes stay as they are.
    """
    for qp in range(codec.qp, 0, -1):
        codec = replace(codec, qp=qp)
        coded = encode_gop(gop, size, clock.fps, codec)
        decoded = check_gop(coded, gop, codec)
        if decoded.in_range:
            return replace(coded, checksums=decoded.checksums), decoded.difference
    raise CodecError(f"decoded luma leaves {DARKEST}-{BRIGHTEST} at every QP")


def in_threads(threads: int, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return what a function gives of each item, in order: x264 releases the interpreter lock, so threads serve."""
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, items))


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """A bound on the errors of an atlas before its pictures are decoded."""

    units: NDArray[np.float64]  # (channels,) s, what a code counts
    largest: NDArray[np.float64]  # (channels,) largest |value|
    constant: NDArray[np.float64]  # (channels,) error of the channels without a plane, 0 of the others
    held: NDArray[np.float64]  # (channels,) largest difference of a value to the one that is coded in its place

    @staticmethod
    def of(low: NDArray[np.float64], high: NDArray[np.float64], atlas: Atlas, units: NDArray[np.float64]) -> ErrorModel:
        """Make it from (channels,) least and largest values that the atlas was made of and the units of its codes."""
        centres = np.array(atlas.centres, np.float64) * units
        constant = np.maximum(np.abs(low - centres), np.abs(high - centres))
        constant[atlas.planes] = 0
        return ErrorModel(units, np.maximum(np.abs(low), np.abs(high)), constant, np.zeros_like(units))

    def bound(self, atlas: Atlas, differences: Sequence[NDArray[np.uint8]], layout: Layout) -> list[float]:
        """Largest error of each attribute of `layout`.

        `differences` are the (H, W) largest luma errors of the pictures of every closed GOP of the atlas.
        """
        errors = self.constant.copy()
        off = np.zeros(len(atlas.planes))
        for picture in differences:
            off = np.maximum(off, extract(picture, atlas).max(axis=1))
        errors[atlas.planes] = np.maximum(self.units / 2, self.held)[atlas.planes] + off * self.units[atlas.planes]
        errors += FLOAT_ROUNDING * self.largest
        places = layout.attribute_index(len(errors))
        return [_round_up(errors[places == k].max()) for k in range(int(places.max()) + 1)]


def _round_up(error: float) -> float:
    """Return the least number of DIGITS significant digits that is no less."""
    shown = Decimal(float(error))
    return float(shown.quantize(Decimal(1).scaleb(shown.adjusted() - DIGITS + 1), ROUND_CEILING)) if error else 0.0
