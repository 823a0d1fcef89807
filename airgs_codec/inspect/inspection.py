"""What is in a package: tables a person wants to read, the same as JSON, and a picture of the ladder."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, save_figure, table
from airgs_codec.coding.atlas import extract
from airgs_codec.media.h264 import decode_pictures
from airgs_codec.media.metrics import psnr
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.store import Package
from airgs_codec.package.tables import (
    STATE_ATTRIBUTES,
    Atlas,
    LeftOut,
    Manifest,
    Quality,
    key_init_path,
    pooled_quality,
    state_init_path,
)

FEW = 4  # groups that are listed one by one
MOST_GROUPS = 12  # in the table of groups
ERROR_HEADS = ("means, units", "ln scale", "rotation, rad", "opacity", "colour, steps")


def segment_bits(m: Manifest, level: int) -> NDArray[np.float64]:
    """(S,) bit/s of each segment of a level: media and sidecar over its duration."""
    return np.array(
        [8 * m.bytes_of(m.state_files(i, level)) / float((s.stop - s.start) / m.fps) for i, s in enumerate(m.segments)]
    )


def summarise(m: Manifest, manifest_bytes: int) -> dict[str, Any]:
    """The figures of `format_summary`, as plain JSON values. Lengths in bytes, rates in bit/s."""
    duration = float(m.frames / m.fps)
    levels = []
    for j, level in enumerate(m.levels):
        rates = segment_bits(m, j)
        measured = pooled_quality(m, j, 0)
        rows = [group.levels[j].rows for group in m.groups]
        total = sum(m.bytes_of(m.state_files(i, j)) for i in range(len(m.segments)))
        levels.append(
            {
                "id": level.id,
                "pruned": level.pruned,
                "factor": level.factor,
                "gaussians": [min(rows), max(rows)],
                "bytes_per_frame": total / m.frames,
                "mean_bps": 8 * total / duration,
                "peak_bps": float(rates.max()),
                **_quality_entry(measured),
                "max_error": {
                    name: max(group.levels[j].max_error[k] for group in m.groups)
                    for k, name in enumerate(STATE.attributes)
                },
            }
        )
    keys = []
    for t in range(m.tier_count):
        counts = [group.tiers[t].count for group in m.groups]
        for q, quality in enumerate(m.qualities):
            total = sum(m.bytes_of(m.key_files(g, t, q)) for g in range(len(m.groups)))
            entry = {"tier": f"T{t}", "quality": quality.id, "factor": quality.factor}
            keys.append(entry | {"gaussians": [min(counts), max(counts)], "bytes_per_frame": total / m.frames})
    return {
        "frames": m.frames,
        "fps": float(m.fps),
        "duration_s": duration,
        "sh_degree": m.sh_degree,
        "package_bytes": manifest_bytes + sum(f.bytes for f in m.files.values()),
        "views": {"source": m.views.source, "usage": m.views.usage, "measured": m.views.measured},
        "groups": [_group_entry(m, g) for g in range(len(m.groups))],
        "keys": keys,
        "levels": levels,
        "rungs": rungs(m, manifest_bytes),
        "top_rung_bytes": bytes_by_kind(m, 0, 0, manifest_bytes),
        "left_out": left_out(m),
        "repairs": m.repairs,
        "attribution": m.attribution,
    }


def _group_entry(m: Manifest, index: int) -> dict[str, Any]:
    g = m.groups[index]
    segments = sum(s.group == index for s in m.segments)
    entry = {"frames": [g.start, g.stop], "canonical": g.canonical, "gaussians": g.count, "static": g.static}
    return entry | {"unused": g.unused, "segments": segments, "grid_bits": g.grid.bits}


def rungs(m: Manifest, manifest_bytes: int) -> list[dict[str, Any]]:
    """Every key quality with every level; `best` marks the ladder: the lower convex hull of error over bytes.

    A rung above it, such as the finest keys with the coarsest states, is beaten by some mixture of two on it.
    """
    entries = [_rung(m, q, j, manifest_bytes) for q in range(len(m.qualities)) for j in range(len(m.levels))]
    hull: list[dict[str, Any]] = []
    measured = [entry for entry in entries if entry["psnr"] is not None]
    for entry in sorted(measured, key=lambda e: (e["bytes_per_frame"], -e["psnr"])):
        if hull and entry["psnr"] <= hull[-1]["psnr"]:
            continue
        while len(hull) > 1 and _slope(hull[-2], hull[-1]) >= _slope(hull[-2], entry):
            hull.pop()
        hull.append(entry)
    return [entry | {"best": entry in hull} for entry in entries]


def _slope(a: dict[str, Any], b: dict[str, Any]) -> float:
    """Change of the mean squared error for each byte from one rung to a larger one."""
    errors = [10.0 ** (-entry["psnr"] / 10) for entry in (a, b)]
    return (errors[1] - errors[0]) / float(b["bytes_per_frame"] - a["bytes_per_frame"])


def _rung(m: Manifest, quality: int, level: int, manifest_bytes: int) -> dict[str, Any]:
    total = manifest_bytes + m.bytes_of(m.rung_files(quality, level))
    measured = pooled_quality(m, level, quality)
    entry: dict[str, Any] = {"key": m.qualities[quality].id, "state": m.levels[level].id}
    entry |= {"bytes_per_frame": total / m.frames, "mean_bps": 8 * total * float(m.fps) / m.frames}
    return entry | _quality_entry(measured)


def _quality_entry(measured: Quality | None) -> dict[str, Any]:
    return dataclasses.asdict(measured) if measured else {"psnr": None, "ssim": None, "delta_e": None}


def bytes_by_kind(m: Manifest, quality: int, level: int, manifest_bytes: int) -> dict[str, int]:
    """Bytes that a viewer of one rung fetches: pictures, sidecars, MP4 boxes and manifests.

    State pictures are H.264 alone and their MP4 boxes count as container; key pictures count with their boxes (about
    0.1 kB each), init segments as container.
    """
    kinds = ("key pictures", "key sidecars", "state pictures", "state sidecars", "container")
    out = dict.fromkeys(kinds, 0)
    for path in m.rung_files(quality, level):
        kind, size = path.split("/")[0], m.files[path].bytes
        if path.endswith("init.mp4"):
            out["container"] += size
        else:
            out[f"{kind} sidecars" if path.endswith(".bin") else f"{kind} pictures"] += size
    pure = sum(sum(s.levels[level].frame_bytes) for s in m.segments)
    out["container"] += out["state pictures"] - pure
    out["state pictures"] = pure
    out["manifests"] = manifest_bytes
    return out


def left_out(m: Manifest) -> list[str]:
    """What was not written and why, one line each; what concerns more than FEW groups alike in one."""
    lines: list[str] = []
    for what in dict.fromkeys(entry.what for entry in m.left_out):
        some = [entry for entry in m.left_out if entry.what == what]
        lines += [_words(some)] if len(some) > FEW else [_words([entry]) for entry in some]
    groups: dict[str, list[int]] = {}
    for i, group in enumerate(m.groups):
        for t, tier in enumerate(group.tiers):
            if not tier.number:
                groups.setdefault(f"key tier T{t}: it has no rows", []).append(i)
        for name, atlas, state in _top_atlases(m, i):
            missing = Counter(
                (STATE if state else KEY).attribute_of(c)
                for c in range(len(atlas.centres))
                if c not in set(atlas.planes)
            )
            if atlas.rows and missing:
                what = ", ".join(f"{count} {attribute}" for attribute, count in missing.items())
                groups.setdefault(f"planes of {name}: {what} (constant within half a step)", []).append(i)
    for text, where in groups.items():
        lines += [f"{len(where)} groups: {text}"] if len(where) > FEW else [f"group {i}: {text}" for i in where]
    quiet = sum(not s.levels[0].number for s in m.segments)
    if quiet:
        lines.append(f"{quiet} state segments: nothing moves in them by more than half a step")
    if m.sh_degree == 0:
        lines.append("SH rest: the scene has none")
    return lines


def _words(some: list[LeftOut]) -> str:
    """A line about one group, or about many: ranges, and the largest error."""
    names = {"gaussians": "Gaussians", "updates": "rows are never updated", "sh bands": "SH bands"}
    error = max(entry.error for entry in some)
    alone = f"{psnr(error):.1f} dB if nothing else were wrong" if error > 0 else "no error"
    saved = f"{np.mean([entry.bytes for entry in some]) / 1e3:.2f} kB/frame saved"
    count = _span([min(entry.count for entry in some), max(entry.count for entry in some)])
    where = f"group {some[0].group}" if len(some) == 1 else f"{len(some)} groups"
    worst = "at worst " if len(some) > 1 and error > 0 else ""
    return f"{where}: {count} {names.get(some[0].what, some[0].what)}: {worst}{alone}, {saved}"


def _top_atlases(m: Manifest, group: int) -> list[tuple[str, Atlas, bool]]:
    g = m.groups[group]
    keys = [(f"key T{t} Q0", tier.qualities[0], False) for t, tier in enumerate(g.tiers)]
    return [*keys, ("state L0", g.levels[0], True)]


def bytes_by_attribute(package: Package) -> dict[str, float]:
    """Bytes of the top rung (T* Q0 + L0) by attribute.

    H.264 codes an atlas as a whole, so its bytes are shared out by zero-order entropy: of the samples in key pictures,
    of their change from picture to picture in state segments. Key sidecars are canonical means. An estimate.
    """
    m = package.manifest
    out = dict.fromkeys(STATE_ATTRIBUTES[:4], 0.0) | {"colour": 0.0}
    for g, group in enumerate(m.groups):
        for t, tier in enumerate(group.tiers):
            if tier.number:
                sidecar, media, escapes = m.key_files(g, t, 0)
                out["means"] += m.files[sidecar].bytes
                pictures = list(decode_pictures(package.read(key_init_path(t, 0)), package.read(media), media))
                _share(out, m.bytes_of([media, escapes]), tier.qualities[0], [p.copy() for p in pictures], False)
    for s, segment in enumerate(m.segments):
        files = m.state_files(s, 0)
        if files:
            clip = decode_pictures(package.read(state_init_path(0)), package.read(files[0]), files[0])
            size = sum(segment.levels[0].frame_bytes)
            _share(out, size, m.groups[segment.group].levels[0], [p.copy() for p in clip], True)
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def _share(out: dict[str, float], size: int, atlas: Atlas, pictures: list[NDArray[np.uint8]], state: bool) -> None:
    if not atlas.planes:
        return
    entropy = np.zeros(len(atlas.planes))
    previous = np.zeros((len(atlas.planes), atlas.rows), np.int16)
    for picture in pictures:
        samples = extract(picture, atlas).astype(np.int16)
        for p, change in enumerate(samples - previous):
            counts = np.unique(change, return_counts=True)[1] / atlas.rows
            entropy[p] -= float((counts * np.log2(counts)).sum())
        previous = samples
    entropy = entropy / entropy.sum() if entropy.sum() > 0 else np.full(len(entropy), 1 / len(entropy))
    for plane, share in zip(atlas.planes, entropy, strict=True):
        out[(STATE if state else KEY).attribute_of(plane)] += size * float(share)


def format_summary(m: Manifest, manifest_bytes: int) -> str:
    """The tables as text."""
    s = summarise(m, manifest_bytes)
    frames = m.frames
    lines = [
        f"{frames} frames at {float(m.fps):g} fps ({s['duration_s']:.2f} s), SH degree {m.sh_degree}, "
        f"{s['package_bytes'] / 1e6:.3f} MB in all ({s['package_bytes'] / frames / 1e3:.2f} kB/frame)",
        f"usage over {m.views.usage} {m.views.source} views; quality against the {m.views.reference} "
        f"over {m.views.measured} views of {m.views.width}x{m.views.height}"
        if m.views.reference != "none"
        else f"usage over {m.views.usage} {m.views.source} views; quality was not measured",
        "",
    ]
    rows = [
        [str(i), f"{g['frames'][0]}-{g['frames'][1] - 1}", str(g["gaussians"]), str(g["static"]), str(g["segments"])]
        for i, g in enumerate(s["groups"])
    ]
    if len(rows) > MOST_GROUPS:
        rows = [*rows[: MOST_GROUPS - 2], ["…"] * 5, rows[-1]]
    lines += table(["group", "frames", "Gaussians", "static", "segments"], rows)
    rows = [
        [k["tier"], k["quality"], _span(k["gaussians"]), f"x{k['factor']:g}", f"{k['bytes_per_frame'] / 1e3:.2f}"]
        for k in s["keys"]
    ]
    lines += ["", *table(["key tier", "quality", "Gaussians", "steps", "kB/frame"], rows)]
    rows = [
        [
            v["id"],
            _span(v["gaussians"]),
            f"{100 * v['pruned']:g} %",
            f"x{v['factor']:g}",
            f"{v['bytes_per_frame'] / 1e3:.2f}",
            f"{v['mean_bps'] / 1e6:.2f}",
            f"{v['peak_bps'] / 1e6:.2f}",
            *_quality_cells(v),
        ]
        for v in s["levels"]
    ]
    lines += ["", "levels, without keys; PSNR, SSIM and ΔE (CIEDE2000) with every key in Q0:"]
    head = ["level", "Gaussians", "pruned", "steps", "kB/frame", "Mbit/s", "peak", "PSNR dB", "SSIM", "ΔE"]
    lines += table(head, rows)
    lines += ["", "largest error of what a level carries (max_error), in the units of its channels:"]
    rows = [[v["id"], *(f"{v['max_error'][name]:.3g}" for name in STATE.attributes)] for v in s["levels"]]
    lines += table(["level", *ERROR_HEADS], rows)
    rows = [
        [
            f"{r['key']} + {r['state']}",
            f"{r['bytes_per_frame'] / 1e3:.2f}",
            f"{r['mean_bps'] / 1e6:.2f}",
            *_quality_cells(r),
            "*" if r["best"] else "",
        ]
        for r in s["rungs"]
    ]
    lines += ["", "everything a viewer fetches (*: the ladder; the others are beaten by a mixture of two on it):"]
    lines += table(["rung", "kB/frame", "Mbit/s", "PSNR dB", "SSIM", "ΔE", ""], rows)
    kinds = [f"{kind} {size / frames / 1e3:.2f}" for kind, size in s["top_rung_bytes"].items()]
    lines += ["", f"top rung, kB/frame: {', '.join(kinds)}"]
    lines += [f"left out: {line}" for line in s["left_out"]] + [f"repaired: {line}" for line in m.repairs]
    return "\n".join(lines + ([f"attribution: {m.attribution}"] if m.attribution else []))


def format_attributes(package: Package) -> str:
    """The line of `bytes_by_attribute`."""
    frames = package.manifest.frames
    parts = [f"{name} {size / frames / 1e3:.2f}" for name, size in bytes_by_attribute(package).items()]
    return f"top rung by attribute, kB/frame, shared out by entropy: {', '.join(parts)}"


def _quality_cells(entry: dict[str, Any]) -> list[str]:
    return [
        f"{entry[name]:.{digits}f}" if entry[name] is not None else "-"
        for name, digits in (("psnr", 2), ("ssim", 4), ("delta_e", 2))
    ]


def _span(bounds: list[int]) -> str:
    return str(bounds[0]) if bounds[0] == bounds[1] else f"{bounds[0]}-{bounds[1]}"


def plot_ladder(m: Manifest, manifest_bytes: int, path: Path) -> None:
    """A picture: quality of every rung against its bytes, and bytes over time. Raises ConfigError."""
    figure = new_figure(11, 4.2)
    ladder, time = figure.subplots(1, 2)
    for q, quality in enumerate(m.qualities):
        rungs = [_rung(m, q, j, manifest_bytes) for j in range(len(m.levels))]
        measured = [r for r in rungs if r["psnr"] is not None]
        x, y = [r["bytes_per_frame"] / 1e3 for r in measured], [r["psnr"] for r in measured]
        (line,) = ladder.plot(x, y, "o-", label=f"key {quality.id} (steps x{quality.factor:g})")
        side = {"xytext": (6, -9)} if q % 2 == 0 else {"xytext": (-6, 4), "ha": "right"}  # curves cross
        for r, a, b in zip(measured, x, y, strict=True):
            ladder.annotate(r["state"], (a, b), textcoords="offset points", fontsize=8, color=line.get_color(), **side)
    ladder.margins(0.08)
    ladder.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB", title="Rungs")
    if m.views.reference == "none":
        ladder.text(0.5, 0.5, "quality was not measured", ha="center", transform=ladder.transAxes)
    else:
        ladder.legend()
    ladder.grid(alpha=0.3)
    edges = np.arange(m.frames + 1) - 0.5
    for j, level in enumerate(m.levels):
        sizes = np.zeros(m.frames)
        for segment in m.segments:
            if segment.levels[j].frame_bytes:
                sizes[segment.start : segment.stop] = segment.levels[j].frame_bytes
        name = f"{level.id} ({100 * level.pruned:g} % pruned, x{level.factor:g})"
        time.stairs(sizes / 1e3, edges, label=name, linewidth=1.4, baseline=None)
    keys = np.zeros(m.frames)
    for g, group in enumerate(m.groups):
        total = sum(m.bytes_of(m.key_files(g, t, 0)) for t in range(m.tier_count))
        keys[group.start : group.stop] = total / (group.stop - group.start)
    name = f"keys in {m.qualities[0].id}, spread over their group"
    time.stairs(keys / 1e3, edges, fill=True, color="0.88", label=name, zorder=0)
    for group in m.groups[1:]:
        time.axvline(group.start - 0.5, color="0.6", linestyle=":", linewidth=1)
    time.set(xlabel="frame (dotted: a new group)", ylabel="kB", title="Bytes over time: state pictures and keys")
    time.set_ylim(0, 1.3 * time.get_ylim()[1])  # room for the legend
    time.xaxis.get_major_locator().set_params(integer=True)
    time.legend(fontsize=8, ncols=2)
    time.set_axisbelow(True)
    time.grid(alpha=0.3)
    save_figure(figure, path, dpi=110)
