"""Figures of a package: its groups, keyframe tiers, levels and rungs, with bytes and quality; as tables and as a chart.

A rung is a keyframe quality together with a level. Lengths are in bytes, rates in bit/s. F frames of the sequence.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import BLUE, GREY, Form, Picture, Table
from airgs_codec.media.metrics import psnr
from airgs_codec.media.movie import LAYOUTS
from airgs_codec.package.layout import DELTA, KEYFRAME, Layout
from airgs_codec.package.manifest import Manifest, quality_of, rungs_of
from airgs_codec.package.region import RegionSummary, world_words
from airgs_codec.package.tables import Atlas, LeftOut, RungQuality

NOTHING = ("0", "0 %", "-", "", "…")  # cells of a column that this scene does not need
MOST_GROUPS = 12  # in the table of groups
NAMES = {"gaussians": "Gaussians", "updates": "rows are never updated"}  # of what an encoder leaves out
FEW = 4  # groups of which each has a line of its own, where something was left out
Row = dict[str, Any]
Columns = dict[str, tuple[str, Form]]


def span(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return str(low) if low == high else f"{low}-{high}"


def kilobytes(size: float) -> str:
    return f"{size / 1e3:.2f}"


BYTES: Columns = {"bytes_per_frame": ("kB/frame", kilobytes)}
RATE: Columns = {"mean_bps": ("Mbit/s", lambda rate: f"{rate / 1e6:.2f}")}
QUALITY: Columns = {
    "psnr": ("PSNR dB", ".2f"), "low": ("worst 5 %", ".1f"), "ssim": ("SSIM", ".4f"), "delta_e": ("ΔE", ".2f")
}  # fmt: skip
GAUSSIANS: Columns = {"gaussians": ("Gaussians", span)}
STEPS: Columns = {"factor": ("steps", "x{:g}".format)}
GROUPS: Columns = {
    "group": ("group", ""), "frames": ("frames", ""), "gaussians": ("Gaussians", "d"), "base": ("base", ""),
    "static": ("static", "d"), "segments": ("segments", ""),
}  # fmt: skip
KEYFRAMES: Columns = {"tier": ("keyframe tier", ""), "quality": ("quality", "")} | GAUSSIANS | STEPS | BYTES
PRUNED: Columns = {"pruned": ("pruned", lambda share: f"{100 * share:g} %")}
PEAK: Columns = {"peak_bps": ("peak", RATE["mean_bps"][1])}
LEVELS: Columns = {"id": ("level", "")} | GAUSSIANS | PRUNED | STEPS | BYTES | RATE | PEAK
RUNGS: Columns = {"rung": ("rung", "")} | BYTES | RATE | QUALITY


def summarise(m: Manifest, manifest_bytes: int) -> Row:
    """Return the figures of a package whose tables and manifest.mpd have `manifest_bytes` together, as plain values.

    Of a group: `frames` [start, stop), `gaussians` that are written, `static` ones of them that no level carries,
    `unused` ones that no view uses and are not written, and `base`, the earlier group, from 1, that its keyframe is a
    difference to. Of a keyframe tier in one quality and of a level: `gaussians`, the fewest and most of a group,
    `factor` of the quantiser steps, `pruned`, the share of moving rows. Of a rung, keyframe quality by keyframe
    quality: everything that its viewer fetches; quality over all pictures, None where it was not measured; whether
    players choose it (`on_ladder`).
    """
    sound = sum(group.sound.bytes for group in m.groups if group.sound)
    return {
        "frames": m.frames,
        "fps": float(m.fps),
        "duration_s": float(m.frames / m.fps),
        "sh_degree": m.sh_degree,
        "package_bytes": manifest_bytes + m.media_bytes(),
        "region": dataclasses.asdict(RegionSummary.of(m.region)),
        "world": m.world and dataclasses.asdict(m.world),
        "origin": list(m.origin or ()),
        "background": list(m.region.background or ()),
        "views": dataclasses.asdict(m.views),
        "groups": [
            {"frames": [g.start, g.stop], "gaussians": g.count, "static": g.static, "unused": g.unused}
            | {"segments": len(g.segments), "base": g.base}
            for g in m.groups
        ],
        "keyframes": [_keyframe(m, t, q) for t in range(m.tiers) for q in range(len(m.qualities))],
        "levels": [_level(m, j) for j in range(len(m.levels))],
        "rungs": rung_rows(m, manifest_bytes),
        "sound": m.sound and {"form": LAYOUTS[m.sound.channels], "mean_bps": _rate(m, sound)},
        "top_rung_bytes": bytes_by_kind(m, manifest_bytes),
        "left_out": describe_left_out(m),
        "repairs": [line for group in m.groups for line in group.repairs],
        "decisions": list(m.decisions),
        "attribution": m.attribution,
    }


def _rate(m: Manifest, size: float) -> float:
    return 8 * size * float(m.fps) / m.frames


def _keyframe(m: Manifest, tier: int, quality: int) -> Row:
    counts = [group.tiers[tier].count for group in m.groups]
    total = sum(m.bytes_of(m.keyframe_files(g, tier, quality)) for g in range(len(m.groups)))
    row = {"tier": f"T{tier}", "quality": m.qualities[quality].id, "factor": m.qualities[quality].factor}
    return row | {"gaussians": [min(counts), max(counts)], "bytes_per_frame": total / m.frames}


def _level(m: Manifest, index: int) -> Row:
    level = m.levels[index]
    rows = [group.levels[index].rows for group in m.groups]
    sizes = [m.bytes_of(m.delta_files(i, index)) for i in range(len(m.segments))]
    rates = [8 * size / float((s.stop - s.start) / m.fps) for size, s in zip(sizes, m.segments, strict=True)]
    row = {"id": level.id, "pruned": level.pruned, "factor": level.factor, "gaussians": [min(rows), max(rows)]}
    total = sum(sizes)
    return row | {"bytes_per_frame": total / m.frames, "mean_bps": _rate(m, total), "peak_bps": max(rates)}


def rung_rows(m: Manifest, manifest_bytes: int) -> list[Row]:
    rows = []
    for rung in rungs_of(m, manifest_bytes):
        quality = quality_of(m, m.level_index(rung.level), m.quality_index(rung.keyframe_quality))
        row: Row = {"keyframe": rung.keyframe_quality, "delta": rung.level, "bytes_per_frame": rung.bytes / m.frames}
        row |= {"mean_bps": 8 * row["bytes_per_frame"] * float(m.fps)}
        row |= dict.fromkeys(field.name for field in dataclasses.fields(RungQuality))
        rows.append(row | (dataclasses.asdict(quality) if quality else {}) | {"best": rung.best})
    return rows


def bytes_by_kind(m: Manifest, manifest_bytes: int) -> dict[str, int]:
    """Return the bytes that a viewer of the top rung fetches, by what they are.

    Delta pictures are H.264 alone; keyframe pictures count with the detail of positions, their escapes and boxes.
    """
    tiers = [tier for group in m.groups for tier in group.tiers[: m.levels[0].tiers]]
    deltas = [segment.levels[0] for segment in m.segments]
    pictures = sum(sum(delta.frame_bytes) for delta in deltas)
    return {
        "keyframe pictures": sum(tier.pictures[0].bytes for tier in tiers),
        "keyframe sidecars": sum(tier.sidecar.bytes for tier in tiers),
        "delta pictures": pictures,
        "escapes and boxes": sum(delta.file.bytes for delta in deltas) - pictures,
        **({"sound": sum(group.sound.bytes for group in m.groups if group.sound)} if m.sound else {}),
        "manifests": manifest_bytes,
    }


def describe_left_out(m: Manifest) -> list[str]:
    """Return a line for each thing that is not in the package; what concerns more than FEW groups alike is one line."""
    lines = [*_decisions(m), *_constant(m)]
    quiet = sum(not s.levels[0].file.bytes for s in m.segments)
    if quiet:
        lines.append(f"{quiet} delta segments: nothing moves in them by more than half a step")
    if m.sh_degree == 0:
        lines.append("SH rest: the scene has none")
    return lines


def _decisions(m: Manifest) -> Iterator[str]:
    entries: dict[str, list[tuple[int, LeftOut]]] = {}
    for number, group in enumerate(m.groups):
        for entry in group.left_out:
            entries.setdefault(entry.what, []).append((number, entry))
    for what, same in entries.items():
        for some in [same] if len(same) > FEW else [[one] for one in same]:
            error = max(entry.error for _, entry in some)
            worst = "at worst " if len(some) > 1 and error > 0 else ""
            alone = f"{worst}{psnr(error):.1f} dB by itself" if error > 0 else "no error"
            saved = float(np.mean([entry.bytes for _, entry in some]))
            count = span([entry.count for _, entry in some])
            where = f"group {some[0][0]}" if len(some) == 1 else f"{len(some)} groups"
            yield f"{where}: {count} {NAMES.get(what, what)}: {alone}, {kilobytes(saved)} kB/frame saved"


def _constant(m: Manifest) -> Iterator[str]:
    """Yield tiers without rows, and channels without a plane in the top rung."""
    groups: dict[str, list[int]] = {}
    for i, group in enumerate(m.groups):
        for t, tier in enumerate(group.tiers):
            if not tier.count:
                groups.setdefault(f"keyframe tier T{t}: it has no rows", []).append(i)
        keyframes = [(f"keyframe T{t} Q0", tier.qualities[0], KEYFRAME) for t, tier in enumerate(group.tiers)]
        for name, atlas, layout in (*keyframes, ("delta L0", group.levels[0], DELTA)):
            if text := _without_plane(atlas, layout):
                groups.setdefault(f"planes of {name}: {text} (constant within half a step)", []).append(i)
    for text, where in groups.items():
        yield from [f"{len(where)} groups: {text}"] if len(where) > FEW else [f"group {i}: {text}" for i in where]


def _without_plane(atlas: Atlas, layout: Layout) -> str:
    """Return how many channels of which attribute have no plane; empty when all have one."""
    missing = set(range(len(atlas.centres) if atlas.rows else 0)) - set(atlas.planes)
    counts = Counter(layout.names(1 + max(missing))[channel] for channel in sorted(missing))
    return ", ".join(f"{count} {attribute}" for attribute, count in counts.items())


def format_summary(m: Manifest, manifest_bytes: int) -> str:
    """Return all tables of a package, and what was left out and repaired."""
    s = summarise(m, manifest_bytes)
    kinds = [f"{kind} {kilobytes(size / m.frames)}" for kind, size in s["top_rung_bytes"].items()]
    groups = [
        g | {"group": i, "frames": f"{g['frames'][0]}-{g['frames'][1] - 1}", "base": g["base"] or ""}
        for i, g in enumerate(s["groups"])
    ]
    if len(groups) > MOST_GROUPS:
        groups = [*groups[: MOST_GROUPS - 2], dict.fromkeys(GROUPS, "…"), groups[-1]]
    lines = [
        *_head(m, s),
        "",
        _table(groups, GROUPS).to_text(),
        "",
        _table([one for one in s["keyframes"] if one["gaussians"][1]], KEYFRAMES).to_text(),  # others have no files
        "",
        "levels, without keyframes:",
        _table(s["levels"], LEVELS).to_text(),
        "",
        "everything a viewer fetches (*: the ladder; the others are beaten by a mixture of two on it):",
        rung_table(s["rungs"]).to_text(),
        "",
        f"top rung, kB/frame: {', '.join(kinds)}",
        *(f"left out: {line}" for line in s["left_out"]),
        *_notes(m),
        *([f"attribution: {m.attribution}"] if m.attribution else []),
    ]
    return "\n".join(lines)


def format_ladder(m: Manifest, manifest_bytes: int) -> str:
    """Return the rungs that players choose among, and what was repaired and decided, as fits a screen."""
    rungs = rung_rows(m, manifest_bytes)
    best = [rung for rung in rungs if rung["best"]]  # none where quality was not measured
    quality = "quality on pictures that no decision saw" if best else "quality was not measured"
    head = f"rungs that players choose among: everything a viewer fetches; {quality}"
    return "\n".join([head, rung_table(best or rungs, marked=False).to_text(), *_notes(m)])


def _notes(m: Manifest) -> list[str]:
    repairs = [f"repaired: {line}" for group in m.groups for line in group.repairs]
    return repairs + [f"decided: {line}" for line in m.decisions]


def _head(m: Manifest, s: Row) -> list[str]:
    views, region, background = m.views, RegionSummary.of(m.region), s["background"]
    measured = "quality was not measured"
    if m.rungs:
        error = max(rung.error for levels in m.rungs for rung in levels)
        measured = f"quality against the {views.reference} over up to {views.measured} other pictures"
        measured += f"; the standard error of no PSNR is above {error:.2f} dB"
    return [
        f"{m.frames} frames at {s['fps']:g} fps ({s['duration_s']:.2f} s), SH degree {m.sh_degree}, "
        f"{s['package_bytes'] / 1e6:.3f} MB in all ({kilobytes(s['package_bytes'] / m.frames)} kB/frame)",
        f"viewing region {region.words}",
        f"views of {region.views}",
        world_words(m.world),
        *([f"origin: positions are from ({', '.join(f'{value:.15g}' for value in m.origin)})"] if m.origin else []),
        *([f"sound: Opus, {s['sound']['form']}, {s['sound']['mean_bps'] / 1e3:.0f} kbit/s"] if m.sound else []),
        *([f"background: {', '.join(f'{value:g}' for value in background)}"] if background else []),
        f"decided on {views.decided} pictures of each group; {measured}",
    ]


def _table(rows: Sequence[Row], columns: Columns, name: str = "") -> Table:
    """Return a table without the columns after the first in which no row has anything."""
    cells = zip(*Table("", rows, columns).lines()[1:], strict=True)
    used = [any(cell not in NOTHING for cell in column) for column in cells]
    shown = {key: column for i, (key, column) in enumerate(columns.items()) if not i or used[i]}
    return Table(name, rows, shown)


def rung_table(rungs: Sequence[Row], marked: bool = True) -> Table:
    """Return rungs as a table, those that players choose marked."""
    rows = [rung | {"rung": f"{rung['keyframe']} + {rung['delta']}"} for rung in rungs]
    mark: Columns = {"best": ("", lambda best: "*" * best)}
    return _table(rows, RUNGS | (mark if marked else {}), "Rungs; *: what players choose among")


def plot_ladder(m: Manifest, manifest_bytes: int, path: Path) -> None:
    """Write a picture of quality over bytes and of bytes over time, in the format that the ending of `path` names.

    Raises ConfigError.
    """
    Picture(path.name, "", partial(_draw, m, manifest_bytes), (11, 4.2)).write(path)


def _draw(m: Manifest, manifest_bytes: int, figure: Any) -> None:
    rungs, time = figure.subplots(1, 2)
    plot_rungs(rung_rows(m, manifest_bytes), rungs)
    rungs.set_title("Rungs (grey: others show more)")
    _plot_bytes(time, m)


def plot_rungs(rungs: Sequence[Row], axes: Any) -> None:
    """Draw every rung that was measured by its bytes and PSNR: the ladder joined and named, others grey."""
    measured = sorted((r for r in rungs if r["psnr"] is not None), key=lambda r: (r["bytes_per_frame"], r["psnr"]))
    for best, form, colour in ((True, "o-", BLUE), (False, "o", GREY)):
        some = [
            (r["bytes_per_frame"] / 1e3, r["psnr"], f"{r['keyframe']}+{r['delta']}")
            for r in measured
            if r["best"] == best
        ]
        axes.plot([x for x, _, _ in some], [y for _, y, _ in some], form, color=colour, ms=4)
        for x, y, name in some if best else ():
            axes.annotate(name, (x, y), (-5, 4), textcoords="offset points", fontsize=8, color=BLUE, ha="right")
    axes.margins(0.18, 0.1)
    axes.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB")
    if not measured:
        axes.text(0.5, 0.5, "quality was not measured", ha="center", transform=axes.transAxes)


def _plot_bytes(axes: Any, m: Manifest) -> None:
    edges = np.arange(m.frames + 1) - 0.5
    for j, level in enumerate(m.levels):
        name = f"{level.id} ({100 * level.pruned:g} % pruned, x{level.factor:g})"
        axes.stairs(_picture_bytes(m, j) / 1e3, edges, label=name, linewidth=1.4, baseline=None)
    lengths = [group.stop - group.start for group in m.groups]
    keyframes = [sum(m.bytes_of(m.keyframe_files(g, t, 0)) for t in range(m.tiers)) for g in range(len(lengths))]
    name = f"keyframes in {m.qualities[0].id}, spread over their group"
    spread = np.repeat(np.array(keyframes) / lengths / 1e3, lengths)
    axes.stairs(spread, edges, fill=True, color="0.88", label=name, zorder=0)
    for group in m.groups[1:]:
        axes.axvline(group.start - 0.5, color="0.6", linestyle=":", linewidth=1)
    axes.set(xlabel="frame (dotted: a new group)", ylabel="kB", title="Bytes over time: delta pictures and keyframes")
    axes.set_ylim(0, 1.3 * axes.get_ylim()[1])  # room for the legend
    axes.locator_params(axis="x", integer=True)
    axes.legend(loc="upper center", ncols=2)
    axes.set_axisbelow(True)


def _picture_bytes(m: Manifest, level: int) -> NDArray[np.float64]:
    """Return the H.264 bytes of each frame of a level, (F,); 0 where a segment has no files."""
    sizes = np.zeros(m.frames)
    for segment in m.segments:
        if pictures := segment.levels[level].frame_bytes:
            sizes[segment.start : segment.stop] = pictures
    return sizes
