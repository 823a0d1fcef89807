"""What is in a package, as figures: its groups, key tiers, levels and rungs, with their bytes and qualities.

A rung is a key quality together with a level. Lengths are in bytes, rates in bit/s. `to_json` gives the same figures as
plain values, `text` and `plot` show them to people.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.metrics import psnr
from airgs_codec.media.sound import LAYOUTS
from airgs_codec.package.layout import KEY, STATE, Layout
from airgs_codec.package.manifest import Manifest, on_ladder, pooled_quality
from airgs_codec.package.region import RegionSummary
from airgs_codec.package.tables import Atlas, LeftOut, Views, World

NAMES = {"gaussians": "Gaussians", "updates": "rows are never updated"}  # of what an encoder leaves out
FEW = 4  # groups of which each has a line of its own, where something was left out


@dataclass(frozen=True, slots=True)
class GroupSummary:
    """One group of frames."""

    frames: tuple[int, int]  # [start, stop)
    gaussians: int  # rows written
    static: int  # rows that no level carries
    unused: int  # Gaussians that no view uses: not written
    segments: int
    grid_bits: int
    keeps: int | None  # the earlier group, from 1, that its key is a difference to


@dataclass(frozen=True, slots=True)
class KeySummary:
    """One key tier in one key quality, over all groups."""

    tier: str
    quality: str
    factor: float  # of the quantiser steps
    gaussians: tuple[int, int]  # fewest and most rows of a group
    bytes_per_frame: float


@dataclass(frozen=True, slots=True)
class LevelSummary:
    """One level without its keys; its quality is that of the level with the keys in Q0."""

    id: str
    pruned: float  # share of the moving rows, 0..1
    factor: float  # of the quantiser steps
    gaussians: tuple[int, int]  # fewest and most rows of a group that it carries
    bytes_per_frame: float
    mean_bps: float
    peak_bps: float  # of its largest segment
    psnr: float | None  # dB, of the error pooled over pictures; None: not measured, as are the next three
    worst: float | None  # dB, of the worst picture
    ssim: float | None
    delta_e: float | None  # CIEDE2000
    max_error: dict[str, float]  # the largest over groups, for each attribute in the units of its channels


@dataclass(frozen=True, slots=True)
class RungSummary:
    """Everything that a viewer of one rung fetches from start to end."""

    key: str
    state: str
    bytes_per_frame: float
    mean_bps: float
    psnr: float | None  # dB, of the error pooled over pictures; None: not measured, as are the next three
    worst: float | None  # dB, of the worst picture
    ssim: float | None
    delta_e: float | None  # CIEDE2000
    best: bool  # on the ladder, see `ladder`


@dataclass(frozen=True, slots=True)
class SoundSummary:
    """The sound."""

    form: str  # mono, stereo
    mean_bps: float


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures of a package."""

    frames: int
    fps: float
    duration_s: float
    sh_degree: int
    package_bytes: int
    region: RegionSummary
    world: World | None
    background: tuple[float, ...]  # r, g, b of [0, 1]; empty: black
    views: Views
    groups: tuple[GroupSummary, ...]
    keys: tuple[KeySummary, ...]
    levels: tuple[LevelSummary, ...]
    rungs: tuple[RungSummary, ...]  # key quality by key quality
    sound: SoundSummary | None
    top_rung_bytes: dict[str, int]  # see `bytes_by_kind`
    left_out: tuple[str, ...]
    repairs: tuple[str, ...]
    decisions: tuple[str, ...]
    attribution: str

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return dataclasses.asdict(self)


