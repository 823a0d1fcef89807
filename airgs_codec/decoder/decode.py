"""Package -> Gaussians, from the whole to its parts: frames, canonical spaces and segments, codes of pictures.

N rows of a group, n rows of a key tier or a level, P planes of an atlas, C colour channels.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import read_codes
from airgs_codec.coding.channels import Canonical, StateApplier, dequantise_parts, join_canonical
from airgs_codec.coding.quantize import from_codes
from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.coding.sidecar import KeySidecar, read_detail, unpack_key_sidecar
from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.media.h264 import decode_pictures, open_segment
from airgs_codec.package.layout import COLOUR, KEY, STATE
from airgs_codec.package.store import Package
from airgs_codec.package.tables import STATIC, Atlas, unpack_matrix
from airgs_codec.scene.gaussians import Gaussians


@dataclass(frozen=True, slots=True)
class Frame:
    """A decoded frame of the sequence."""

    number: int
    gaussians: Gaussians


def decode(package: Package, frame: int, *, level: str | int = "L0", key_quality: str | int = "Q0") -> Gaussians:
    """One frame as a viewer of that level and key quality sees it, each given by its id or its index.

    Decodes nothing but the key units of the frame's group, those of the group whose rows it keeps, and its segment up
    to the frame. The result has as many rows as the key tiers that viewers of the level fetch. Raises ConfigError for
    a frame, level or key quality that the package does not have, FormatError for a broken package.
    """
    if not 0 <= frame < package.manifest.frames:
        raise ConfigError(f"frame: expected 0..{package.manifest.frames - 1}, got {frame}")
    return next(decode_frames(package, frame, frame + 1, level=level, key_quality=key_quality)).gaussians


def decode_frames(
    package: Package,
    start: int,
    stop: int,
    *,
    level: str | int = "L0",
    key_quality: str | int = "Q0",
    tiers: int | None = None,
) -> Iterator[Frame]:
    """Frames [start, stop) one after another; `decode` says how level and key quality are given and what is raised.

    `tiers`: how many key tiers the viewer has, from the first on; by default those that viewers of the level fetch.
    Each key unit and each segment is decoded once.
    """
    m = package.manifest
    j, q = m.level_index(level), m.quality_index(key_quality)
    if not 0 <= start <= stop <= m.frames:
        raise ConfigError(f"frames: expected a range inside 0:{m.frames}, got {start}:{stop}")
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
            yield Frame(number, gaussians)


def decode_canonical(package: Package, group: int, quality: int, tiers: int | None = None) -> Canonical:
    """The canonical space of a group from its first `tiers` key tiers (default: all), with the rows that it keeps.

    Raises ConfigError when none of them has rows, FormatError for a broken package.
    """
    m = package.manifest
    g = m.groups[group]
    parts = [
        part
        for t, tier in enumerate(g.tiers[:tiers])
        if tier.count
        for part in _decode_tier(package, group, t, quality)
    ]
    if not parts:
        raise ConfigError(f"group {group}: expected at least one key tier with rows, got tiers={tiers}")
    return join_canonical(parts, unpack_matrix(g.colour_transform, m.colour_channels))


def _decode_tier(package: Package, group: int, tier: int, quality: int) -> Iterator[Canonical]:
    """The rows of a tier, which has some: those that it keeps, then the others."""
    m = package.manifest
    g = m.groups[group]
    read, sidecar = _read_key(package, group, tier, quality)
    base, kept = m.base_of(group), sidecar.kept
    if base is not None and len(kept.rows):
        transform = unpack_matrix(m.groups[base].colour_transform, m.colour_channels)
        yield join_canonical(list(_decode_tier(package, base, tier, quality)), transform).kept(kept.rows, kept.depths)
    if len(sidecar.codes):
        steps = KEY.steps(g.key_steps, m.colour_channels) * m.qualities[quality].factor
        transform = unpack_matrix(g.colour_transform, m.colour_channels)

        def values(rows: slice) -> NDArray[np.float32]:
            return from_codes(read(rows), steps, m.key_gain)

        yield dequantise_parts(values, sidecar, transform, g.grid, g.key_steps, m.qualities[quality].coarser)


def decode_key(package: Package, group: int, tier: int, quality: int) -> tuple[NDArray[np.int32], KeySidecar]:
    """(KEY.width(C), n) codes of the rows of a key unit that are not kept, and its sidecar in that quality.

    Raises FormatError.
    """
    read, sidecar = _read_key(package, group, tier, quality)
    return read(slice(None)), sidecar


def _read_key(
    package: Package, group: int, tier: int, quality: int
) -> tuple[Callable[[slice], NDArray[np.int32]], KeySidecar]:
    """What gives the codes of some rows of a key unit, and its sidecar, as in `decode_key`.

    The picture is decoded on another thread while columns are read.
    """
    m = package.manifest
    g = m.groups[group]
    unit, base = g.tiers[tier], m.base_of(group)
    sidecar_path, *pictures = m.key_files(group, tier, quality)
    grid, coarser, coarsest = g.grid, m.qualities[quality].coarser, m.qualities[-1].coarser
    kept = unit.kept, 0 if base is None else m.groups[base].tiers[tier].count
    count, data = unit.count - unit.kept, package.read(sidecar_path)
    if not pictures:
        none = np.empty((KEY.width(m.colour_channels), 0), np.int32)
        return lambda rows: none, unpack_key_sidecar(data, count, grid, coarsest, sidecar_path, kept)
    (media,) = pictures
    segment = open_segment(package.read(media), media)
    atlas = unit.qualities[quality]
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, decode_pictures(segment.samples, media, atlas.pages), None)
        shared = unpack_key_sidecar(data, count, grid, coarsest, sidecar_path, kept)
        reader = ColumnReader(segment.columns, media)
        sidecar = read_detail(reader, shared, grid, coarser, coarsest)
        jumps = escapes.read_columns(reader, (1, len(atlas.planes), atlas.rows))
        reader.close()
        picture = coming.result()
    if picture is None:
        raise FormatError("bad_picture", media, "expected one picture, got none")
    _expect_size(picture, atlas, media)
    return functools.partial(read_codes, picture, atlas, next(jumps.running())), sidecar


def decode_state(package: Package, index: int, level: int, first: int, last: int) -> Iterator[NDArray[np.int32]]:
    """(STATE.width(C), n) codes of each frame [first, last) of a segment that has files, counted from its start.

    Raises FormatError.
    """
    atlas = package.manifest.groups[package.manifest.group_of(index)].levels[level]
    for picture, bases in _decode_pictures(package, index, level, first, last):
        yield read_codes(picture, atlas, bases)


def _decode_pictures(
    package: Package, index: int, level: int, first: int, last: int
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.int32] | None]]:
    """(pages * H, W) luma of each frame, as in `decode_state`, and the bases in force, until the next one."""
    m = package.manifest
    segment = m.segments[index]
    (media,) = m.state_files(index, level)
    atlas = m.groups[m.group_of(index)].levels[level]
    shape = (segment.stop - segment.start, len(atlas.planes), atlas.rows)
    file = open_segment(package.read(media), media)
    bases = escapes.unpack(file.columns, shape, media).running()
    shown = 0
    pictures = itertools.islice(decode_pictures(file.samples, media, atlas.pages), last)
    for shown, picture in enumerate(_ahead(pictures), 1):
        now = next(bases)
        if shown > first:
            _expect_size(picture, atlas, media)
            yield picture, now
    if shown < last:
        raise FormatError("bad_picture", media, f"expected {shape[0]} pictures, got {shown}")


def _ahead(pictures: Iterator[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """The same pictures, of which the next one is decoded on another thread while one is worked with."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, pictures, None)
        while (picture := coming.result()) is not None:
            coming = pool.submit(next, pictures, None)
            yield picture


