"""Atlases -> coded and checked streams, several at a time. H x W samples a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.atlas import assemble, picture_size
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
from airgs_codec.package.tables import Atlas


@dataclass(frozen=True, slots=True)
class Clock:
    """Time in a package."""

    fps: Fraction  # frames a second
    timescale: int  # ticks a second, at least 1000
    frame_ticks: int  # ticks a frame

    @staticmethod
    def of(fps: Fraction) -> Clock:
        """A clock in which a frame takes a whole number of ticks."""
        factor = 1 if fps.numerator >= 1000 else 1000
        return Clock(fps, fps.numerator * factor, fps.denominator * factor)


@dataclass(frozen=True, slots=True, eq=False)
class AtlasPictures:
    """The pictures of an atlas, made as they are asked for."""

    samples: Iterable[NDArray[np.uint8]]  # (P, n) of each picture; may be iterated over more than once
    atlas: Atlas
    size: tuple[int, int]  # width and height of a page

    @staticmethod
    def of(samples: Iterable[NDArray[np.uint8]], atlas: Atlas) -> AtlasPictures:
        """Pictures of the size that the atlas asks for."""
        return AtlasPictures(samples, atlas, picture_size(atlas))

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        """(pages * H, W) each."""
        for picture in self.samples:
            yield assemble(picture[None], self.atlas, *self.size)[0]


@dataclass(frozen=True, slots=True, eq=False)
class Representation:
    """The coded pictures of a key tier in a key quality, or of a level, of one group."""

    gops: tuple[CodedGop, ...]  # none: there is nothing to show
    size: tuple[int, int]  # width and height of its pictures, samples
    differences: tuple[NDArray[np.uint8], ...]  # (pages * H, W) largest luma error of each closed GOP


EMPTY = Representation((), (0, 0), ())


def encode_checked(
    gops: Iterable[ClosedGop], size: tuple[int, int], clock: Clock, codec: CodecSettings
) -> Representation:
    """Encode closed GOPs one by one, decode each again and compare. Raises CodecError."""
    checked = [_encode_checked(gop, size, clock, codec) for gop in gops]
    return Representation(tuple(coded for coded, _ in checked), size, tuple(decoded for _, decoded in checked))


def _encode_checked(
    gop: ClosedGop, size: tuple[int, int], clock: Clock, codec: CodecSettings
) -> tuple[CodedGop, NDArray[np.uint8]]:
    """A coded GOP and its (pages * H, W) largest luma error. Raises CodecError.

    Where decoded luma leaves its range the pictures are coded once more with a finer quantiser, which errs by less;
    the steps of the atlas and its escapes stay as they are.
    """
    for qp in range(codec.qp, 0, -1):
        codec = replace(codec, qp=qp)
        coded = encode_gop(gop, size, clock.fps, codec)
        decoded = check_gop(coded, gop, codec)
        if decoded.in_range:
            return coded, decoded.difference
    raise CodecError(f"decoded luma leaves {DARKEST}-{BRIGHTEST} at every QP")


def encode_parallel(tasks: Sequence[Callable[[], Representation]], threads: int) -> list[Representation]:
    """What the tasks give, in order: x264 releases the interpreter lock, so threads serve."""
    with ThreadPoolExecutor(threads) as pool:
        return [future.result() for future in [pool.submit(task) for task in tasks]]