def summarise(m: Manifest, manifest_bytes: int) -> Summary:
    """The figures of a package whose tables and manifest.mpd have `manifest_bytes` together."""
    qualities, levels = range(len(m.qualities)), range(len(m.levels))
    return Summary(
        frames=m.frames,
        fps=float(m.fps),
        duration_s=float(m.frames / m.fps),
        sh_degree=m.sh_degree,
        package_bytes=manifest_bytes + m.media_bytes(),
        region=RegionSummary.of(m.region),
        world=m.world,
        background=tuple(m.region.background or ()),
        views=m.views,
        groups=tuple(_group(m, g) for g in range(len(m.groups))),
        keys=tuple(_key(m, t, q) for t in range(m.tiers) for q in qualities),
        levels=tuple(_level(m, j) for j in levels),
        rungs=ladder([_rung(m, q, j, manifest_bytes) for q in qualities for j in levels]),
        sound=_sound(m),
        top_rung_bytes=bytes_by_kind(m, 0, 0, manifest_bytes),
        left_out=tuple(describe_left_out(m)),
        repairs=tuple(line for group in m.groups for line in group.repairs),
        decisions=tuple(m.decisions),
        attribution=m.attribution,
    )


def _sound(m: Manifest) -> SoundSummary | None:
    size = sum(group.sound.bytes for group in m.groups if group.sound)
    return SoundSummary(LAYOUTS[m.sound.channels], 8 * size * float(m.fps) / m.frames) if m.sound else None


def _group(m: Manifest, index: int) -> GroupSummary:
    g = m.groups[index]
    return GroupSummary((g.start, g.stop), g.count, g.static, g.unused, len(g.segments), g.grid.bits, g.keeps)


def _key(m: Manifest, tier: int, quality: int) -> KeySummary:
    counts = [group.tiers[tier].count for group in m.groups]
    total = sum(m.bytes_of(m.key_files(g, tier, quality)) for g in range(len(m.groups)))
    entry = m.qualities[quality]
    return KeySummary(f"T{tier}", entry.id, entry.factor, (min(counts), max(counts)), total / m.frames)


def _level(m: Manifest, index: int) -> LevelSummary:
    level = m.levels[index]
    rows = [group.levels[index].rows for group in m.groups]
    total = sum(m.bytes_of(m.state_files(i, index)) for i in range(len(m.segments)))
    errors = np.array([group.levels[index].max_error for group in m.groups]).max(axis=0).tolist()
    return LevelSummary(
        id=level.id,
        pruned=level.pruned,
        factor=level.factor,
        gaussians=(min(rows), max(rows)),
        bytes_per_frame=total / m.frames,
        mean_bps=8 * total * float(m.fps) / m.frames,
        peak_bps=float(segment_rates(m, index).max()),
        **_quality(m, index, 0),
        max_error=dict(zip(STATE.attributes, errors, strict=True)),
    )


def _rung(m: Manifest, quality: int, level: int, manifest_bytes: int) -> RungSummary:
    total = rung_bytes(m, quality, level, manifest_bytes)
    return RungSummary(
        key=m.qualities[quality].id,
        state=m.levels[level].id,
        bytes_per_frame=total / m.frames,
        mean_bps=8 * total * float(m.fps) / m.frames,
        **_quality(m, level, quality),
        best=False,
    )


def rung_bytes(m: Manifest, quality: int, level: int, manifest_bytes: int) -> int:
    """Everything that a viewer of one rung fetches: keys, states, and all tables with manifest.mpd."""
    return manifest_bytes + m.bytes_of(m.rung_files(quality, level))


def _quality(m: Manifest, level: int, quality: int) -> dict[str, Any]:
    measured = pooled_quality(m, level, quality)
    return dataclasses.asdict(measured) if measured else dict.fromkeys(("psnr", "worst", "ssim", "delta_e"))


def segment_rates(m: Manifest, level: int) -> NDArray[np.float64]:
    """(S,) bit/s of each segment of a level: its pictures and its escapes over its duration."""
    return np.array(
        [8 * m.bytes_of(m.state_files(i, level)) / float((s.stop - s.start) / m.fps) for i, s in enumerate(m.segments)]
    )


def ladder(rungs: list[RungSummary]) -> tuple[RungSummary, ...]:
    """The rungs with `best` set for those that `on_ladder` finds."""
    best = on_ladder([(rung.bytes_per_frame, rung.psnr) for rung in rungs])
    return tuple(dataclasses.replace(rung, best=one) for rung, one in zip(rungs, best, strict=True))


