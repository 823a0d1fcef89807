"""Checks of tables that no single field can tell: counts, spans, and fields that refer to each other.

Each check relies on those before it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from airgs_codec.errors import FormatError
from airgs_codec.package.index import Entry
from airgs_codec.package.layout import JSON_NAME, STATE, Layout, key_layout
from airgs_codec.package.tables import (
    BLOCK,
    DIGEST,
    GRID_BITS,
    MAX_MACROBLOCKS,
    MAX_PAGES,
    MAX_PICTURE_SIDE,
    MAX_POSTER_BYTES,
    MIN_PICTURE_SIDE,
    PAGE,
    Atlas,
    FileEntry,
    Group,
    Header,
    Region,
    Root,
    Segment,
    Spans,
)

LEAST_SCALE, MOST_SCALE = 1e-6, 1e6  # of a transform to the world
MOST_NUMBER = 1e30  # of such a transform, as of all coordinates in tables
TOLERANCE = 1e-5  # of the products of its axes at length 1, and of the scale, beside its bounds
Bound = tuple[str, float, float, float]  # where, what came, the least and the most that may stand there


def check_root(m: Root) -> None:
    """Raise FormatError (bad_value, missing_entry) unless what airgs.json says fits together."""
    ids = [*(q.id for q in m.qualities), *(v.id for v in m.levels)]
    expected = [*(f"Q{i}" for i in range(len(m.qualities))), *(f"L{i}" for i in range(len(m.levels)))]
    if ids != expected:
        raise _bad(f"{JSON_NAME}.levels", f"expected {expected}, got {ids}")
    _check_bounds(JSON_NAME, _root_bounds(m))
    check_region(m.region, f"{JSON_NAME}.region")
    if m.world and (fault := fault_of(m.world.transform)):
        raise _bad(f"{JSON_NAME}.world.transform", fault)
    if m.timescale * m.frame_rate[1] % m.frame_rate[0]:
        raise _bad(f"{JSON_NAME}.timescale", "a frame is not a whole number of ticks")
    _check_file(f"{JSON_NAME}.init", m.init, True)
    if m.poster:
        _check_file(f"{JSON_NAME}.poster", m.poster, True)
        _check_bounds(JSON_NAME, iter([("poster.bytes", m.poster.bytes, 1, MAX_POSTER_BYTES)]))
    if m.sound:
        _check_file(f"{JSON_NAME}.sound.init", m.sound.init, True)
    _check_index(f"{JSON_NAME}.index", m)


def check_page(entry: Entry, page: Spans, where: str) -> None:
    """Raise FormatError (bad_value) unless a page holds what the level above says of it."""
    _check_columns(where, page)
    got = len(page), sum(page.frames), sum(page.segments)
    expected = PAGE, entry.stop - entry.start, entry.segments
    if got != expected:
        raise _bad(where, f"expected {expected} entries, frames and segments, got {got}")


def check_group(m: Header, entry: Entry, group: Group, where: str) -> None:
    """Raise FormatError (bad_value, missing_entry) unless the table of a group fits the package and itself."""
    got, expected = (group.start, group.stop, len(group.segments)), (entry.start, entry.stop, entry.segments)
    if got != expected:
        raise _bad(where, f"expected the start, stop and number of segments {expected}, got {got}")
    _check_shapes(m, group, where)
    _check_bounds(where, _group_bounds(m, group))
    _check_sound(m, group, f"{where}.sound")
    for t, tier in enumerate(group.tiers):
        _check_file(f"{where}.tiers[{t}].sidecar", tier.sidecar, tier.count > 0)
        for q, picture in enumerate(tier.pictures):
            _check_file(f"{where}.tiers[{t}].pictures[{q}]", picture, tier.qualities[q].rows > 0)
    stop = group.start
    for s, segment in enumerate(group.segments):
        if segment.start != stop or not stop < segment.stop <= group.stop:
            raise _bad(f"{where}.segments[{s}]", f"expected a start at {stop}, got [{segment.start}, {segment.stop})")
        stop = segment.stop
        _check_segment(m, group, segment, f"{where}.segments[{s}]")
    if stop != group.stop:
        raise _bad(f"{where}.segments", f"end at {stop}, the group at {group.stop}")


def _check_sound(m: Header, group: Group, where: str) -> None:
    """A group has an entry where the package has sound, and a file where a packet starts in its time."""
    if (group.sound is None) != (m.sound is None):
        raise _bad(where, "expected an entry where, and only where, airgs.json has sound")
    if group.sound:
        _check_file(where, group.sound, len(m.packets(group.start, group.stop)) > 0)


def check_keeps(group: Group, number: int, where: str) -> None:
    """Raise FormatError (bad_value) unless a group, counted from 0, keeps the rows of one before it, or none."""
    if group.keeps is not None and group.keeps > number:
        raise _bad(f"{where}.keeps", f"expected a group before {number + 1}, got {group.keeps}")


def check_base(group: Group, base: Group, where: str) -> None:
    """Raise FormatError (bad_value) unless `base`, whose rows a group keeps, keeps none and is laid out alike."""
    if base.keeps is not None:
        raise _bad(f"{where}.keeps", f"expected a group that keeps none, got {group.keeps}, which keeps {base.keeps}")
    if _laid_out(group) != _laid_out(base):
        raise _bad(f"{where}.keeps", f"expected a group of equal tiers, grid, key_steps and colours, got {group.keeps}")


def _laid_out(group: Group) -> tuple[object, ...]:
    """All that is equal in a group and its base."""
    return group.grid, group.key_steps, group.colour_transform, [(tier.count, tier.factor) for tier in group.tiers]


def check_region(region: Region, where: str) -> None:
    """Raise FormatError (bad_value) unless every place has a direction to look in and one that is up."""
    for p, place in enumerate(region.places):
        for name, other in (("focus", place.position), ("up", [0.0, 0.0, 0.0])):
            if np.linalg.norm(np.subtract(got := getattr(place, name), other)) == 0:
                raise FormatError("bad_value", f"{where}.places[{p}].{name}", f"expected other than {other}, got {got}")


def fault_of(transform: Sequence[float]) -> str | None:
    """Return what is wrong with a transform of 12 numbers, in words; None where it is a similarity without mirror."""
    large = [value for value in transform if not abs(value) <= MOST_NUMBER]
    if len(transform) != 12 or large:
        return f"expected 12 finite numbers of at most {MOST_NUMBER:g}, got {large[0] if large else len(transform)}"
    axes = np.reshape(transform, (3, 4))[:, :3]
    sizes = np.linalg.norm(axes, axis=1)
    scale = float(sizes.mean())
    if not LEAST_SCALE * (1 - TOLERANCE) <= scale <= MOST_SCALE * (1 + TOLERANCE):
        return f"expected a scale of {LEAST_SCALE:g} to {MOST_SCALE:g}, got {scale:g}"
    products = axes @ axes.T / scale**2
    if np.abs(products - np.eye(3)).max() > TOLERANCE:
        return f"expected a rotation with one scale for all axes, got rows {axes.tolist()}"
    if np.linalg.det(axes / scale) < 0:
        return "expected a right-handed turn, got one that mirrors"
    return None


def _bad(where: str, detail: str) -> FormatError:
    return FormatError("bad_value", where, detail)


def _check_bounds(where: str, bounds: Iterator[Bound]) -> None:
    for name, value, low, high in bounds:
        if not low <= value <= high:
            raise _bad(f"{where}.{name}", f"expected {low} to {high}, got {value}")


def _check_columns(where: str, spans: Spans) -> None:
    lengths = [len(spans.frames), len(spans.segments), len(spans.bytes), len(spans.sha256) / DIGEST]
    if len(set(lengths)) > 1:
        raise _bad(where, f"expected columns of one length, got {lengths}")


def _check_index(where: str, m: Root) -> None:
    """Return what fills no page, level by level, with no empty level at the end; the groups have all frames."""
    for level, spans in enumerate(m.index):
        here, fewest = f"{where}[{level}]", PAGE**level
        _check_columns(here, spans)
        if len(spans) >= PAGE:
            raise _bad(here, f"expected at most {PAGE - 1} entries, got {len(spans)}")
        least = min([*spans.frames, *spans.segments], default=fewest)
        if least < fewest:
            raise _bad(here, f"expected {fewest} frames and segments or more in each entry, got {least}")
    if not len(m.index[-1]):
        raise _bad(where, "expected an entry in the last level, got none")
    total = sum(sum(spans.frames) for spans in m.index)
    if total != m.frames:
        raise _bad(where, f"covers {total} of {m.frames} frames")


def _check_file(where: str, entry: FileEntry, wanted: bool) -> None:
    """A file is there where one is wanted, and only there; a length and a digest come together."""
    if not wanted and entry.bytes:
        raise _bad(where, "expected no file: nothing is to be fetched")
    if wanted and not entry.bytes:
        raise FormatError("missing_entry", where, "expected a file")
    if bool(entry.bytes) != bool(entry.sha256):
        raise _bad(where, f"expected both a length and a digest or neither, got {entry.bytes} and {entry.sha256!r}")


def _root_bounds(m: Header) -> Iterator[Bound]:
    for q, quality in enumerate(m.qualities):
        yield f"qualities[{q}].coarser", quality.coarser, m.qualities[q - 1].coarser if q else 0, GRID_BITS if q else 0
    finest, most = 0, m.tiers  # every tier is some level's: the first level has all of them
    for j, level in enumerate(m.levels):
        yield f"levels[{j}].tiers", level.tiers, 1 if j else most, most
        yield f"levels[{j}].quality", level.quality, finest, len(m.qualities) - 1
        most, finest = level.tiers, level.quality


def _check_shapes(m: Header, group: Group, where: str) -> None:
    """Lists that must be of the same length."""
    qualities, levels = len(m.qualities), len(m.levels)
    shapes = [("tiers", len(group.tiers), m.tiers), ("levels", len(group.levels), levels)]
    for t, tier in enumerate(group.tiers):
        shapes.append((f"tiers[{t}].qualities", len(tier.qualities), qualities))
        shapes.append((f"tiers[{t}].pictures", len(tier.pictures), qualities))
    shapes += [(f"segments[{s}].levels", len(segment.levels), levels) for s, segment in enumerate(group.segments)]
    for name, got, expected in shapes:
        if got != expected:
            raise _bad(f"{where}.{name}", f"expected {expected}, got {got}")


def _group_bounds(m: Header, group: Group) -> Iterator[Bound]:
    fewest = m.levels[-1].tiers
    yield "static", group.static, 0, group.count
    yield "sum of tier counts", sum(tier.count for tier in group.tiers), group.count, group.count
    first = sum(tier.count for tier in group.tiers[:fewest])
    yield f"rows of the first {fewest} tiers", first, 1, group.count
    layout = key_layout(group)
    yield "grid.step", group.grid.unit, 1 / MOST_NUMBER, MOST_NUMBER
    for t, tier in enumerate(group.tiers):
        for q, atlas in enumerate(tier.qualities):
            where, same = f"tiers[{t}].qualities[{q}]", group.keeps is not None and not atlas.rows
            yield f"{where}.rows", atlas.rows, 0 if same else tier.count, tier.count
            yield f"len({where}.planes)", len(atlas.planes), min(1, atlas.rows), layout.width(m.colour_channels)
            yield from _atlas_bounds(where, atlas, layout, m.colour_channels)
    for j, atlas in enumerate(group.levels):
        yield f"levels[{j}].rows", atlas.rows, 0, group.count - group.static
        yield from _atlas_bounds(f"levels[{j}]", atlas, STATE, m.colour_channels)


def _atlas_bounds(where: str, atlas: Atlas, layout: Layout, colours: int) -> Iterator[Bound]:
    channels, attributes = layout.width(colours), len(layout.attributes)
    yield f"len({where}.centres)", len(atlas.centres), channels, channels
    yield f"len({where}.max_error)", len(atlas.max_error), attributes, attributes
    for i, plane in enumerate(atlas.planes):
        yield f"{where}.planes[{i}]", plane, atlas.planes[i - 1] + 1 if i else 0, channels - 1
    if atlas.planes:
        yield f"{where}.plane_width", atlas.plane_width, BLOCK, MAX_PICTURE_SIDE
        yield f"{where}.plane_width % {BLOCK}", atlas.plane_width % BLOCK, 0, 0
        yield f"{where}.columns", atlas.columns, 1, len(atlas.planes)
        yield f"{where}.height", atlas.height, BLOCK, MAX_PICTURE_SIDE
        yield f"{where}.width", atlas.width, BLOCK, max(MIN_PICTURE_SIDE, atlas.size[0])
        yield f"{where}.width % {BLOCK}", atlas.width % BLOCK, 0, 0
        yield f"{where}.height % {BLOCK}", atlas.height % BLOCK, 0, 0
        yield f"{where} macroblocks", atlas.width * atlas.height // BLOCK**2, 1, MAX_MACROBLOCKS
        yield f"{where} width of the planes", atlas.size[0], BLOCK, atlas.width
        yield f"{where} pages", atlas.pages, 1, MAX_PAGES


def _check_segment(m: Header, group: Group, segment: Segment, where: str) -> None:
    """A segment says as much of each level as there is to say."""
    measured = len(m.qualities) if m.measured else 0
    for j, level in enumerate(segment.levels):
        here, fetched = f"{where}.levels[{j}]", level.file.bytes > 0
        _check_file(f"{here}.file", level.file, fetched and bool(group.levels[j].planes))
        counts = [
            ("frame_bytes", len(level.frame_bytes), segment.stop - segment.start if fetched else 0),
            ("psnr", len(level.psnr), measured),
            ("delta_e", len(level.delta_e), measured),
        ]
        for name, got, expected in counts:
            if got != expected:
                raise _bad(f"{here}.{name}", f"expected {expected} values, got {got}")
        if level.line and len(level.frame_bytes) < 2:
            raise _bad(f"{here}.line", f"expected at least 2 frames, got {len(level.frame_bytes)}")
