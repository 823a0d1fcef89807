"""Package -> Gaussians, from the whole to its parts: frames, canonical spaces and segments, codes of pictures.

T frames, N rows of a group, n rows of a keyframe tier or of a level, P planes of an atlas, C colour channels.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, frame_argument
from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import code_units, read_codes, read_values, slope_times
from airgs_codec.coding.channels import Canonical, DeltaApplier, dequantise_keyframe, join_canonical, unpack_matrix
from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.coding.sidecar import KeyframeSidecar, read_detail, unpack_keyframe_sidecar
from airgs_codec.errors import ConfigError, FormatError, FrameError
from airgs_codec.media.h264 import open_segment
from airgs_codec.package.layout import DELTA, keyframe_layout
from airgs_codec.package.package import OPENED, Package, open_package
from airgs_codec.package.parse import expect
from airgs_codec.package.tables import STATIC, Atlas
from airgs_codec.scene.gaussians import Gaussians


@dataclass(frozen=True, slots=True)
class Frame:
    number: int
    gaussians: Gaussians


DECODED_ROWS = 1 << 18  # rows of canonical spaces that stay decoded, and one more space
# Of an open package: canonical spaces by group, keyframe quality and tiers.
_decoded: WeakKeyDictionary[Package, dict[tuple[int, int, int], Canonical]] = WeakKeyDictionary()


def decode(
    package: Package | str | Path, frame: int, *, level: str | int = "L0", keyframe_quality: str | int = "Q0"
) -> Gaussians:
    """Decode one frame, from 0, of an open package or one at a path, at a level and keyframe quality given by id or
    index.

    Decodes nothing but the keyframe tiers of the frame's group, those of the group that they are differences to, and
    its segment up to the frame. While the package is open, keyframe tiers of some groups stay decoded. The result has
    as many rows as the keyframe tiers that viewers of the level fetch. Raises FrameError for a frame, ConfigError for a
    level or keyframe quality that the package does not have, FormatError for a broken package.
    """
    package = argument("package", package, Package, OPENED, open_package)
    m = package.manifest
    frame = frame_argument(frame, m.frames)
    j, q, index = m.level_index(level), m.quality_index(keyframe_quality), m.segment_at(frame)
    known, which = _decoded.setdefault(package, {}), (m.group_of(index), q, m.levels[j].tiers)
    base = known[which] if which in known else decode_canonical(package, *which)
    if which not in known and sum(map(len, known.values())) > DECODED_ROWS:
        known.clear()
    known[which] = base
    shown = next(decode_segment(package, index, base, j, [frame - m.segments[index].start]))
    coded = base.quaternions, base.log_scales, base.colour  # which a frame may show as they are
    columns = shown.columns().values()
    return Gaussians(*(c.copy() if any(np.may_share_memory(c, of) for of in coded) else c for c in columns))


def decode_frames(
    package: Package | str | Path,
    start: int,
    stop: int,
    *,
    level: str | int = "L0",
    keyframe_quality: str | int = "Q0",
    tiers: int | None = None,
) -> Iterator[Frame]:
    """Decode frames [start, stop) one after another, each with its number; the other arguments are those of `decode`.

    `tiers`: keyframe tiers, from the first on, that the viewer has; by default those that viewers of the level fetch.
    Each keyframe tier and each segment is decoded once. Frames share arrays, which cannot be written to. Raises what
    `decode` raises.
    """
    package = argument("package", package, Package, OPENED, open_package)
    m = package.manifest
    j, q = m.level_index(level), m.quality_index(keyframe_quality)
    if not (isinstance(start, Integral) and isinstance(stop, Integral) and 0 <= start <= stop <= m.frames):
        raise FrameError(f"frames: expected a range inside 0:{m.frames}, got {start!r}:{stop!r}")
    base: Canonical | None = None
    group = -1
    for index in range(m.segment_at(start), m.segment_at(stop - 1) + 1) if start < stop else ():
        segment, before, group = m.segments[index], group, m.group_of(index)
        if base is None or group != before:
            base = decode_canonical(package, group, q, m.levels[j].tiers if tiers is None else tiers)
        first, last = max(start, segment.start), min(stop, segment.stop)
        shown = decode_segment(package, index, base, j, range(first - segment.start, last - segment.start))
        for number, gaussians in zip(range(first, last), shown, strict=True):
            sealed = gaussians.take(slice(None))  # arrays may be of other frames, too
            for column in sealed.columns().values():
                column.flags.writeable = False
            yield Frame(number, sealed)


def decode_canonical(package: Package, group: int, quality: int, tiers: int | None = None) -> Canonical:
    """Decode the canonical space of a group, in file order.

    It is that of the first `tiers` keyframe tiers (default: all), which may have no rows. Raises ConfigError for tiers
    that the package does not have, FormatError for a broken package.
    """
    m, g = package.manifest, package.manifest.groups[group]
    if tiers is not None and not 1 <= tiers <= m.tiers:
        raise ConfigError(f"tiers: expected 1..{m.tiers}, got {tiers}")
    transform = unpack_matrix(g.colour_transform, m.colour_channels)
    filled = [t for t, tier in enumerate(g.tiers[:tiers]) if tier.count]
    return join_canonical([_decode_tier(package, group, t, quality, transform) for t in filled], transform)


def _decode_tier(package: Package, group: int, tier: int, quality: int, transform: NDArray[np.float64]) -> Canonical:
    """Return the rows of a keyframe tier, which has some; `transform` is the KLT of the group, and so of its base."""
    m, g = package.manifest, package.manifest.groups[group]
    base, width, coarser = m.base_of(group), len(g.tiers[tier].qualities[quality].centres), m.qualities[quality].coarser
    shown, sidecar = read_keyframe(package, group, tier, quality)
    before = None if base is None else _decode_tier(package, base, tier, quality, transform)
    values = shown.values if shown else np.zeros((width, len(sidecar.depths)), np.float32)
    return dequantise_keyframe(values, sidecar, transform, g.grid, g.keyframe_steps, coarser, before)


_Luma = tuple[NDArray[np.uint8], escapes.Bases]  # (pages * H, W) samples, and the bases in force until the next


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the channels of a keyframe tier or of a frame are made of; bases are in force until the next."""

    atlas: Atlas
    luma: _Luma
    units: NDArray[np.float32]  # (c,) values of a code
    slopes: _Luma | None = None
    time: float = 0.0  # x: how often slopes count

    def codes(self) -> NDArray[np.int32]:
        return read_codes(self.luma[0], self.atlas, self.luma[1])

    def values(self, rows: slice) -> NDArray[np.float32]:
        """Return the values (c, n) of some rows."""
        picture, bases = self.luma
        values = read_values(picture, self.atlas, bases, rows, self.units)
        if self.slopes:
            (picture, bases), still = self.slopes, replace(self.atlas, centres=[0] * len(self.atlas.centres))
            values += read_values(picture, still, bases, rows, self.units * np.float32(self.time))
        return values