def bytes_by_kind(m: Manifest, quality: int, level: int, manifest_bytes: int) -> dict[str, int]:
    """Bytes that a viewer of one rung fetches: pictures, sidecars, escapes of states with MP4 boxes, sound, and tables.

    State pictures are H.264 alone; key pictures count with the detail of positions, their escapes and boxes.
    """
    tiers = [tier for group in m.groups for tier in group.tiers[: m.levels[level].tiers]]
    states = [segment.levels[level] for segment in m.segments]
    pictures = sum(sum(state.frame_bytes) for state in states)
    return {
        "key pictures": sum(tier.pictures[quality].bytes for tier in tiers),
        "key sidecars": sum(tier.sidecar.bytes for tier in tiers),
        "state pictures": pictures,
        "escapes and boxes": sum(state.file.bytes for state in states) - pictures,
        **({"sound": sum(group.sound.bytes for group in m.groups if group.sound)} if m.sound else {}),
        "manifests": manifest_bytes,
    }


def describe_left_out(m: Manifest) -> list[str]:
    """One line each; what concerns more than FEW groups alike is one line."""
    lines = [*_decisions(m), *_constant(m)]
    quiet = sum(not s.levels[0].file.bytes for s in m.segments)
    if quiet:
        lines.append(f"{quiet} state segments: nothing moves in them by more than half a step")
    if m.sh_degree == 0:
        lines.append("SH rest: the scene has none")
    return lines


def _decisions(m: Manifest) -> Iterator[str]:
    """The entries of `left_out`, by what they are."""
    entries: dict[str, list[tuple[int, LeftOut]]] = {}
    for number, group in enumerate(m.groups):
        for entry in group.left_out:
            entries.setdefault(entry.what, []).append((number, entry))
    for what, same in entries.items():
        groups = [same] if len(same) > FEW else [[one] for one in same]
        yield from (_sentence(what, [number for number, _ in some], [entry for _, entry in some]) for some in groups)


def _sentence(what: str, groups: list[int], entries: list[LeftOut]) -> str:
    """A line about one group, or about many: ranges, and the largest error."""
    error = max(entry.error for entry in entries)
    alone = f"{psnr(error):.1f} dB by itself" if error > 0 else "no error"
    saved = f"{np.mean([entry.bytes for entry in entries]) / 1e3:.2f} kB/frame saved"
    count = span(min(entry.count for entry in entries), max(entry.count for entry in entries))
    where = f"group {groups[0]}" if len(groups) == 1 else f"{len(groups)} groups"
    worst = "at worst " if len(groups) > 1 and error > 0 else ""
    return f"{where}: {count} {NAMES.get(what, what)}: {worst}{alone}, {saved}"


def _constant(m: Manifest) -> Iterator[str]:
    """Tiers without rows, and channels without a plane in the top rung."""
    groups: dict[str, list[int]] = {}
    for i, group in enumerate(m.groups):
        for t, tier in enumerate(group.tiers):
            if not tier.count:
                groups.setdefault(f"key tier T{t}: it has no rows", []).append(i)
        keys = [(f"key T{t} Q0", tier.qualities[0], KEY) for t, tier in enumerate(group.tiers)]
        for name, atlas, layout in (*keys, ("state L0", group.levels[0], STATE)):
            if text := _without_plane(atlas, layout):
                groups.setdefault(f"planes of {name}: {text} (constant within half a step)", []).append(i)
    for text, where in groups.items():
        yield from [f"{len(where)} groups: {text}"] if len(where) > FEW else [f"group {i}: {text}" for i in where]


def _without_plane(atlas: Atlas, layout: Layout) -> str:
    """How many channels of which attribute have no plane; empty when all have one."""
    missing = set(range(len(atlas.centres) if atlas.rows else 0)) - set(atlas.planes)
    counts = Counter(layout.attribute_of(channel) for channel in sorted(missing))
    return ", ".join(f"{count} {attribute}" for attribute, count in counts.items())


def span(low: int, high: int) -> str:
    """A range of whole numbers."""
    return str(low) if low == high else f"{low}-{high}"
