"""Package -> Gaussians, from the whole to its parts: frames, canonical spaces and segments, codes of pictures.

T frames, N rows of a group, n rows of a keyframe tier or of a level, P planes of an atlas, C colour channels.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from numbers import Integral
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, frame_argument
from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import add_slopes, code_units, read_codes, read_values, slope_times
from airgs_codec.coding.channels import Canonical, DeltaApplier, dequantise_keyframe, join_canonical, unpack_matrix
from airgs_codec.coding.escapes import Escapes
from airgs_codec.coding.kernels import FrameMemory
from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.coding.sidecar import KeyframeSidecar, read_detail, unpack_keyframe_sidecar
from airgs_codec.errors import ConfigError, FormatError, FrameError
from airgs_codec.media.h264 import open_segment
from airgs_codec.package.layout import COLOUR, DELTA, keyframe_layout
from airgs_codec.package.package import OPENED, Package, open_package
from airgs_codec.package.tables import STATIC, Atlas
from airgs_codec.scene.gaussians import Gaussians


@dataclass(frozen=True, slots=True)
class Frame:
    number: int
    gaussians: Gaussians


DECODED_ROWS = 1 << 18  # rows of canonical spaces that stay decoded, and one more space


def decode(
    package: Package | str | Path, frame: int, *, level: str | int = "L0", keyframe_quality: str | int = "Q0"
) -> Gaussians:
    """One frame, from 0, of an open package or the one at a path, at a level and keyframe quality given by id or index.

    Decodes nothing but the keyframe tiers of the frame's group, those of the group that they are differences to, and
    its segment up to the frame. While the package is open, keyframe tiers of some groups stay decoded, and the escapes
    of one segment. The result has as many rows as the keyframe tiers that viewers of the level fetch. Raises FrameError
    for a frame, ConfigError for a level or keyframe quality that the package does not have, FormatError for a broken
    package.
    """
    package = argument("package", package, Package, OPENED, open_package)
    m = package.manifest
    frame = frame_argument(frame, m.frames)
    j, q, index = m.level_index(level), m.quality_index(keyframe_quality), m.segment_at(frame)
    base = _canonical_again(package, m.group_of(index), q, m.levels[j].tiers)
    shown = next(decode_segment(package, index, base, j, [frame - m.segments[index].start]))
    columns = (getattr(shown, field.name) for field in fields(shown))
    coded = base.quaternions, base.log_scales, base.colour  # which a frame may show as they are
    return Gaussians(*(c.copy() if any(np.may_share_memory(c, of) for of in coded) else c for c in columns))


# Of an open package: canonical spaces by group, keyframe quality and tiers.
_decoded: WeakKeyDictionary[Package, dict[tuple[int, int, int], Canonical]] = WeakKeyDictionary()


def _canonical_again(package: Package, group: int, quality: int, tiers: int) -> Canonical:
    """Return what `decode_canonical` gives; that of some groups stays decoded while the package is open."""
    known, which = _decoded.setdefault(package, {}), (group, quality, tiers)
    base = known.get(which)
    if base is None:
        base = decode_canonical(package, *which)
        if sum(len(other.means) for other in known.values()) > DECODED_ROWS:
            known.clear()
        known[which] = base
    return base


def decode_frames(
    package: Package | str | Path,
    start: int,
    stop: int,
    *,
    level: str | int = "L0",
    keyframe_quality: str | int = "Q0",
    tiers: int | None = None,
) -> Iterator[Frame]:
    """Frames [start, stop) one after another, each with its number; the other arguments are those of `decode`.

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
        segment = m.segments[index]
        if base is None or m.group_of(index) != group:
            group = m.group_of(index)
            base = decode_canonical(package, group, q, m.levels[j].tiers if tiers is None else tiers)
        first, last = max(start, segment.start), min(stop, segment.stop)
        shown = decode_segment(package, index, base, j, range(first - segment.start, last - segment.start))
        for number, gaussians in zip(range(first, last), shown, strict=True):
            yield Frame(number, _sealed(gaussians))


