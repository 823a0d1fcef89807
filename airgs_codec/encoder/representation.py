"""Atlases -> coded and checked streams, several at a time. H x W samples a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.atlas import picture_size
from airgs_codec.errors import CodecError, SceneError
from airgs_codec.media.h264 import (
    BRIGHTEST,
    DARKEST,
    ClosedGop,
    CodecSettings,
    Stream,
    check_stream,
    encode_stream,
)
from airgs_codec.package.tables import MAX_SIDE, Atlas


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
class Representation:
    """The coded pictures of a key tier in a key quality, or of a level, of one group."""

    stream: Stream | None  # None: there is nothing to show
    size: tuple[int, int]  # width and height of its pictures, samples
    differences: tuple[NDArray[np.uint8], ...]  # (H, W) largest luma error of each closed GOP, see `h264.check_stream`


Done = Callable[[], None]  # called when a representation is finished
EMPTY = Representation(None, (0, 0), ())


def encode_checked(
    gops: Callable[[], Iterable[ClosedGop]], size: tuple[int, int], clock: Clock, codec: CodecSettings
) -> Representation:
    """Encode pictures, then decode them again and compare; `gops` is called for each of the two.

    Where decoded luma leaves its range the pictures are coded once more with a finer quantiser, which errs by less;
    the steps of an atlas and its escapes stay as they are. Raises CodecError.
    """
    for qp in range(codec.qp, 0, -1):
        codec = replace(codec, qp=qp)
        stream = encode_stream(gops(), size, clock.fps, clock.timescale, codec)
        decoded = check_stream(stream, gops(), codec)
        if all(gop.in_range for gop in decoded):
            return Representation(stream, size, tuple(gop.difference for gop in decoded))
    raise CodecError(f"decoded luma leaves {DARKEST}-{BRIGHTEST} at every QP")


def checked_size(atlas: Atlas) -> tuple[int, int]:
    """Width and height of the picture of an atlas. Raises SceneError for one that is too large."""
    size = picture_size(atlas)
    if max(size) > MAX_SIDE:
        raise SceneError(f"pictures of {size[0]}x{size[1]} exceed {MAX_SIDE}: too many Gaussians for one atlas")
    return size


def encode_parallel(tasks: Sequence[Callable[[], Representation]], jobs: int, done: Done) -> list[Representation]:
    """What the tasks give, in order, `jobs` at a time: x264 releases the interpreter lock, so threads serve.

    `done` is called after each of them.
    """
    results = []
    with ThreadPoolExecutor(jobs) as pool:
        for future in [pool.submit(task) for task in tasks]:
            results.append(future.result())
            done()
    return results
