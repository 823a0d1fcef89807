"""Figures of a package: its groups, keyframe tiers, levels and rungs, with bytes and quality; as tables and as a chart.

A rung is a keyframe quality together with a level. Lengths are in bytes, rates in bit/s. F frames of the sequence.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._report import BLUE, GREY, Form, PagePicture, Table
from airgs_codec.media.metrics import psnr
from airgs_codec.media.movie import LAYOUTS
from airgs_codec.package.layout import DELTA, JSON_NAME, KEYFRAME, POSTER_NAME
from airgs_codec.package.manifest import Manifest, quality_of, rungs_of
from airgs_codec.package.package import root_of
from airgs_codec.package.parse import pack_json
from airgs_codec.package.region import region_figures, region_words, world_words
from airgs_codec.package.tables import LeftOut, RungQuality
from airgs_codec.play.offers import Offers

UNUSED = ("0", "0 %", "-", "", "…")  # cells of a column that this scene does not need
MOST_GROUPS = 12  # in the table of groups
LEFT_OUT = {"gaussians": "Gaussians", "updates": "rows are never updated"}
WAITS = ((0, 50.0), (-1, 2.0))  # rungs, the top one and the lowest, with Mbit/s of links
Row = dict[str, Any]
Columns = dict[str, tuple[str, Form]]


def span(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return str(low) if low == high else f"{low}-{high}"


def kilobytes(size: float) -> str:
    return f"{size / 1e3:.2f}"


QUALITY: Columns = {
    "psnr": ("PSNR dB", ".2f"), "low": ("worst 5 %", ".1f"), "ssim": ("SSIM", ".4f"), "delta_e": ("ΔE", ".2f")
}  # fmt: skip
COLUMNS: Columns = QUALITY | {
    "group": ("group", ""), "frames": ("frames", ""), "base": ("base", ""), "static": ("static", "d"),
    "segments": ("segments", ""), "tier": ("keyframe tier", ""), "quality": ("quality", ""), "id": ("level", ""),
    "rung": ("rung", ""), "best": ("", lambda best: "*" * best), "gaussians": ("Gaussians", span),
    "factor": ("steps", "x{:g}".format), "pruned": ("pruned", lambda share: f"{100 * share:g} %"),
    "bytes_per_frame": ("kB/frame", kilobytes), "mean_bps": ("Mbit/s", lambda rate: f"{rate / 1e6:.2f}"),
    "peak_bps": ("peak", lambda rate: f"{rate / 1e6:.2f}"),
}  # fmt: skip
GROUP_COLUMNS = ("group", "frames", "gaussians", "base", "static", "segments")
KEYFRAME_COLUMNS = ("tier", "quality", "gaussians", "factor", "bytes_per_frame")
LEVEL_COLUMNS = ("id", "gaussians", "pruned", "factor", "bytes_per_frame", "mean_bps", "peak_bps")
RUNG_COLUMNS = ("rung", "bytes_per_frame", "mean_bps", *QUALITY)


def summarise(m: Manifest, manifest_bytes: int) -> Row:
    """Return the figures of a package whose tables and manifest.mpd have `manifest_bytes` together, as plain values.

    Of a group: `frames` [start, stop), `gaussians` that are written, `static` ones of them that no level carries,
    `unused` ones that no view uses and are not written, and `base`, the earlier group, from 1, that its keyframe is a
    difference to. Of a keyframe tier in one quality and of a level: `gaussians`, the fewest and most of a group,
    `factor` of the quantiser steps, `pruned`, the share of moving rows. Of a rung, keyframe quality by keyframe
    quality: everything that its viewer fetches; quality over all pictures, None where it was not measured; whether
    players choose it (`on_ladder`). `bits_per_gaussian`: of the top rung, for each written Gaussian of a frame.
    """
    sound = sum(group.sound.bytes for group in m.groups if group.sound)
    s: Row = {"frames": m.frames, "fps": float(m.fps), "duration_s": float(m.frames / m.fps), "sh_degree": m.sh_degree}
    s |= {"package_bytes": manifest_bytes + m.media_bytes(), "region": region_figures(m.region)}
    s |= {"world": m.world and dataclasses.asdict(m.world), "origin": list(m.origin or ())}
    s |= {"background": list(m.region.background or ()), "views": dataclasses.asdict(m.views)}
    s["groups"] = [
        {"frames": [g.start, g.stop], "gaussians": g.count, "static": g.static, "unused": g.unused}
        | {"segments": len(g.segments), "base": g.base}
        for g in m.groups
    ]
    s["keyframes"] = [_keyframe(m, t, q) for t in range(m.tiers) for q in range(len(m.qualities))]
    s |= {"levels": [_level(m, j) for j in range(len(m.levels))], "rungs": rung_rows(m, manifest_bytes)}
    s["sound"] = m.sound and {"form": LAYOUTS[m.sound.channels], "mean_bps": 8 * sound * s["fps"] / m.frames}
    s |= {"top_rung_bytes": bytes_by_kind(m, manifest_bytes), "left_out": describe_left_out(m)}
    drawn = sum(g.count * (g.stop - g.start) for g in m.groups)
    s["bits_per_gaussian"] = 8 * m.frames * s["rungs"][0]["bytes_per_frame"] / max(drawn, 1)
    s["waits"] = [_waits(m, rung, mbps) for rung, mbps in WAITS]
    s["repairs"] = [line for group in m.groups for line in group.repairs]
    return s | {"decisions": list(m.decisions), "attribution": m.attribution}


def _waits(m: Manifest, rung: int, mbps: float) -> Row:
    """Return seconds in which what a viewer needs passes a link, round trips aside: for the first picture, and at most
    for one of a segment of whose group nothing is there.
    """
    offers = Offers(m, root_bytes=len(pack_json(root_of(m))))
    sizes = [offers.wire_bytes(chain(*offers.sought(segment, rung))) for segment in range(offers.segments)]
    first = sizes[0] + offers.wire_bytes([JSON_NAME, *([POSTER_NAME] if m.poster else [])])
    name = offers.names[rung].replace("+", " + ")
    return {"rung": name, "mbps": mbps, "first_s": 8e-6 * first / mbps, "seek_s": 8e-6 * max(sizes) / mbps}


def _rate(m: Manifest, size: float) -> float | None:
    return None if m.still else 8 * size * float(m.fps) / m.frames


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
    peak = None if m.still else max(rates)
    return row | {"bytes_per_frame": total / m.frames, "mean_bps": _rate(m, total), "peak_bps": peak}


def rung_rows(m: Manifest, manifest_bytes: int) -> list[Row]:
    rows = []
    for rung in rungs_of(m, manifest_bytes):
        quality = quality_of(m, m.level_index(rung.level), m.quality_index(rung.keyframe_quality))
        row: Row = {"keyframe": rung.keyframe_quality, "delta": rung.level, "bytes_per_frame": rung.bytes / m.frames}
        row |= {"mean_bps": _rate(m, rung.bytes)}
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
    """Return a line for each thing that is not in the package, and in how many groups."""
    lines: list[str] = []
    entries: dict[str, list[LeftOut]] = {}
    for group in m.groups:
        for entry in group.left_out:
            entries.setdefault(entry.what, []).append(entry)
    for what, some in entries.items():
        error, saved = max(entry.error for entry in some), float(np.mean([entry.bytes for entry in some]))
        cost = f"{psnr(error):.1f} dB by itself, at worst" if error > 0 else "no error"
        count = f"{len(some)} groups: {span([entry.count for entry in some])}"
        lines.append(f"{count} {LEFT_OUT.get(what, what)}: {cost}, {kilobytes(saved)} kB/frame saved")
    missing: Counter[str] = Counter()  # channels of the top rung without a plane
    keyframes = [(tier.qualities[0], KEYFRAME) for group in m.groups for tier in group.tiers]
    for atlas, layout in [*keyframes, *((group.levels[0], DELTA) for group in m.groups)]:
        without = set(range(len(atlas.centres) if atlas.rows else 0)) - set(atlas.planes)
        names = layout.names(len(atlas.centres))
        missing.update(f"{layout.kind} planes of {names[channel]}" for channel in without)
    lines += [f"{count} {what}: constant within half a step" for what, count in missing.items()]
    if quiet := sum(not s.levels[0].file.bytes for s in m.segments):
        lines.append(f"{quiet} delta segments: nothing moves in them by more than half a step")
    if m.sh_degree == 0:
        lines.append("SH rest: the scene has none")
    return lines


def format_summary(m: Manifest, manifest_bytes: int) -> str:
    s = summarise(m, manifest_bytes)
    kinds = [f"{kind} {kilobytes(size / m.frames)}" for kind, size in s["top_rung_bytes"].items()]
    groups = []
    for i, g in enumerate(s["groups"]):
        shown = {"group": i, "frames": f"{g['frames'][0]}-{g['frames'][1] - 1}", "base": g["base"] or ""}
        groups.append(g | shown | {"gaussians": [g["gaussians"]]})
    if len(groups) > MOST_GROUPS:
        groups = [*groups[: MOST_GROUPS - 2], dict.fromkeys(GROUP_COLUMNS, "…"), groups[-1]]
    lines = [
        *_head(m, s),
        "",
        _table(groups, GROUP_COLUMNS).to_text(),
        "",
        _table([one for one in s["keyframes"] if one["gaussians"][1]], KEYFRAME_COLUMNS).to_text(),  # those with files
        "",
        "levels, without keyframes:",
        _table(s["levels"], LEVEL_COLUMNS).to_text(),
        "",
        "everything a viewer fetches (*: the ladder; the others are beaten by a mixture of two on it):",
        rung_table(s["rungs"]).to_text(),
        "",
        f"top rung, kB/frame: {', '.join(kinds)}; {s['bits_per_gaussian']:.2f} bits a Gaussian and frame",
        *(
            f"{w['rung']} at {w['mbps']:g} Mbit/s, round trips aside: first picture {w['first_s']:.2f} s, "
            f"that of a seek at most {w['seek_s']:.2f} s"
            for w in s["waits"]
        ),
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
    views, region, background = m.views, m.region, s["background"]
    measured = "quality was not measured"
    if m.rungs:
        error = max(rung.error for levels in m.rungs for rung in levels)
        measured = f"quality against the {views.reference} over up to {views.measured} other pictures"
        measured += f"; the standard error of no PSNR is above {error:.2f} dB"
    megabytes = f"SH degree {m.sh_degree}, {s['package_bytes'] / 1e6:.3f} MB in all"
    timed = f"{m.length} at {s['fps']:g} fps ({s['duration_s']:.2f} s), {megabytes}"
    return [
        f"{m.length}, {megabytes}" if m.still else f"{timed} ({kilobytes(s['package_bytes'] / m.frames)} kB/frame)",
        f"viewing region {region_words(region)}",
        f"views of {region.width}x{region.height} pixels, {region.fov_y:.3g}° high, "
        f"near plane at {region.near:g} units",
        world_words(m.world),
        *([f"origin: positions are from ({', '.join(f'{value:.15g}' for value in m.origin)})"] if m.origin else []),
        *([f"sound: Opus, {s['sound']['form']}, {s['sound']['mean_bps'] / 1e3:.0f} kbit/s"] if m.sound else []),
        *([f"background: {', '.join(f'{value:g}' for value in background)}"] if background else []),
        f"decided on {views.decided} pictures of each group; {measured}",
    ]


def _table(rows: Sequence[Row], keys: Sequence[str], name: str = "") -> Table:
    """Return a table of these keys of COLUMNS, without those after the first in which no row has anything."""
    cells = zip(*Table("", rows, {key: COLUMNS[key] for key in keys}).lines()[1:], strict=True)
    used = [any(cell not in UNUSED for cell in column) for column in cells]
    return Table(name, rows, {key: COLUMNS[key] for i, key in enumerate(keys) if not i or used[i]})


def rung_table(rungs: Sequence[Row], marked: bool = True) -> Table:
    rows = [rung | {"rung": f"{rung['keyframe']} + {rung['delta']}"} for rung in rungs]
    keyframes = (*RUNG_COLUMNS, "best") if marked else RUNG_COLUMNS
    return _table(rows, keyframes, "Rungs; *: what players choose among")


def plot_ladder(m: Manifest, manifest_bytes: int, path: Path) -> None:
    """Write a picture of quality over bytes and of bytes over time, in the format that the ending of `path` names.

    Raises ConfigError.
    """

    def draw(figure: Any) -> None:
        rungs, time = figure.subplots(1, 2)
        plot_rungs(rung_rows(m, manifest_bytes), rungs)
        rungs.set_title("Rungs (grey: others show more)")
        _plot_bytes(time, m)

    PagePicture(path.name, "", draw, (11, 4.2)).write(path)


def plot_rungs(rungs: Sequence[Row], axes: Any) -> None:
    """Draw every rung that was measured by its bytes and PSNR: the ladder joined and named, others grey."""
    measured = sorted((r for r in rungs if r["psnr"] is not None), key=lambda r: (r["bytes_per_frame"], r["psnr"]))
    for best, form, colour in ((True, "o-", BLUE), (False, "o", GREY)):
        some = [(r["bytes_per_frame"] / 1e3, r["psnr"]) for r in measured if r["best"] == best]
        axes.plot([x for x, _ in some], [y for _, y in some], form, color=colour, ms=4)
    for r in (r for r in measured if r["best"]):
        name, at = f"{r['keyframe']}+{r['delta']}", (r["bytes_per_frame"] / 1e3, r["psnr"])
        axes.annotate(name, at, (-5, 4), textcoords="offset points", fontsize=8, color=BLUE, ha="right")
    axes.margins(0.18, 0.1)
    axes.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB")
    if not measured:
        axes.text(0.5, 0.5, "quality was not measured", ha="center", transform=axes.transAxes)


def _plot_bytes(axes: Any, m: Manifest) -> None:
    edges = np.arange(m.frames + 1) - 0.5
    for j, level in enumerate(m.levels):
        name = f"{level.id} ({100 * level.pruned:g} % pruned, x{level.factor:g})"
        sizes = np.zeros(m.frames)  # H.264 bytes of each frame; 0 where a segment has no files
        for segment in m.segments:
            sizes[segment.start : segment.stop] = segment.levels[j].frame_bytes or 0
        axes.stairs(sizes / 1e3, edges, label=name, linewidth=1.4, baseline=None)
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