def _sealed(g: Gaussians) -> Gaussians:
    """The same without the right to write to its arrays, which are of other frames, too."""
    columns = [getattr(g, field.name).view() for field in fields(g)]
    for column in columns:
        column.flags.writeable = False
    return Gaussians(*columns)


def decode_canonical(package: Package, group: int, quality: int, tiers: int | None = None) -> Canonical:
    """The canonical space of a group, in file order.

    It is that of the first `tiers` keyframe tiers (default: all), which may have no rows. Raises ConfigError for tiers
    that the package does not have, FormatError for a broken package.
    """
    m, g = package.manifest, package.manifest.groups[group]
    if tiers is not None and not 1 <= tiers <= m.tiers:
        raise ConfigError(f"tiers: expected 1..{m.tiers}, got {tiers}")
    transform = unpack_matrix(g.colour_transform, m.colour_channels)
    parts = [
        _decode_tier(package, group, t, quality, transform) for t, tier in enumerate(g.tiers[:tiers]) if tier.count
    ]
    return join_canonical(parts, transform)


def _decode_tier(package: Package, group: int, tier: int, quality: int, transform: NDArray[np.float64]) -> Canonical:
    """The rows of a keyframe tier, which has some; `transform` is the KLT of the group, and so of its base."""
    m, g = package.manifest, package.manifest.groups[group]
    base, width = m.base_of(group), len(g.tiers[tier].qualities[quality].centres)
    shown, sidecar = _read_keyframe(package, group, tier, quality)

    def values(rows: slice) -> NDArray[np.float32]:
        return shown.values(rows) if shown else np.zeros((width, rows.stop - rows.start), np.float32)

    before = None if base is None else _decode_tier(package, base, tier, quality, transform)
    return dequantise_keyframe(
        values, sidecar, transform, g.grid, g.keyframe_steps, m.qualities[quality].coarser, before
    )


def keyframe_units(package: Package, group: int, tier: int, quality: int) -> NDArray[np.float32]:
    m, g = package.manifest, package.manifest.groups[group]
    factor = m.qualities[quality].factor * g.tiers[tier].factor
    return code_units(keyframe_layout(g).steps(g.difference_steps, m.colour_channels) * factor, m.keyframe_gain)


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
        """(c, n) values of some rows."""
        values = read_values(self.luma[0], self.atlas, self.luma[1], rows, self.units)
        if self.slopes:
            add_slopes(values, self.slopes[0], self.atlas, self.slopes[1], rows, self.units * np.float32(self.time))
        return values


def decode_keyframe(package: Package, group: int, tier: int, quality: int) -> tuple[NDArray[np.int32], KeyframeSidecar]:
    """(c, n) codes of a keyframe tier, n = 0 without a picture, and its sidecar in that quality. Raises FormatError."""
    shown, sidecar = _read_keyframe(package, group, tier, quality)
    atlas = package.manifest.groups[group].tiers[tier].qualities[quality]
    return shown.codes() if shown else np.empty((len(atlas.centres), 0), np.int32), sidecar


def _read_keyframe(package: Package, group: int, tier: int, quality: int) -> tuple[Shown | None, KeyframeSidecar]:
    """The picture of a keyframe tier, None where it has none, and its sidecar, as in `decode_keyframe`.

    The picture is decoded on another thread while columns are read.
    """
    m, g = package.manifest, package.manifest.groups[group]
    entry, differs, coarsest = g.tiers[tier], g.base is not None, m.qualities[-1].coarser
    (where, *paths), atlas = m.keyframe_files(group, tier, quality), entry.qualities[quality]
    data, *media = [package.read(path) for path in (where, *paths)]
    columns, pictures = open_segment(media[0], paths[0], atlas.pages) if media else (None, ())
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
    picture = _expect_picture(coming.result(), atlas, paths[0])
    return Shown(atlas, (picture, next(jumps.running())), keyframe_units(package, group, tier, quality)), sidecar


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
    """Frames of a segment over a decoded canonical space; `places` ascend and count from the start of the segment.

    `base` is that of the first keyframe tiers, as many as viewers of the level fetch or others: its rows tell. H.264 is
    decoded up to the last frame. Raises FormatError.
    """
    if places and len(base.means) and package.manifest.delta_files(index, level):
        yield from _decode_deltas(package, index, base, level, places)
    else:
        yield from itertools.repeat(base.to_gaussians(), len(places))


