"""airgs.json: the normative tables of a package, as frozen values, and their strict JSON form.

T tiers, Q key qualities, L levels. Every number in `files` counts bytes. FORMAT.md says what each field means;
`parse_manifest` refuses what FORMAT.md does not name.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import math
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import FormatError
from airgs_codec.gaussians import SH_REST

VERSION = 1
JSON_NAME = "airgs.json"
MPD_NAME = "manifest.mpd"

MAX_COUNT = 1 << 24  # Gaussians a group
MAX_FRAMES = 1_000_000
MAX_SIDE = 16384  # samples, either side of a picture
MAX_FILE_BYTES = 1 << 31
MAX_CHOICES = 64  # tiers, qualities, levels
STATE_ATTRIBUTES = ("means", "quaternions", "log_scales", "opacity", "sh_dc", "sh_rest")
KEY_ATTRIBUTES = STATE_ATTRIBUTES[1:]  # canonical means travel in the sidecar


@dataclass(frozen=True, slots=True)
class Generator:
    """Who wrote the package and with what."""

    version: str
    libraries: dict[str, str]
    settings: dict[str, str]


@dataclass(frozen=True, slots=True)
class Views:
    """Where usage and quality were measured."""

    source: str  # "given" cameras or "generated" ones
    usage: int  # cameras that usage was measured on
    measured: int  # cameras that quality was measured on
    width: int  # pixels, of the first measured camera
    height: int
    reference: str  # "original" (the unpruned input) or "none" (not measured)


@dataclass(frozen=True, slots=True)
class KeyQuality:
    """A quality of the key: steps multiplied by `factor`."""

    id: str
    factor: float


@dataclass(frozen=True, slots=True)
class Level:
    """A pruning level: which share of the moving rows is withheld, and the step factor of the others."""

    id: str
    pruned: float  # share of the moving rows, 0..1
    factor: float


@dataclass(frozen=True, slots=True)
class Picture:
    """The coded picture of a representation, the same in every segment; 0x0 when it has none."""

    width: int
    height: int
    codecs: str  # RFC 6381, such as avc1.64000D


@dataclass(frozen=True, slots=True)
class Grid:
    """The cubic grid of canonical means: mean = origin + step * index, index 0 .. 2^bits - 1."""

    origin: list[float]  # (3,) world units
    step: float  # world units
    bits: int


@dataclass(frozen=True, slots=True)
class KeySteps:
    """Quantiser steps of the key at factor 1."""

    quaternions: float  # radians
    log_scales: float  # ln
    opacity: float  # of [0, 1]
    sh_dc: float
    sh_rest: float


@dataclass(frozen=True, slots=True)
class StateSteps:
    """Quantiser steps of the state at factor 1."""

    means: float  # sqrt(world units): displacement / sqrt(size of the row)
    quaternions: float  # radians
    log_scales: float  # ln
    opacity: float  # of [0, 1]
    sh_dc: float
    sh_rest: float


@dataclass(frozen=True, slots=True)
class Atlas:
    """How one group's rows lie in the pictures of a representation."""

    rows: int
    centres: list[int]  # a code for every channel
    planes: list[int]  # channels that have a plane, ascending; the others are constant at their centre
    plane_width: int  # samples, a multiple of 16
    columns: int  # planes side by side


@dataclass(frozen=True, slots=True)
class GroupTier:
    """One key tier of one group."""

    count: int  # rows
    number: int  # of its files; 0: no rows, no files
    qualities: list[Atlas]


@dataclass(frozen=True, slots=True)
class Group:
    """Frames [start, stop) that share the canonical space of frame `canonical`."""

    start: int
    stop: int
    canonical: int
    count: int  # rows written, over all tiers
    static: int  # rows of `count` that no level carries
    unused: int  # Gaussians no view uses: not written
    grid: Grid
    key_steps: KeySteps
    state_steps: StateSteps
    colour_transform: str  # base64 of C x C little-endian int16, in 1/32767; row k makes channel k
    tiers: list[GroupTier]
    levels: list[Atlas]