def decode_segment(
    package: Package, index: int, base: Canonical, level: int, places: Sequence[int]
) -> Iterator[Gaussians]:
    """Frames of a segment over a decoded canonical space; `places` ascend and count from the start of the segment.

    H.264 is decoded up to the last of them. Where `base` has fewer tiers than viewers of the level fetch, its rows are
    the first of the level, since rows are ordered by tier. Raises FormatError.
    """
    m = package.manifest
    files = m.state_files(index, level)
    if not (files and places):
        frame = base.to_gaussians()
        yield from (frame for _ in places)
        return
    group = m.groups[m.group_of(index)]
    atlas = group.levels[level]
    rows = np.flatnonzero((base.depths >= level) & (base.depths != STATIC))
    complete = len(base.means) >= sum(tier.count for tier in group.tiers[: m.levels[level].tiers])
    if len(rows) > atlas.rows or (complete and len(rows) != atlas.rows):
        detail = f"the sidecars give {len(rows)} rows, the table {atlas.rows}"
        raise FormatError("count_mismatch", files[0], detail)
    steps = STATE.steps(group.state_steps, m.colour_channels) * m.levels[level].factor
    varies = [_varies(atlas, STATE.slice(name)) for name in ("quaternions", COLOUR)]
    applier = StateApplier.of(base, rows, group.state_steps, *varies)
    first, last = places[0], places[-1] + 1
    pictures = _decode_pictures(package, index, level, first, last)

    def read(picture: NDArray[np.uint8], bases: NDArray[np.int32] | None, some: slice) -> NDArray[np.float32]:
        return from_codes(read_codes(picture, atlas, bases, some), steps, m.state_gain)

    for place, shown in enumerate(pictures, first):
        if place in places:
            yield applier.apply_parts(functools.partial(read, *shown))


def _varies(atlas: Atlas, channels: slice) -> bool:
    """Whether any of these channels may decode to something else than 0."""
    places = range(len(atlas.centres))[channels]
    return any(p in places for p in atlas.planes) or any(atlas.centres[channels])


def _expect_size(picture: NDArray[np.uint8], atlas: Atlas, where: str) -> None:
    if picture.shape != (atlas.pages * atlas.height, atlas.width):
        got = f"{picture.shape[1]}x{picture.shape[0] // atlas.pages}"
        raise FormatError("bad_picture", where, f"expected {atlas.width}x{atlas.height}, got {got}")
