"""The pictures of a segment that has a file: of slopes, if it begins with them, and of frames.

T frames, P planes, n rows of a level, C colour channels.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import add_slopes, line_times, read_codes, read_values
from airgs_codec.coding.escapes import Escapes
from airgs_codec.coding.kernels import FrameMemory
from airgs_codec.coding.quantize import code_units
from airgs_codec.errors import FormatError
from airgs_codec.media.h264 import Pictures, open_segment
from airgs_codec.package.layout import STATE
from airgs_codec.package.package import Package
from airgs_codec.package.tables import Atlas

AHEAD = 6  # pictures that are decoded before they are needed
_Luma = tuple[NDArray[np.uint8], escapes.Bases]  # (pages * H, W) samples, and the bases in force until the next
# Of an open package: the segment and level decoded last, its escapes of slopes, if there are any, and of frames.
_escapes: WeakKeyDictionary[Package, tuple[tuple[int, int], tuple[Escapes | None, Escapes]]] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True, eq=False)
class ShownState:
    """What the states of a frame are made of; bases are in force until the next."""

    atlas: Atlas
    luma: _Luma
    slopes: _Luma | None
    time: float  # x: how often slopes count

    def codes(self) -> NDArray[np.int32]:
        """(10 + C, n) codes, without slopes."""
        return read_codes(self.luma[0], self.atlas, self.luma[1])

    def values(self, rows: slice, units: NDArray[np.float32]) -> NDArray[np.float32]:
        """(10 + C, n) values of some rows; `units` (10 + C,) are those of a code."""
        values = read_values(self.luma[0], self.atlas, self.luma[1], rows, units)
        if self.slopes:
            add_slopes(values, self.slopes[0], self.atlas, self.slopes[1], rows, units * np.float32(self.time))
        return values


def state_units(package: Package, index: int, level: int) -> NDArray[np.float32]:
    """(10 + C,) values of a code of the states of a segment in a level."""
    m = package.manifest
    steps = STATE.steps(m.groups[m.group_of(index)].state_steps, m.colour_channels)
    return code_units(steps * m.levels[level].factor, m.state_gain)


def decode_pictures(package: Package, index: int, level: int, frames: range) -> Iterator[ShownState]:
    """Consecutive frames of a segment with a file, counted from its start. Raises FormatError."""
    m, first, last = package.manifest, frames.start, frames.stop
    segment = m.segments[index]
    count, lined = segment.stop - segment.start, bool(segment.levels[level].line)
    (media,) = m.state_files(index, level)
    atlas = m.groups[m.group_of(index)].levels[level]
    columns, pictures = open_segment(package.read(media), media, atlas.pages)
    front, pictures = pictures.cut() if lined else (None, pictures)
    coming = decode_ahead(itertools.islice(replace(pictures, memory=FrameMemory().empty), last))
    shape = count, len(atlas.planes), atlas.rows
    known = _escapes.get(package)
    if known is None or known[0] != (index, level):
        known = _escapes[package] = (index, level), escapes.unpack_segment(columns, shape, lined, media)
    rising, jumps = known[1]
    slopes = None if front is None or rising is None else (_only(front, atlas), next(rising.running()))
    times = line_times(count) if lined else np.zeros(count)
    bases, shown = jumps.running(), 0
    for shown, picture in enumerate(coming, 1):
        now = next(bases)
        if shown > first:
            expect_size(picture, atlas, media)
            yield ShownState(atlas, (picture, now), slopes, float(times[shown - 1]))
    if shown < last:
        raise FormatError("bad_picture", media, f"expected {count} pictures, got {shown}")


def _only(pictures: Pictures, atlas: Atlas) -> NDArray[np.uint8]:
    picture = next(iter(pictures), None)
    if picture is None:
        raise FormatError("bad_picture", pictures.where, "expected a picture of slopes, got none")
    expect_size(picture, atlas, pictures.where)
    return picture


def decode_ahead(pictures: Iterator[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """The same pictures, of which another thread decodes the next AHEAD from now on: P-pictures take twice as long."""
    pool = ThreadPoolExecutor(1)
    coming = deque(pool.submit(next, pictures, None) for _ in range(AHEAD))

    def shown() -> Iterator[NDArray[np.uint8]]:
        try:
            while (picture := coming.popleft().result()) is not None:
                coming.append(pool.submit(next, pictures, None))
                yield picture
        finally:
            pool.shutdown(cancel_futures=True)

    return shown()


def expect_size(picture: NDArray[np.uint8], atlas: Atlas, where: str) -> None:
    """Raise FormatError(bad_picture) unless a (pages * H, W) picture has the size that its atlas says."""
    if picture.shape != (atlas.pages * atlas.height, atlas.width):
        got = f"{picture.shape[1]}x{picture.shape[0] // atlas.pages}"
        raise FormatError("bad_picture", where, f"expected {atlas.width}x{atlas.height}, got {got}")