def _decode_deltas(
    package: Package, index: int, base: Canonical, level: int, places: Sequence[int]
) -> Iterator[Gaussians]:
    m, (media,) = package.manifest, package.manifest.delta_files(index, level)
    group = m.groups[m.group_of(index)]
    atlas, rows = group.levels[level], np.flatnonzero((base.depths >= level) & (base.depths != STATIC))
    complete = len(base.means) >= sum(tier.count for tier in group.tiers[: m.levels[level].tiers])
    if len(rows) > atlas.rows or (complete and len(rows) != atlas.rows):
        raise FormatError("count_mismatch", media, f"the sidecars give {len(rows)} rows, the table {atlas.rows}")
    names = DELTA.names(m.colour_channels)
    varying = {names[i] for i, centre in enumerate(atlas.centres) if centre or i in atlas.planes}
    constant = [name for name in ("quaternions", COLOUR) if name not in varying]
    applier = DeltaApplier.of(base, rows, group.delta_steps, constant)
    frames = range(places[0], places[-1] + 1)
    for place, delta in zip(frames, decode_pictures(package, index, level, frames), strict=True):
        if place in places:
            yield applier.apply(delta.values)


AHEAD = 6  # pictures that are decoded before they are needed
# Of an open package: the segment and level decoded last, its escapes of slopes, if there are any, and of frames.
_escapes: WeakKeyDictionary[Package, tuple[tuple[int, int], tuple[Escapes | None, Escapes]]] = WeakKeyDictionary()


def decode_pictures(package: Package, index: int, level: int, frames: range) -> Iterator[Shown]:
    """Consecutive frames of a segment with a file, counted from its start. Raises FormatError."""
    m, first, last = package.manifest, frames.start, frames.stop
    segment = m.segments[index]
    count, sloped = segment.stop - segment.start, bool(segment.levels[level].slopes)
    (media,) = m.delta_files(index, level)
    group = m.groups[m.group_of(index)]
    atlas, steps = group.levels[level], DELTA.steps(group.delta_steps, m.colour_channels) * m.levels[level].factor
    units = code_units(steps, m.delta_gain)
    columns, pictures = open_segment(package.read(media), media, atlas.pages)
    front, pictures = pictures.cut() if sloped else (None, pictures)
    coming = decode_ahead(itertools.islice(replace(pictures, memory=FrameMemory().empty), last))
    shape = count, len(atlas.planes), atlas.rows
    known = _escapes.get(package)
    if known is None or known[0] != (index, level):
        known = _escapes[package] = (index, level), escapes.unpack_segment(columns, shape, sloped, media)
    rising, jumps = known[1]
    slopes = None
    if front is not None and rising is not None:
        slopes = _expect_picture(next(iter(front), None), atlas, media), next(rising.running())
    times = slope_times(count) if sloped else np.zeros(count)
    bases, shown = jumps.running(), 0
    for shown, picture in enumerate(coming, 1):
        now = next(bases)
        if shown > first:
            luma = _expect_picture(picture, atlas, media), now
            yield Shown(atlas, luma, units, slopes, float(times[shown - 1]))
    if shown < last:
        raise FormatError("bad_picture", media, f"expected {count} pictures, got {shown}")


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