def read_keyframe(package: Package, group: int, tier: int, quality: int) -> tuple[Shown | None, KeyframeSidecar]:
    """Return the picture of a keyframe tier, None where it has none, and its sidecar in that quality. Raises
    FormatError.

    The picture is decoded on another thread while columns are read.
    """
    m, g = package.manifest, package.manifest.groups[group]
    entry, differs, coarsest = g.tiers[tier], g.base is not None, m.qualities[-1].coarser
    (where, *paths), atlas = m.keyframe_files(group, tier, quality), entry.qualities[quality]
    data, *media = [package.read(path) for path in (where, *paths)]
    columns, pictures = open_segment(media[0], paths[0], atlas.pages) if media else (None, ())
    steps = keyframe_layout(g).steps(g.difference_steps, m.colour_channels)
    steps *= m.qualities[quality].factor * entry.factor
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, iter(pictures), None)
        sidecar = unpack_keyframe_sidecar(data, entry.count, g.grid, coarsest, where, differs)
        if not media:
            return None, sidecar
        reader = ColumnReader(columns, paths[0])
        if not differs:  # a difference has no detail of positions
            sidecar = read_detail(reader, sidecar, g.grid, m.qualities[quality].coarser, coarsest)
        jumps = escapes.read_columns(reader, (1, len(atlas.planes), atlas.rows))
        reader.close()
    luma = _expect_picture(coming.result(), atlas, paths[0]), next(jumps.running())
    return Shown(atlas, luma, code_units(steps, m.keyframe_gain)), sidecar


