"""What is in a package, as figures: its groups, key tiers, levels and rungs, with their bytes and qualities.

A rung is a key quality together with a level. Lengths are in bytes, rates in bit/s. `to_json` gives the same figures as
plain values, `format_summary` as tables of text, `plot` draws them.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec import _report
from airgs_codec.media.metrics import psnr
from airgs_codec.media.sound import LAYOUTS
from airgs_codec.package.layout import KEY, STATE, Layout
from airgs_codec.package.manifest import Manifest, Rung, pooled_quality, rungs_of
from airgs_codec.package.region import RegionSummary, world_words
from airgs_codec.package.tables import Atlas, LeftOut, Views, World

NOTHING = ("0", "0 %", "-", "", "…")  # cells of a column that this scene does not need
MOST_GROUPS = 12  # in the table of groups
QUALITY_HEADS = ["PSNR dB", "worst", "SSIM", "ΔE"]
NAMES = {"gaussians": "Gaussians", "updates": "rows are never updated"}  # of what an encoder leaves out
FEW = 4  # groups of which each has a line of its own, where something was left out


@dataclass(frozen=True, slots=True)
class GroupSummary:
    frames: tuple[int, int]  # [start, stop)
    gaussians: int  # rows written
    static: int  # rows that no level carries
    unused: int  # Gaussians that no view uses: not written
    segments: int
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
    id: str
    pruned: float  # share of the moving rows, 0..1
    factor: float  # of the quantiser steps
    gaussians: tuple[int, int]  # fewest and most rows of a group that it carries
    bytes_per_frame: float
    mean_bps: float
    peak_bps: float  # of its largest segment


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
    best: bool  # whether players choose it, see `on_ladder`


@dataclass(frozen=True, slots=True)
class SoundSummary:
    form: str  # mono, stereo
    mean_bps: float


@dataclass(frozen=True, slots=True)
class Summary:
    frames: int
    fps: float
    duration_s: float
    sh_degree: int
    package_bytes: int
    region: RegionSummary
    world: World | None
    origin: tuple[float, ...]  # (3,) in the world; empty: zero
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
        origin=tuple(m.origin or ()),
        background=tuple(m.region.background or ()),
        views=m.views,
        groups=tuple(_group(m, g) for g in range(len(m.groups))),
        keys=tuple(_key(m, t, q) for t in range(m.tiers) for q in qualities),
        levels=tuple(_level(m, j) for j in levels),
        rungs=tuple(_rung(m, rung) for rung in rungs_of(m, manifest_bytes)),
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
    return GroupSummary((g.start, g.stop), g.count, g.static, g.unused, len(g.segments), g.keeps)


def _key(m: Manifest, tier: int, quality: int) -> KeySummary:
    counts = [group.tiers[tier].count for group in m.groups]
    total = sum(m.bytes_of(m.key_files(g, tier, quality)) for g in range(len(m.groups)))
    entry = m.qualities[quality]
    return KeySummary(f"T{tier}", entry.id, entry.factor, (min(counts), max(counts)), total / m.frames)


def _level(m: Manifest, index: int) -> LevelSummary:
    level = m.levels[index]
    rows = [group.levels[index].rows for group in m.groups]
    total = sum(m.bytes_of(m.state_files(i, index)) for i in range(len(m.segments)))
    return LevelSummary(
        id=level.id,
        pruned=level.pruned,
        factor=level.factor,
        gaussians=(min(rows), max(rows)),
        bytes_per_frame=total / m.frames,
        mean_bps=8 * total * float(m.fps) / m.frames,
        peak_bps=float(segment_rates(m, index).max()),
    )


def _rung(m: Manifest, rung: Rung) -> RungSummary:
    per_frame = rung.bytes / m.frames
    quality = _quality(m, m.level_index(rung.level), m.quality_index(rung.key_quality))
    return RungSummary(rung.key_quality, rung.level, per_frame, 8 * per_frame * float(m.fps), **quality, best=rung.best)


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
    counts = Counter(layout.names(1 + max(missing))[channel] for channel in sorted(missing))
    return ", ".join(f"{count} {attribute}" for attribute, count in counts.items())


def span(low: int, high: int) -> str:
    return str(low) if low == high else f"{low}-{high}"


def format_summary(s: Summary) -> str:
    """All tables, and what was left out and repaired."""
    kinds = [f"{kind} {_kilobytes(size / s.frames)}" for kind, size in s.top_rung_bytes.items()]
    lines = [
        *_head(s),
        "",
        *_groups(s),
        "",
        *_keys(s),
        "",
        "levels, without keys:",
        *_levels(s),
        "",
        "everything a viewer fetches (*: the ladder; the others are beaten by a mixture of two on it):",
        *_rungs(s.rungs),
        "",
        f"top rung, kB/frame: {', '.join(kinds)}",
        *(f"left out: {line}" for line in s.left_out),
        *(f"repaired: {line}" for line in s.repairs),
        *(f"decided: {line}" for line in s.decisions),
    ]
    return "\n".join(lines + ([f"attribution: {s.attribution}"] if s.attribution else []))


def format_ladder(s: Summary) -> str:
    """The rungs that players choose among, and what was repaired and decided, as fits a screen."""
    best = [rung for rung in s.rungs if rung.best]  # none where quality was not measured
    quality = "quality on pictures that no decision saw" if best else "quality was not measured"
    lines = [
        f"rungs that players choose among: everything a viewer fetches; {quality}",
        *_rungs(best or s.rungs, marked=False),
        *(f"repaired: {line}" for line in s.repairs),
        *(f"decided: {line}" for line in s.decisions),
    ]
    return "\n".join(lines)


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """A table without the columns after the first in which no row has anything."""
    used = [i for i in range(len(head)) if not i or any(row[i] not in NOTHING for row in rows)]
    return _report.table([head[i] for i in used], [[row[i] for i in used] for row in rows])


def _head(s: Summary) -> list[str]:
    v = s.views
    measured = f"quality against the {v.reference} over {v.measured} other pictures of each segment"
    measured += ", errors pooled for PSNR"
    return [
        f"{s.frames} frames at {s.fps:g} fps ({s.duration_s:.2f} s), SH degree {s.sh_degree}, "
        f"{s.package_bytes / 1e6:.3f} MB in all ({_kilobytes(s.package_bytes / s.frames)} kB/frame)",
        f"viewing region {s.region.words}",
        f"views of {s.region.views}",
        world_words(s.world),
        *([f"origin: positions are from ({', '.join(f'{value:.15g}' for value in s.origin)})"] if s.origin else []),
        *([f"sound: Opus, {s.sound.form}, {s.sound.mean_bps / 1e3:.0f} kbit/s"] if s.sound else []),
        *([f"background: {', '.join(f'{value:g}' for value in s.background)}"] if s.background else []),
        f"decided on {v.decided} pictures of each group; "
        + (measured if v.reference != "none" else "quality was not measured"),
    ]


def _groups(s: Summary) -> list[str]:
    rows = [
        [str(i), f"{g.frames[0]}-{g.frames[1] - 1}", *map(str, (g.gaussians, g.keeps or "", g.static, g.segments))]
        for i, g in enumerate(s.groups)
    ]
    if len(rows) > MOST_GROUPS:
        rows = [*rows[: MOST_GROUPS - 2], ["…"] * 6, rows[-1]]
    return table(["group", "frames", "Gaussians", "keeps", "static", "segments"], rows)


def _keys(s: Summary) -> list[str]:
    keys = [k for k in s.keys if k.gaussians[1]]  # others have no files
    rows = [[k.tier, k.quality, span(*k.gaussians), f"x{k.factor:g}", _kilobytes(k.bytes_per_frame)] for k in keys]
    return table(["key tier", "quality", "Gaussians", "steps", "kB/frame"], rows)


def _levels(s: Summary) -> list[str]:
    rows = [
        [
            v.id,
            span(*v.gaussians),
            f"{100 * v.pruned:g} %",
            f"x{v.factor:g}",
            _kilobytes(v.bytes_per_frame),
            *(f"{rate / 1e6:.2f}" for rate in (v.mean_bps, v.peak_bps)),
        ]
        for v in s.levels
    ]
    return table(["level", "Gaussians", "pruned", "steps", "kB/frame", "Mbit/s", "peak"], rows)


def _rungs(rungs: Sequence[RungSummary], marked: bool = True) -> list[str]:
    rows = [
        [f"{r.key} + {r.state}", _kilobytes(r.bytes_per_frame), f"{r.mean_bps / 1e6:.2f}", *_measured(r)]
        + ["*" * r.best] * marked
        for r in rungs
    ]
    return table(["rung", "kB/frame", "Mbit/s", *QUALITY_HEADS, *[""] * marked], rows)


def _kilobytes(size: float) -> str:
    return f"{size / 1e3:.2f}"


def _measured(rung: RungSummary) -> list[str]:
    values = ((rung.psnr, 2), (rung.worst, 1), (rung.ssim, 4), (rung.delta_e, 2))
    return [f"{value:.{digits}f}" if value is not None else "-" for value, digits in values]
