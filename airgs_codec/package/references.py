"""Checks of airgs.json that no single field can tell: counts, spans, and fields that refer to each other.

Each check relies on those before it. T tiers, Q key qualities, L levels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from airgs_codec.errors import FormatError
from airgs_codec.package.layout import KEY, STATE, Layout
from airgs_codec.package.tables import (
    BLOCK,
    JSON_NAME,
    MAX_BITS,
    MAX_SIDE,
    Atlas,
    Group,
    Manifest,
    Picture,
    Region,
    Segment,
    expected_files,
)

Bound = tuple[str, float, float, float]  # where, what came, the least and the most that may stand there


def check_references(m: Manifest) -> None:
    """Raise FormatError (bad_value, missing_entry) unless the tables fit each other."""
    _check_shapes(m)
    for where, value, low, high in _bounds(m):
        if not low <= value <= high:
            raise _bad(where, f"expected {low} to {high}, got {value}")
    check_region(m.region, f"{JSON_NAME}.region")
    _check_clock(m)
    _check_cover(m)
    for index, segment in enumerate(m.segments):
        _check_segment(m, index, segment)
    _check_numbers(m)
    for path in expected_files(m):
        if path not in m.files:
            raise FormatError("missing_entry", f"{JSON_NAME}.files", f"no entry for {path}")


def check_region(region: Region, where: str) -> None:
    """Raise FormatError (bad_value) unless every place has a direction to look in and one that is up."""
    for p, place in enumerate(region.places):
        for name, other in (("focus", place.position), ("up", [0.0, 0.0, 0.0])):
            if np.linalg.norm(np.subtract(got := getattr(place, name), other)) == 0:
                raise FormatError("bad_value", f"{where}.places[{p}].{name}", f"expected other than {other}, got {got}")


def _bad(where: str, detail: str) -> FormatError:
    return FormatError("bad_value", f"{JSON_NAME}.{where}", detail)


def _check_shapes(m: Manifest) -> None:
    """Ids, and lists that must be of the same length."""
    tiers, qualities, levels = m.tier_count, len(m.qualities), len(m.levels)
    shapes: list[tuple[str, list[int] | list[str], list[int] | list[str]]] = [
        ("qualities", [q.id for q in m.qualities], [f"Q{i}" for i in range(qualities)]),
        ("levels", [v.id for v in m.levels], [f"L{i}" for i in range(levels)]),
        ("key_pictures", [len(row) for row in m.key_pictures], [qualities] * tiers),
        ("state_pictures", [len(m.state_pictures)], [levels]),
    ]
    for g, group in enumerate(m.groups):
        shapes.append((f"groups[{g}].tiers", [len(group.tiers)], [tiers]))
        shapes.append((f"groups[{g}].levels", [len(group.levels)], [levels]))
        for t, tier in enumerate(group.tiers):
            shapes.append((f"groups[{g}].tiers[{t}].qualities", [len(tier.qualities)], [qualities]))
    shapes += [(f"segments[{s}].levels", [len(segment.levels)], [levels]) for s, segment in enumerate(m.segments)]
    for where, got, expected in shapes:
        if got != expected:
            raise _bad(where, f"expected {expected}, got {got}")


def _bounds(m: Manifest) -> Iterator[Bound]:
    for q, quality in enumerate(m.qualities):
        yield f"qualities[{q}].coarser", quality.coarser, m.qualities[q - 1].coarser if q else 0, MAX_BITS if q else 0
    finest = 0
    most = m.tier_count  # every tier is some level's: the first level has all of them
    for j, level in enumerate(m.levels):
        yield f"levels[{j}].tiers", level.tiers, 1 if j else most, most
        yield f"levels[{j}].quality", level.quality, finest, len(m.qualities) - 1
        most, finest = level.tiers, level.quality
    for g, group in enumerate(m.groups):
        yield from ((f"groups[{g}].{name}", *bound) for name, *bound in _group_bounds(m, group))  # type: ignore[misc]


def _group_bounds(m: Manifest, group: Group) -> Iterator[Bound]:
    counts = [tier.count for tier in group.tiers]
    fewest = m.levels[-1].tiers
    yield "static", group.static, 0, group.count
    yield "sum of tier counts", sum(counts), group.count, group.count
    yield f"rows of the first {fewest} tiers", sum(counts[:fewest]), 1, group.count
    for t, tier in enumerate(group.tiers):
        for q, atlas in enumerate(tier.qualities):
            where = f"tiers[{t}].qualities[{q}]"
            yield f"{where}.rows", atlas.rows, tier.count, tier.count
            yield from _atlas_bounds(where, atlas, KEY, m.colour_channels, m.key_pictures[t][q])
    for j, atlas in enumerate(group.levels):
        yield f"levels[{j}].rows", atlas.rows, 0, group.count - group.static
        yield from _atlas_bounds(f"levels[{j}]", atlas, STATE, m.colour_channels, m.state_pictures[j])


def _atlas_bounds(where: str, atlas: Atlas, layout: Layout, colours: int, picture: Picture) -> Iterator[Bound]:
    channels, attributes = layout.width(colours), len(layout.attributes)
    yield f"len({where}.centres)", len(atlas.centres), channels, channels
    yield f"len({where}.max_error)", len(atlas.max_error), attributes, attributes
    for i, plane in enumerate(atlas.planes):
        yield f"{where}.planes[{i}]", plane, atlas.planes[i - 1] + 1 if i else 0, channels - 1
    if atlas.planes:
        yield f"{where}.plane_width", atlas.plane_width, BLOCK, MAX_SIDE
        yield f"{where}.plane_width % {BLOCK}", atlas.plane_width % BLOCK, 0, 0
        yield f"{where}.columns", atlas.columns, 1, len(atlas.planes)
        width, height = atlas.size
        yield f"{where} width", width, BLOCK, picture.width
        yield f"{where} height", height, BLOCK, picture.height


def _check_clock(m: Manifest) -> None:
    if m.timescale * m.frame_rate[1] % m.frame_rate[0]:
        raise _bad("timescale", "a frame is not a whole number of ticks")


def _check_cover(m: Manifest) -> None:
    """Groups and segments each cover the frames without gap or overlap."""
    spans: dict[str, Sequence[Group | Segment]] = {"groups": m.groups, "segments": m.segments}
    for name, parts in spans.items():
        stop = 0
        for i, span in enumerate(parts):
            if span.start != stop or span.stop <= span.start:
                raise _bad(f"{name}[{i}]", f"expected to start at {stop}, got [{span.start}, {span.stop})")
            stop = span.stop
        if stop != m.frames:
            raise _bad(name, f"cover {stop} of {m.frames} frames")


def _check_segment(m: Manifest, index: int, segment: Segment) -> None:
    """A segment lies within its group, and says as much of each level as there is to say."""
    where = f"segments[{index}]"
    if not 0 <= segment.group < len(m.groups):
        raise _bad(f"{where}.group", f"no group {segment.group}")
    group = m.groups[segment.group]
    if segment.start < group.start or segment.stop > group.stop:
        raise _bad(where, f"crosses group {segment.group}")
    for j, level in enumerate(segment.levels):
        for name, got, allowed in (
            ("frame_bytes", len(level.frame_bytes), {segment.stop - segment.start if level.number else 0}),
            ("psnr", len(level.psnr), {0, len(m.qualities)}),
            ("worst", len(level.worst), {len(level.psnr)}),
            ("ssim", len(level.ssim), {len(level.psnr)}),
            ("delta_e", len(level.delta_e), {len(level.psnr)}),
            ("number", level.number, {level.number} if group.levels[j].planes else {0}),
        ):
            if got not in allowed:
                raise _bad(f"{where}.levels[{j}].{name}", f"expected {sorted(allowed)}, got {got}")


def _check_numbers(m: Manifest) -> None:
    """Files of a tier or level are numbered 1, 2, … in order; 0 says that there is none."""
    runs = {f"level L{j}": [s.levels[j].number for s in m.segments] for j in range(len(m.levels))}
    runs |= {f"tier T{t}": [g.tiers[t].number for g in m.groups] for t in range(m.tier_count)}
    for name, numbers in runs.items():
        present = [number for number in numbers if number]
        if present != list(range(1, len(present) + 1)):
            raise _bad(name, f"expected files 1, 2, … in order, got {present}")