def _expect_picture(picture: NDArray[np.uint8] | None, atlas: Atlas, where: str) -> NDArray[np.uint8]:
    """Raise FormatError(bad_picture) unless there is a (pages * H, W) picture of the size that its atlas says."""
    if picture is None:
        raise FormatError("bad_picture", where, "expected one picture, got none")
    if picture.shape != (atlas.pages * atlas.height, atlas.width):
        got = f"{picture.shape[1]}x{picture.shape[0] // atlas.pages}"
        raise FormatError("bad_picture", where, f"expected {atlas.width}x{atlas.height}, got {got}")
    return picture


def decode_segment(
    package: Package, index: int, base: Canonical, level: int, places: Sequence[int]
) -> Iterator[Gaussians]:
    """Yield frames of a segment over a decoded canonical space; `places` ascend, counted from the segment's start.

    `base` is that of the first keyframe tiers, as many as viewers of the level fetch or others: its number of rows says
    how many. H.264 is decoded up to the last frame. Raises FormatError.
    """
    m = package.manifest
    if places and len(base) and (files := m.delta_files(index, level)):
        group = m.groups[m.group_of(index)]
        atlas, rows = group.levels[level], np.flatnonzero((base.depths >= level) & (base.depths != STATIC))
        complete = len(base) >= sum(tier.count for tier in group.tiers[: m.levels[level].tiers])
        if len(rows) > atlas.rows or (complete and len(rows) != atlas.rows):
            raise FormatError("count_mismatch", files[0], f"the sidecars give {len(rows)} rows, the table {atlas.rows}")
        names = DELTA.names(m.colour_channels)
        constant = set(names).difference(names[channel] for channel in atlas.planes)
        applier = DeltaApplier(base, rows, group.delta_steps, constant)
        frames = range(places[0], places[-1] + 1)
        deltas = zip(frames, decode_pictures(package, index, level, frames), strict=True)
        yield from (applier.apply(delta.values) for place, delta in deltas if place in places)
    else:
        yield from itertools.repeat(base.to_gaussians(), len(places))


AHEAD = 6  # pictures that are decoded before they are needed


def decode_pictures(package: Package, index: int, level: int, frames: range) -> Iterator[Shown]:
    """Yield consecutive frames of a segment with a file, counted from its start. Raises FormatError."""
    m, first, last = package.manifest, frames.start, frames.stop
    segment, (media,) = m.segments[index], m.delta_files(index, level)
    count, sloped = segment.stop - segment.start, bool(segment.levels[level].slopes)
    group = m.groups[m.group_of(index)]
    atlas, steps = group.levels[level], DELTA.steps(group.delta_steps, m.colour_channels) * m.levels[level].factor
    units = code_units(steps, m.delta_gain)
    columns, pictures = open_segment(package.read(media), media, atlas.pages)
    front, pictures = pictures.cut() if sloped else ((), pictures)
    coming = decode_ahead(itertools.islice(pictures, last))
    rising, jumps = escapes.unpack_segment(columns, (count, len(atlas.planes), atlas.rows), sloped, media)
    slopes = (_expect_picture(next(iter(front), None), atlas, media), next(rising.running())) if rising else None
    times = slope_times(count) if sloped else np.zeros(count)
    bases, shown = jumps.running(), 0
    for shown, picture in enumerate(coming, 1):
        now = next(bases)
        if shown > first:
            luma = _expect_picture(picture, atlas, media), now
            yield Shown(atlas, luma, units, slopes, float(times[shown - 1]))
    expect(shown >= last, media, f"expected {count} pictures, got {shown}", "bad_picture")


def decode_ahead(pictures: Iterator[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """Return the same pictures, of which another thread decodes the next AHEAD from now on."""
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