@dataclass(frozen=True, slots=True)
class SegmentLevel:
    """One level of one segment."""

    number: int  # of its files; 0: nothing to fetch, the canonical space is shown
    frame_bytes: list[int]  # H.264 bytes of each frame, in display order
    psnr: list[float]  # dB for each key quality; empty: not measured
    ssim: list[float]


@dataclass(frozen=True, slots=True)
class Segment:
    """Frames [start, stop) of group `group`, fetched and decoded together."""

    group: int
    start: int
    stop: int
    levels: list[SegmentLevel]


@dataclass(frozen=True, slots=True)
class FileEntry:
    """Length and digest of a file of the package."""

    bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """Everything a decoder needs that is not pixels."""

    version: int
    generator: Generator
    attribution: str
    repairs: list[str]  # what was mended in the input before coding
    frame_rate: list[int]  # numerator, denominator: frames a second
    timescale: int  # ticks a second in the MP4 files and the MPD
    frames: int
    sh_degree: int
    key_gain: float  # luma levels a step in key atlases
    state_gain: float  # luma levels a step in state atlases
    views: Views
    qualities: list[KeyQuality]
    levels: list[Level]
    key_pictures: list[list[Picture]]  # T x Q
    state_pictures: list[Picture]  # L
    groups: list[Group]
    segments: list[Segment]
    files: dict[str, FileEntry]

    @property
    def fps(self) -> Fraction:
        """Frames a second, exact."""
        return Fraction(*self.frame_rate)

    @property
    def frame_ticks(self) -> int:
        """Duration of a frame in ticks of `timescale`."""
        return self.timescale * self.frame_rate[1] // self.frame_rate[0]

    @property
    def colour_channels(self) -> int:
        """Colour channels C of an atlas: three DC, then SH rest."""
        return 3 * (1 + SH_REST[self.sh_degree])

    @property
    def tier_count(self) -> int:
        """T."""
        return len(self.key_pictures)

    def key_files(self, group: int, tier: int, quality: int) -> list[str]:
        """Files of one key unit without its init segment; empty when the tier has no rows in that group."""
        number = self.groups[group].tiers[tier].number
        return [key_media_path(tier, quality, number), key_sidecar_path(tier, number)] if number else []

    def state_files(self, segment: int, level: int) -> list[str]:
        """Files of one state segment without its init segment; empty when there is nothing to fetch."""
        number = self.segments[segment].levels[level].number
        return [state_media_path(level, number), state_sidecar_path(level, number)] if number else []

    def init_files(self, quality: int, level: int) -> list[str]:
        """Init segments of everything a viewer of one rung decodes."""
        keys = [key_init_path(t, quality) for t, row in enumerate(self.key_pictures) if row[quality].width]
        return keys + ([state_init_path(level)] if self.state_pictures[level].width else [])

    def bytes_of(self, paths: list[str]) -> int:
        """Total length of files."""
        return sum(self.files[path].bytes for path in paths)

    def rung_files(self, quality: int, level: int) -> list[str]:
        """Every file a viewer of one rung fetches from start to end, without the two manifests."""
        paths = self.init_files(quality, level)
        for group in range(len(self.groups)):
            for tier in range(self.tier_count):
                paths += self.key_files(group, tier, quality)
        for segment in range(len(self.segments)):
            paths += self.state_files(segment, level)
        return paths

    def segment_at(self, frame: int) -> int:
        """Index of the segment that shows `frame`. Raises IndexError outside the sequence."""
        for index, segment in enumerate(self.segments):
            if segment.start <= frame < segment.stop:
                return index
        raise IndexError(f"frame {frame}: the sequence has frames 0..{self.frames - 1}")

    def to_json(self) -> str:
        """The text of airgs.json; `parse_manifest` gives the same value back."""
        return json.dumps(dataclasses.asdict(self), separators=(",", ":"), allow_nan=False)


def key_init_path(tier: int, quality: int) -> str:
    """Init segment of a key representation."""
    return f"key/T{tier}/Q{quality}/init.mp4"


def key_media_path(tier: int, quality: int, number: int) -> str:
    """Picture of a key unit."""
    return f"key/T{tier}/Q{quality}/{number}.m4s"


def key_sidecar_path(tier: int, number: int) -> str:
    """Sidecar of a key unit, shared by its qualities."""
    return f"key/T{tier}/{number}.bin"


