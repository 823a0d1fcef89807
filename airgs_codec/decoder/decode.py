"""Package -> Gaussians, from the whole to its parts: frames, canonical spaces and segments, codes of pictures.

N rows of a group, n rows of a key tier or of a level, P planes of an atlas, C colour channels.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from numbers import Integral
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, frame_argument
from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import read_codes, read_values
from airgs_codec.coding.channels import (
    Canonical,
    StateApplier,
    add_difference,
    dequantise_parts,
    join_canonical,
    no_rows,
)
from airgs_codec.coding.quantize import code_units
from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.coding.sidecar import KeySidecar, read_detail, unpack_key_sidecar
from airgs_codec.decoder.states import decode_pictures, expect_size, state_units
from airgs_codec.errors import ConfigError, FormatError, FrameError
from airgs_codec.media.h264 import open_segment
from airgs_codec.package.layout import COLOUR, STATE, key_layout
from airgs_codec.package.package import OPENED, Package, open_package
from airgs_codec.package.tables import STATIC, Atlas, unpack_matrix
from airgs_codec.scene.gaussians import Gaussians


@dataclass(frozen=True, slots=True)
class Frame:
    number: int
    gaussians: Gaussians


DECODED_ROWS = 1 << 18  # rows of canonical spaces that stay decoded, and one more space


def decode(
    package: Package | str | Path, frame: int, *, level: str | int = "L0", key_quality: str | int = "Q0"
) -> Gaussians:
    """One frame, from 0, of an open package or the one at a path, at a level and key quality given by id or index.

    Decodes nothing but the key tiers of the frame's group, those of the group that they are differences to, and its
    segment up to the frame. While the package is open, key tiers of some groups stay decoded, and the escapes of one
    segment. The result has as many rows as the key tiers that viewers of the level fetch. Raises FrameError for a
    frame, ConfigError for a level or key quality that the package does not have, FormatError for a broken package.
    """
    package = argument("package", package, Package, OPENED, open_package)
    m = package.manifest
    frame = frame_argument(frame, m.frames)
    j, q, index = m.level_index(level), m.quality_index(key_quality), m.segment_at(frame)
    base = _canonical_again(package, m.group_of(index), q, m.levels[j].tiers)
    shown = next(decode_segment(package, index, base, j, [frame - m.segments[index].start]))
    columns = (getattr(shown, field.name) for field in fields(shown))
    coded = base.quaternions, base.log_scales, base.colours  # which a frame may show as they are
    return Gaussians(*(c.copy() if any(np.may_share_memory(c, of) for of in coded) else c for c in columns))


# Of an open package: canonical spaces by group, key quality and tiers.
_Which = tuple[int, int, int]
_decoded: WeakKeyDictionary[Package, dict[_Which, Canonical]] = WeakKeyDictionary()


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
    key_quality: str | int = "Q0",
    tiers: int | None = None,
) -> Iterator[Frame]:
    """Frames [start, stop) one after another, each with its number; the other arguments are those of `decode`.

    `tiers`: key tiers, from the first on, that the viewer has; by default those that viewers of the level fetch. Each
    key tier and each segment is decoded once. Frames share arrays, which cannot be written to. Raises what `decode`
    raises.
    """
    package = argument("package", package, Package, OPENED, open_package)
    m = package.manifest
    j, q = m.level_index(level), m.quality_index(key_quality)
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

    It is that of the first `tiers` key tiers (default: all), which may have no rows. Raises ConfigError for tiers that
    the package does not have, FormatError for a broken package.
    """
    m, g = package.manifest, package.manifest.groups[group]
    if tiers is not None and not 1 <= tiers <= m.tiers:
        raise ConfigError(f"tiers: expected 1..{m.tiers}, got {tiers}")
    parts = [_decode_tier(package, group, t, quality) for t, tier in enumerate(g.tiers[:tiers]) if tier.count]
    transform = unpack_matrix(g.colour_transform, m.colour_channels)
    return join_canonical(parts, transform) if parts else no_rows(transform)


def _decode_tier(package: Package, group: int, tier: int, quality: int) -> Canonical:
    """The rows of a key tier, which has some."""
    m, g = package.manifest, package.manifest.groups[group]
    base, units = m.base_of(group), key_units(package, group, tier, quality)
    shown, sidecar = _read_key(package, group, tier, quality)

    def values(rows: slice) -> NDArray[np.float32]:
        if shown is None:
            return np.zeros((len(units), rows.stop - rows.start), np.float32)
        return read_values(shown[0], g.tiers[tier].qualities[quality], shown[1], rows, units)

    if base is not None:
        return add_difference(_decode_tier(package, base, tier, quality), values, g.difference_steps, sidecar.depths)
    transform = unpack_matrix(g.colour_transform, m.colour_channels)
    return dequantise_parts(values, sidecar, transform, g.grid, g.key_steps, m.qualities[quality].coarser)


