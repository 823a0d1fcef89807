"""Strict reading of airgs.json: the dataclasses of `manifest` are the schema; then counts, ranges and references."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import typing
from collections.abc import Iterator
from typing import Any

from airgs_codec.errors import FormatError
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.tables import (
    JSON_NAME,
    MAX_CHOICES,
    MAX_COUNT,
    MAX_FILE_BYTES,
    MAX_FRAMES,
    MAX_SIDE,
    VERSION,
    Atlas,
    Group,
    Manifest,
    Picture,
    Segment,
    expected_files,
)

_PATH = re.compile(r"key/T\d+/\d+\.bin|(key/T\d+/Q|state/L)\d+/(init\.mp4|\d+\.(m4s|bin))")


MAX_CENTRE = 1 << 30  # as quantize.CODE_LIMIT: a code, a centre and an escape add up within int32
MAX_DELTA_E = 1000.0  # CIEDE2000; the largest of two sRGB colours is about 120
MAX_PSNR = 1000.0  # dB; nothing measured comes near, and ten to the power of it is still a float


def parse_manifest(text: str | bytes) -> Manifest:
    """The value of an airgs.json. Raises FormatError whose `where` names the place.

    Reasons: not_json, unknown_version, unknown_field, missing_field, wrong_type, bad_value, unsafe_path, missing_entry.
    """
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise FormatError("not_json", JSON_NAME, f"expected JSON: {error}") from error
    if not isinstance(data, dict):
        raise FormatError("wrong_type", JSON_NAME, f"expected an object, got {type(data).__name__}")
    if data.get("version") != VERSION:
        raise FormatError("unknown_version", JSON_NAME, f"expected version {VERSION}, got {data.get('version')!r}")
    manifest: Manifest = _parse(Manifest, data, JSON_NAME)
    _check(manifest)
    return manifest


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")


def _parse(kind: Any, data: Any, where: str) -> Any:
    """`data` as a value of the annotated type `kind`; the dataclasses above are the schema."""
    origin = typing.get_origin(kind)
    if origin is list:
        (item,) = typing.get_args(kind)
        return [_parse(item, d, f"{where}[{i}]") for i, d in enumerate(_expect(data, list, where))]
    if origin is dict:
        _, item = typing.get_args(kind)
        return {k: _parse(item, d, f"{where}[{k!r}]") for k, d in _expect(data, dict, where).items()}
    if dataclasses.is_dataclass(kind):
        return _parse_dataclass(kind, _expect(data, dict, where), where)
    if kind is float:
        number = float(_expect(data, (int, float), where))
        if not math.isfinite(number):
            raise FormatError("bad_value", where, f"expected a finite number, got {data}")
        return number
    return _expect(data, kind, where)


def _parse_dataclass(kind: Any, data: dict[str, Any], where: str) -> Any:
    hints = typing.get_type_hints(kind)
    if unknown := sorted(data.keys() - hints.keys()):
        raise FormatError("unknown_field", where, f"unknown fields {unknown}")
    if missing := [name for name in hints if name not in data]:
        raise FormatError("missing_field", where, f"missing fields {missing}")
    return kind(**{name: _parse(hint, data[name], f"{where}.{name}") for name, hint in hints.items()})


def _expect(data: Any, kind: type | tuple[type, ...], where: str) -> Any:
    if not isinstance(data, kind) or isinstance(data, bool):
        names = kind.__name__ if isinstance(kind, type) else "number"
        raise FormatError("wrong_type", where, f"expected {names}, got {type(data).__name__}")
    return data


def _check(m: Manifest) -> None:
    """Counts, ranges and cross references of a parsed manifest, each relying on those before."""
    _check_shapes(m)
    for where, value, low, high in _ranges(m):
        if not low <= value <= high:
            raise FormatError("bad_value", f"{JSON_NAME}.{where}", f"expected {low} to {high}, got {value}")
    _check_cover(m)
    for path, entry in m.files.items():
        if not _PATH.fullmatch(path):
            raise FormatError("unsafe_path", f"{JSON_NAME}.files", f"not a path of this format: {path!r}")
        if not re.fullmatch(r"[0-9a-f]{64}", entry.sha256):
            raise FormatError("bad_value", f"{JSON_NAME}.files[{path!r}]", "expected 64 hex digits of SHA-256")
    for path in expected_files(m):
        if path not in m.files:
            raise FormatError("missing_entry", f"{JSON_NAME}.files", f"no entry for {path}")


def _ranges(m: Manifest) -> Iterator[tuple[str, float, float, float]]:
    yield "frames", m.frames, 1, MAX_FRAMES
    yield "sh_degree", m.sh_degree, 0, 3
    yield "timescale", m.timescale, 1, 1 << 31
    for i, v in enumerate(m.frame_rate):
        yield f"frame_rate[{i}]", v, 1, 1 << 31
    for name in ("key_gain", "state_gain"):
        yield name, getattr(m, name), 1e-3, 128
    for name in ("qualities", "levels", "key_pictures"):
        yield f"len({name})", len(getattr(m, name)), 1, MAX_CHOICES
    for quality in m.qualities:
        yield f"{quality.id}.factor", quality.factor, 1e-6, 1e6
    most = m.tier_count  # every tier is some level's: the first level has all of them
    for j, level in enumerate(m.levels):
        yield f"{level.id}.pruned", level.pruned, 0, 1
        yield f"{level.id}.factor", level.factor, 1e-6, 1e6
        yield f"{level.id}.tiers", level.tiers, 1 if j else most, most
        most = level.tiers
    for picture in (*(p for row in m.key_pictures for p in row), *m.state_pictures):
        yield "picture.width", picture.width, 0, MAX_SIDE
        yield "picture.height", picture.height, 0, MAX_SIDE
    for path, entry in m.files.items():
        yield f"files[{path!r}].bytes", entry.bytes, 1, MAX_FILE_BYTES
    for g, group in enumerate(m.groups):
        yield from ((f"groups[{g}].{n}", v, low, high) for n, v, low, high in _group_ranges(m, group))


def _group_ranges(m: Manifest, group: Group) -> Iterator[tuple[str, float, float, float]]:
    yield "count", group.count, 1, MAX_COUNT
    yield "static", group.static, 0, group.count
    yield "unused", group.unused, 0, MAX_COUNT
    yield "grid.bits", group.grid.bits, 1, 21
    yield "len(grid.origin)", len(group.grid.origin), 3, 3
    yield "grid.step", group.grid.step, 0, 1e30
    yield "grid.finest", group.grid.finest, -128, 127 + 21
    for steps in (group.key_steps, group.state_steps):
        for field in dataclasses.fields(steps):
            yield f"steps.{field.name}", getattr(steps, field.name), 1e-30, 1e30
    yield "sum of tier counts", sum(t.count for t in group.tiers), group.count, group.count
    key_channels, state_channels = 7 + m.colour_channels, 10 + m.colour_channels
    fewest = m.levels[-1].tiers if m.levels else 0
    yield f"rows of the first {fewest} tiers", sum(t.count for t in group.tiers[:fewest]), 1, group.count
    for t, tier in enumerate(group.tiers):
        for q, atlas in enumerate(tier.qualities):
            yield f"tiers[{t}].qualities[{q}].rows", atlas.rows, tier.count, tier.count
            yield from _atlas_ranges(
                f"tiers[{t}].qualities[{q}]", atlas, key_channels, len(KEY.attributes), m.key_pictures[t][q]
            )
    for j, atlas in enumerate(group.levels):
        yield f"levels[{j}].rows", atlas.rows, 0, group.count - group.static
        yield from _atlas_ranges(f"levels[{j}]", atlas, state_channels, len(STATE.attributes), m.state_pictures[j])


def _atlas_ranges(
    where: str, atlas: Atlas, channels: int, bounds: int, picture: Picture
) -> Iterator[tuple[str, float, float, float]]:
    yield f"len({where}.centres)", len(atlas.centres), channels, channels
    for centre in atlas.centres:
        yield f"{where}.centres", centre, -MAX_CENTRE, MAX_CENTRE
    yield f"len({where}.max_error)", len(atlas.max_error), bounds, bounds
    for error in atlas.max_error:
        yield f"{where}.max_error", error, 0, 1e38
    for i, plane in enumerate(atlas.planes):
        yield f"{where}.planes[{i}]", plane, atlas.planes[i - 1] + 1 if i else 0, channels - 1
    if atlas.planes:
        blocks = -(-atlas.rows // 256)
        yield f"{where}.plane_width", atlas.plane_width, 16, MAX_SIDE
        yield f"{where}.plane_width % 16", atlas.plane_width % 16, 0, 0
        yield f"{where}.columns", atlas.columns, 1, len(atlas.planes)
        height = 16 * -(-blocks // (atlas.plane_width // 16)) * -(-len(atlas.planes) // atlas.columns)
        yield f"{where} width", atlas.plane_width * atlas.columns, 16, picture.width
        yield f"{where} height", height, 16, picture.height


def _check_shapes(m: Manifest) -> None:
    """Ids, and lists that must be of the same length."""
    shapes = [
        ("qualities", [q.id for q in m.qualities], [f"Q{i}" for i in range(len(m.qualities))]),
        ("levels", [v.id for v in m.levels], [f"L{i}" for i in range(len(m.levels))]),
        ("frame_rate", [len(m.frame_rate)], [2]),
        ("key_pictures", [len(row) for row in m.key_pictures], [len(m.qualities)] * m.tier_count),
        ("state_pictures", [len(m.state_pictures)], [len(m.levels)]),
        *((f"groups[{g}].tiers", [len(group.tiers)], [m.tier_count]) for g, group in enumerate(m.groups)),
        *((f"groups[{g}].levels", [len(group.levels)], [len(m.levels)]) for g, group in enumerate(m.groups)),
        *(
            (f"groups[{g}].tiers[{t}].qualities", [len(tier.qualities)], [len(m.qualities)])
            for g, group in enumerate(m.groups)
            for t, tier in enumerate(group.tiers)
        ),
        *((f"segments[{s}].levels", [len(segment.levels)], [len(m.levels)]) for s, segment in enumerate(m.segments)),
    ]
    for where, got, expected in shapes:
        if got != expected:
            raise FormatError("bad_value", f"{JSON_NAME}.{where}", f"expected {expected}, got {got}")
    if m.views.source not in ("given", "generated") or m.views.reference not in ("original", "none"):
        raise FormatError("bad_value", f"{JSON_NAME}.views", f"unknown source or reference: {m.views}")


def _check_cover(m: Manifest) -> None:
    """Groups cover 0..frames without gap or overlap, segments cover each group, a frame is a whole number of ticks."""
    if m.timescale * m.frame_rate[1] % m.frame_rate[0]:
        raise FormatError("bad_value", f"{JSON_NAME}.timescale", "a frame is not a whole number of ticks")
    for name, spans in (("groups", m.groups), ("segments", m.segments)):
        stop = 0
        for i, span in enumerate(typing.cast("list[Group | Segment]", spans)):
            if span.start != stop or span.stop <= span.start:
                detail = f"expected to start at {stop}, got [{span.start}, {span.stop})"
                raise FormatError("bad_value", f"{JSON_NAME}.{name}[{i}]", detail)
            stop = span.stop
        if stop != m.frames:
            raise FormatError("bad_value", f"{JSON_NAME}.{name}", f"cover {stop} of {m.frames} frames")
    for i, group in enumerate(m.groups):
        if not group.start <= group.canonical < group.stop:
            raise FormatError("bad_value", f"{JSON_NAME}.groups[{i}].canonical", f"{group.canonical} is outside")
    for i, segment in enumerate(m.segments):
        _check_segment(m, i, segment)
    runs = [(f"level L{j}", [s.levels[j].number for s in m.segments]) for j in range(len(m.levels))]
    runs += [(f"tier T{t}", [g.tiers[t].number for g in m.groups]) for t in range(m.tier_count)]
    for name, numbers in runs:
        present = [number for number in numbers if number]
        if present != list(range(1, len(present) + 1)):
            raise FormatError("bad_value", f"{JSON_NAME} {name}", f"expected files 1, 2, … in order, got {present}")


def _check_segment(m: Manifest, index: int, segment: Segment) -> None:
    where = f"{JSON_NAME}.segments[{index}]"
    if not 0 <= segment.group < len(m.groups):
        raise FormatError("bad_value", f"{where}.group", f"no group {segment.group}")
    group = m.groups[segment.group]
    if segment.start < group.start or segment.stop > group.stop:
        raise FormatError("bad_value", where, f"crosses group {segment.group}")
    for j, level in enumerate(segment.levels):
        for name, value, low, high in (
            *(("frame_bytes", size, 1, MAX_FILE_BYTES) for size in level.frame_bytes),
            *(("psnr", value, -MAX_PSNR, MAX_PSNR) for value in level.psnr),
            *(("ssim", value, -1, 1) for value in level.ssim),
            *(("delta_e", value, 0, MAX_DELTA_E) for value in level.delta_e),
        ):
            if not low <= value <= high:
                raise FormatError("bad_value", f"{where}.levels[{j}].{name}", f"expected {low} to {high}, got {value}")
        for name, got, allowed in (
            ("frame_bytes", len(level.frame_bytes), {segment.stop - segment.start if level.number else 0}),
            ("psnr", len(level.psnr), {0, len(m.qualities)}),
            ("ssim", len(level.ssim), {len(level.psnr)}),
            ("delta_e", len(level.delta_e), {len(level.psnr)}),
            ("number", level.number, {0} if not group.levels[j].planes else {max(0, level.number)}),
        ):
            if got not in allowed:
                raise FormatError("bad_value", f"{where}.levels[{j}].{name}", f"expected {sorted(allowed)}, got {got}")