def state_init_path(level: int) -> str:
    """Init segment of a state representation."""
    return f"state/L{level}/init.mp4"


def state_media_path(level: int, number: int) -> str:
    """Pictures of a state segment."""
    return f"state/L{level}/{number}.m4s"


def state_sidecar_path(level: int, number: int) -> str:
    """Escapes of a state segment."""
    return f"state/L{level}/{number}.bin"


_PATH = re.compile(r"key/T\d+/(\d+\.bin|Q\d+/(init\.mp4|\d+\.m4s))|state/L\d+/(init\.mp4|\d+\.(m4s|bin))")


def pack_matrix(matrix: NDArray[np.float64]) -> str:
    """Entries in -1..1 as base64 of little-endian int16 in 1/32767, row by row."""
    return base64.b64encode(np.rint(matrix * 32767).astype("<i2").tobytes()).decode("ascii")


def unpack_matrix(text: str, side: int) -> NDArray[np.float64]:
    """Inverse of `pack_matrix`: (side, side). Raises FormatError(bad_value)."""
    try:
        raw = base64.b64decode(text, validate=True)
        return np.frombuffer(raw, "<i2").reshape(side, side) / 32767.0
    except ValueError as error:
        raise FormatError(
            "bad_value", f"{JSON_NAME} colour_transform", f"expected {side}x{side} int16: {error}"
        ) from error


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
    for level in m.levels:
        yield f"{level.id}.pruned", level.pruned, 0, 1
        yield f"{level.id}.factor", level.factor, 1e-6, 1e6
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
    for steps in (group.key_steps, group.state_steps):
        for field in dataclasses.fields(steps):
            yield f"steps.{field.name}", getattr(steps, field.name), 1e-30, 1e30
    yield "sum of tier counts", sum(t.count for t in group.tiers), group.count, group.count
    key_channels, state_channels = 7 + m.colour_channels, 10 + m.colour_channels
    for t, tier in enumerate(group.tiers):
        for q, atlas in enumerate(tier.qualities):
            yield f"tiers[{t}].qualities[{q}].rows", atlas.rows, tier.count, tier.count
            yield from _atlas_ranges(f"tiers[{t}].qualities[{q}]", atlas, key_channels, m.key_pictures[t][q])
    for j, atlas in enumerate(group.levels):
        yield f"levels[{j}].rows", atlas.rows, 0, group.count - group.static
        yield from _atlas_ranges(f"levels[{j}]", atlas, state_channels, m.state_pictures[j])


def _atlas_ranges(
    where: str, atlas: Atlas, channels: int, picture: Picture
) -> Iterator[tuple[str, float, float, float]]:
    yield f"len({where}.centres)", len(atlas.centres), channels, channels
    for centre in atlas.centres:
        yield f"{where}.centres", centre, -(1 << 31), 1 << 31
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


def _check_segment(m: Manifest, index: int, segment: Segment) -> None:
    where = f"{JSON_NAME}.segments[{index}]"
    if not 0 <= segment.group < len(m.groups):
        raise FormatError("bad_value", f"{where}.group", f"no group {segment.group}")
    group = m.groups[segment.group]
    if segment.start < group.start or segment.stop > group.stop:
        raise FormatError("bad_value", where, f"crosses group {segment.group}")
    for j, level in enumerate(segment.levels):
        for name, got, allowed in (
            ("frame_bytes", len(level.frame_bytes), {segment.stop - segment.start if level.number else 0}),
            ("psnr", len(level.psnr), {0, len(m.qualities)}),
            ("ssim", len(level.ssim), {0, len(m.qualities)}),
            ("number", level.number, {0} if not group.levels[j].planes else {max(0, level.number)}),
        ):
            if got not in allowed:
                raise FormatError("bad_value", f"{where}.levels[{j}].{name}", f"expected {sorted(allowed)}, got {got}")


def expected_files(m: Manifest) -> list[str]:
    """Every file the tables refer to, each once, in the order of the package's folders."""
    paths: dict[str, None] = {}
    for quality in range(len(m.qualities)):
        for level in range(len(m.levels)):
            paths.update(dict.fromkeys(m.rung_files(quality, level)))
    return sorted(paths)