def key_units(package: Package, group: int, tier: int, quality: int) -> NDArray[np.float32]:
    """Return the value of a code of each channel of the picture of a key tier."""
    m, g = package.manifest, package.manifest.groups[group]
    factor = m.qualities[quality].factor * g.tiers[tier].factor
    return code_units(key_layout(g).steps(g.difference_steps, m.colour_channels) * factor, m.key_gain)


_Picture = tuple[NDArray[np.uint8], escapes.Bases]  # (pages * H, W) luma, and its bases


def decode_key(package: Package, group: int, tier: int, quality: int) -> tuple[NDArray[np.int32], KeySidecar]:
    """(channels, n) codes of a key tier, n = 0 without a picture, and its sidecar in that quality. FormatError."""
    atlas = package.manifest.groups[group].tiers[tier].qualities[quality]
    shown, sidecar = _read_key(package, group, tier, quality)
    codes = np.empty((len(atlas.centres), 0), np.int32) if shown is None else read_codes(shown[0], atlas, shown[1])
    return codes, sidecar


def _read_key(package: Package, group: int, tier: int, quality: int) -> tuple[_Picture | None, KeySidecar]:
    """The picture of a key tier, None where it has none, and its sidecar, as in `decode_key`.

    The picture is decoded on another thread while columns are read.
    """
    m, g = package.manifest, package.manifest.groups[group]
    entry, differs, coarsest = g.tiers[tier], g.keeps is not None, m.qualities[-1].coarser
    sidecar_path, *media_paths = m.key_files(group, tier, quality)
    shape = package.read(sidecar_path), entry.count, g.grid, coarsest, sidecar_path, differs
    if not media_paths:
        return None, unpack_key_sidecar(*shape)
    (media,), atlas = media_paths, entry.qualities[quality]
    columns, pictures = open_segment(package.read(media), media, atlas.pages)
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, iter(pictures), None)
        shared = unpack_key_sidecar(*shape)
        reader = ColumnReader(columns, media)  # a difference has no detail of positions
        sidecar = shared if differs else read_detail(reader, shared, g.grid, m.qualities[quality].coarser, coarsest)
        jumps = escapes.read_columns(reader, (1, len(atlas.planes), atlas.rows))
        reader.close()
        picture = coming.result()
    if picture is None:
        raise FormatError("bad_picture", media, "expected one picture, got none")
    expect_size(picture, atlas, media)
    return (picture, next(jumps.running())), sidecar


def decode_segment(
    package: Package, index: int, base: Canonical, level: int, places: Sequence[int]
) -> Iterator[Gaussians]:
    """Frames of a segment over a decoded canonical space; `places` ascend and count from the start of the segment.

    `base` is that of the first key tiers, as many as viewers of the level fetch or others: its rows tell. H.264 is
    decoded up to the last frame. Raises FormatError.
    """
    m = package.manifest
    media = m.state_files(index, level)
    if not (places and len(base.means) and media):
        frame = base.to_gaussians()
        yield from (frame for _ in places)
        return
    group, units = m.groups[m.group_of(index)], state_units(package, index, level)
    atlas, rows = group.levels[level], np.flatnonzero((base.depths >= level) & (base.depths != STATIC))
    complete = len(base.means) >= sum(tier.count for tier in group.tiers[: m.levels[level].tiers])
    if len(rows) > atlas.rows or (complete and len(rows) != atlas.rows):
        raise FormatError("count_mismatch", media[0], f"the sidecars give {len(rows)} rows, the table {atlas.rows}")
    varies = [_varies(atlas, STATE.slice(name)) for name in ("quaternions", COLOUR)]
    applier = StateApplier.of(base, rows, group.state_steps, *varies)
    frames = range(places[0], places[-1] + 1)
    for place, state in zip(frames, decode_pictures(package, index, level, frames), strict=True):
        if place in places:
            yield applier.apply_parts(functools.partial(state.values, units=units))


def _varies(atlas: Atlas, channels: slice) -> bool:
    """Whether any of these channels may decode to something else than 0."""
    places = range(len(atlas.centres))[channels]
    return any(p in places for p in atlas.planes) or any(atlas.centres[channels])
