"""Values <-> whole codes, `gain` codes a step <-> atlases: planes tiled into one picture.

T frames, C channels, P planes, N rows; a plane holds one channel, one sample a row.
Row i goes to the i-th cell of 16x16 blocks; cells of a block follow a Z-curve, blocks run row by row over the plane.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.escapes import UNIT, Bases
from airgs_codec.coding.rangecoder import worth_compiling
from airgs_codec.errors import SceneError
from airgs_codec.package.tables import BLOCK, MAX_MACROBLOCKS, MAX_PICTURE_SIDE, MIN_PICTURE_SIDE, Atlas

Samples = NDArray[np.uint8]
CELLS = BLOCK * BLOCK
GREY = 128
CODE_LIMIT = 1 << 30  # |code| stays below it, so that sums of a code, a centre and a base fit int32
STEP_LIMITS = (1e-30, 1e30)  # of steps: products of codes and steps are float32


class UncodableError(SceneError):
    """A value that no code holds."""


def to_codes(values: NDArray[np.float64], steps: NDArray[np.float64], gain: float, first: int = 0) -> NDArray[np.int32]:
    """Return the codes (T, C, N) of values (T, C, N) at steps (C,); `from_codes` is at most step / (2 gain) off.

    `first` is the number of the first channel, for errors. Raises UncodableError for a value 2^30 codes or more from 0,
    since nothing is clipped, SceneError for a step that is not within STEP_LIMITS.
    """
    low, high = STEP_LIMITS
    if not (fits := (steps >= low) & (steps <= high)).all():
        channel = int(np.argmin(fits))
        raise SceneError(f"channel {first + channel}: expected a step of {low:g} to {high:g}, got {steps[channel]:g}")
    codes = values * (gain / steps)[:, None]
    np.rint(codes, out=codes)
    if codes.size and not max(-codes.min(), codes.max()) < CODE_LIMIT:
        channel = int(np.unravel_index(np.abs(codes).argmax(), codes.shape)[1])
        largest = float(np.abs(values[:, channel]).max())
        got = f"value {largest:g} at step {steps[channel]:g}"
        raise UncodableError(f"channel {first + channel}: expected at most {CODE_LIMIT} codes, got {got}")
    return codes.astype(np.int32)


def from_codes(codes: NDArray[np.int32], steps: NDArray[np.float64], gain: float) -> NDArray[np.float32]:
    return scale_codes(codes, code_units(steps, gain))


def code_units(steps: NDArray[np.float64], gain: float) -> NDArray[np.float32]:
    return (steps / gain).astype(np.float32)


def scale_codes(codes: NDArray[np.int32], units: NDArray[np.float32]) -> NDArray[np.float32]:
    values = codes.astype(np.float32)
    values *= units[:, None]
    return values


def choose_layout(rows: int, planes: int) -> tuple[int, int]:
    """Return the plane width in samples and the columns of planes that make the atlas nearly square."""
    blocks = -(-rows // CELLS)
    widest = MAX_PICTURE_SIDE // BLOCK
    wide = min(widest, max(1, round(float(np.sqrt(blocks)))))
    high = -(-blocks // wide)
    columns = max(1, min(planes, widest // wide, round(float(np.sqrt(planes * high / wide)))))
    return wide * BLOCK, columns


def picture_size(atlas: Atlas, macroblocks: int = MAX_MACROBLOCKS) -> tuple[int, int]:
    """Return width and height in samples of the smallest pictures for the atlas that encoders and decoders take.

    An atlas of more than `macroblocks`, or taller than a picture may be, takes several pages of that size.
    """
    width, lines = (max(MIN_PICTURE_SIDE, side) for side in atlas.size)
    most = max(MIN_PICTURE_SIDE, min(MAX_PICTURE_SIDE, macroblocks * BLOCK // width * BLOCK))
    pages = -(-lines // most)
    return width, max(MIN_PICTURE_SIDE, -(-lines // (pages * BLOCK)) * BLOCK)


def fit_atlas(codes: NDArray[np.int32], limit: float, omitted: NDArray[np.bool_] | None = None) -> Atlas:
    """Return the atlas of codes (T, channels, n); a channel within `limit` of its centre has no plane.

    A channel of the mask `omitted` (channels,) has none either; its centre is its median.
    """
    fits = [fit_centre(codes[:, channel], limit) for channel in range(codes.shape[1])]
    planes = [c for c, (_, varies) in enumerate(fits) if varies and (omitted is None or not omitted[c])]
    return make_atlas(codes.shape[2], [centre for centre, _ in fits], planes)


def fit_centre(codes: NDArray[np.int32], limit: float) -> tuple[int, bool]:
    """Return the centre of codes (T, n) of one channel, and whether some code is more than `limit` away from it.

    It is 0 where all are near that, else their median: what most rows have stays exact without a plane.
    """
    low, high = int(codes.min()), int(codes.max())
    centre = 0 if max(-low, high) <= limit else round(float(np.median(codes)))
    return centre, max(centre - low, high - centre) > limit


def make_atlas(rows: int, centres: list[int], planes: list[int]) -> Atlas:
    width, columns = choose_layout(rows, len(planes)) if planes else (0, 0)
    return Atlas(rows, centres, planes, width, columns)


def centre_codes(codes: NDArray[np.int32], atlas: Atlas) -> NDArray[np.int32]:
    """Return differences (T, P, n) of codes (T, channels, n) to the centres, of the channels that have a plane."""
    return (codes - np.array(atlas.centres, np.int32)[:, None])[:, atlas.planes]


@lru_cache(maxsize=8)
def row_places(rows: int, plane_width: int, stride: int) -> NDArray[np.intp]:
    """Return (N,) the place of each row's sample in a plane, line by line in a picture with lines of `stride`."""
    block, cell = np.divmod(np.arange(rows), CELLS)
    x, y = np.zeros(rows, np.intp), np.zeros(rows, np.intp)
    for bit in range(4):
        x |= ((cell >> (2 * bit)) & 1) << bit
        y |= ((cell >> (2 * bit + 1)) & 1) << bit
    down, across = np.divmod(block, plane_width // BLOCK)
    places = (y + down * BLOCK) * stride + x + across * BLOCK
    places.flags.writeable = False
    return places


def plane_starts(atlas: Atlas, stride: int) -> list[int]:
    """Return (P,) the place of the first sample of each plane in a picture with lines of `stride` samples."""
    down_across = (divmod(plane, atlas.columns) for plane in range(len(atlas.planes)))
    return [down * atlas.plane_height * stride + across * atlas.plane_width for down, across in down_across]


def assemble(samples: NDArray[np.uint8], atlas: Atlas, width: int, height: int) -> NDArray[np.uint8]:
    """Return pictures (T, pages * height, width) of samples (T, P, N); cells without a sample are 128."""
    places = row_places(atlas.rows, atlas.plane_width, width)
    lines = -(-atlas.size[1] // height) * height
    pictures = np.full((len(samples), lines * width), GREY, np.uint8)
    for picture, planes in zip(pictures, samples, strict=True):
        for start, plane in zip(plane_starts(atlas, width), planes, strict=True):
            picture[start:][places] = plane
    return pictures.reshape(-1, lines, width)


def extract(picture: NDArray[np.uint8], atlas: Atlas, rows: slice = slice(None)) -> NDArray[np.uint8]:
    """Return the samples (P, n) of some rows in a picture. Raises ValueError for one that is smaller than the atlas."""
    start, stop, _ = rows.indices(atlas.rows)
    if not atlas.planes:
        return np.empty((0, stop - start), np.uint8)
    pairs = slice(start // 2, -(-stop // 2))  # of samples of rows 2 i and 2 i + 1, which are side by side
    samples = np.empty((len(atlas.planes), 2 * (pairs.stop - pairs.start)), np.uint8)
    width, height = atlas.size
    if picture.shape[0] < height or picture.shape[1] < width:
        raise ValueError(f"expected a picture of at least {width}x{height}, got {picture.shape[1]}x{picture.shape[0]}")
    if picture.strides[1] != 1 or picture.strides[0] < picture.shape[1] or picture.strides[0] % 2:
        picture = np.ascontiguousarray(picture[:, :width])
    stride = picture.strides[0]  # decoders pad the lines of their pictures
    flat = np.lib.stride_tricks.as_strided(picture, (stride * (len(picture) - 1) + width,), (1,)).view(np.uint16)
    places = row_places(atlas.rows, atlas.plane_width, stride)[::2][pairs] // 2
    for plane, first in zip(samples.view(np.uint16), plane_starts(atlas, stride), strict=True):
        flat[first // 2 :].take(places, out=plane, mode="clip")  # all are inside; "raise" would copy
    return samples[:, start % 2 :][:, : stop - start]


def read_codes(picture: Samples, atlas: Atlas, bases: Bases, rows: slice = slice(None)) -> NDArray[np.int32]:
    """Return the codes (channels, n) of some rows from a picture and the bases (P, N) in force.

    A channel without a plane is its centre.
    """
    start, stop, _ = rows.indices(atlas.rows)
    zeros = np.array(atlas.centres, np.int32)  # the codes of the sample 0, where a channel has a plane
    zeros[atlas.planes] -= GREY
    codes = np.repeat(zeros[:, None], stop - start, axis=1)
    for channel, samples, base in zip(atlas.planes, extract(picture, atlas, rows), bases, strict=True):
        codes[channel] += samples
        if base is not None:
            codes[channel] += UNIT * base[rows]
    return codes


def read_values(picture: Samples, atlas: Atlas, bases: Bases, rows: slice, units: NDArray[np.float32]) -> NDArray[Any]:
    """Return what `scale_codes` gives of `read_codes`: values (channels, n), float32."""
    if not (loop := worth_compiling(_scale, 0)):
        return scale_codes(read_codes(picture, atlas, bases, rows), units)
    start, stop, _ = rows.indices(atlas.rows)
    values = np.repeat(scale_codes(np.array(atlas.centres, np.int32)[:, None], units), stop - start, axis=1)
    for channel, samples, base in zip(atlas.planes, extract(picture, atlas, rows), bases, strict=True):
        zero, some = np.int32(atlas.centres[channel] - GREY), np.empty(0, np.int32) if base is None else base[rows]
        loop(samples, zero, some, units[channel], values[channel])
    return values


def _scale(samples: Samples, zero: np.int32, bases: NDArray[np.int32], unit: np.float32, values: Any) -> None:
    for i in range(len(samples)):
        values[i] = np.float32(np.int32(samples[i] + zero + (UNIT * bases[i] if len(bases) else 0))) * unit


def slope_times(frames: int) -> NDArray[np.float64]:
    """Return (T,) the factor on slopes in each frame of a segment of T > 1: -1 in the first, 1 in the last."""
    return (2 * np.arange(frames) - (frames - 1)) / (frames - 1)
