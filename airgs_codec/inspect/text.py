"""The figures of a package as tables of text."""

from __future__ import annotations

from airgs_codec._report import table
from airgs_codec.inspect.left_out import span
from airgs_codec.inspect.summary import LevelSummary, RungSummary, Summary
from airgs_codec.package.layout import STATE
from airgs_codec.package.world import world_words

MOST_GROUPS = 12  # in the table of groups
ERROR_HEADS = {
    "means": "means, units",
    "log_scales": "ln scale",
    "quaternions": "rotation, rad",
    "opacity": "opacity",
    "colour": "colour, steps",
}
QUALITY_HEADS = ["PSNR dB", "worst", "SSIM", "ΔE"]


def format_summary(s: Summary) -> str:
    """All tables, and what was left out and repaired."""
    kinds = [f"{kind} {_kilobytes(size / s.frames)}" for kind, size in s.top_rung_bytes.items()]
    lines = [
        *_head(s),
        "",
        *_groups(s),
        "",
        *([*_tiles(s), ""] if len(s.tiles) > 1 else []),
        *_keys(s),
        "",
        "levels, without keys; PSNR, that of the worst picture, SSIM and ΔE (mean CIEDE2000) with every key in Q0:",
        *_levels(s),
        "",
        "largest error of what a level carries (max_error), in the units of its channels:",
        *_errors(s),
        "",
        "everything a viewer fetches (*: the ladder; the others are beaten by a mixture of two on it):",
        *_rungs(s),
        "",
        f"top rung, kB/frame: {', '.join(kinds)}",
        *(f"left out: {line}" for line in s.left_out),
        *(f"repaired: {line}" for line in s.repairs),
        *(f"decided: {line}" for line in s.decisions),
    ]
    return "\n".join(lines + ([f"attribution: {s.attribution}"] if s.attribution else []))


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
        *([f"background: {', '.join(f'{value:g}' for value in s.background)}"] if s.background else []),
        f"decided on {v.decided} pictures of each group; "
        + (measured if v.reference != "none" else "quality was not measured"),
    ]


def _groups(s: Summary) -> list[str]:
    rows = [
        [str(i), f"{g.frames[0]}-{g.frames[1] - 1}", str(g.gaussians), str(g.kept), str(g.static), str(g.segments)]
        for i, g in enumerate(s.groups)
    ]
    if len(rows) > MOST_GROUPS:
        rows = [*rows[: MOST_GROUPS - 2], ["…"] * 6, rows[-1]]
    return table(["group", "frames", "Gaussians", "kept", "static", "segments"], rows)


def _tiles(s: Summary) -> list[str]:
    rows = [[tile.id, span(*tile.gaussians), _kilobytes(tile.bytes_per_frame)] for tile in s.tiles]
    return table(["tile", "Gaussians", "kB/frame of the top rung"], rows)


def _keys(s: Summary) -> list[str]:
    rows = [[k.tier, k.quality, span(*k.gaussians), f"x{k.factor:g}", _kilobytes(k.bytes_per_frame)] for k in s.keys]
    return table(["key tier", "quality", "Gaussians", "steps", "kB/frame"], rows)


def _levels(s: Summary) -> list[str]:
    rows = [
        [
            v.id,
            span(*v.gaussians),
            f"{100 * v.pruned:g} %",
            f"x{v.factor:g}",
            _kilobytes(v.bytes_per_frame),
            _megabits(v.mean_bps),
            _megabits(v.peak_bps),
            *_quality(v),
        ]
        for v in s.levels
    ]
    head = ["level", "Gaussians", "pruned", "steps", "kB/frame", "Mbit/s", "peak"]
    return table(head + QUALITY_HEADS, rows)


def _errors(s: Summary) -> list[str]:
    rows = [[v.id, *(f"{v.max_error[name]:.3g}" for name in STATE.attributes)] for v in s.levels]
    return table(["level", *(ERROR_HEADS[name] for name in STATE.attributes)], rows)


def _rungs(s: Summary) -> list[str]:
    rows = [
        [
            f"{r.key} + {r.state}",
            _kilobytes(r.bytes_per_frame),
            _megabits(r.mean_bps),
            *_quality(r),
            "*" if r.best else "",
        ]
        for r in s.rungs
    ]
    return table(["rung", "kB/frame", "Mbit/s", *QUALITY_HEADS, ""], rows)


def _quality(entry: LevelSummary | RungSummary) -> list[str]:
    values = ((entry.psnr, 2), (entry.worst, 2), (entry.ssim, 4), (entry.delta_e, 2))
    return [f"{value:.{digits}f}" if value is not None else "-" for value, digits in values]


def _kilobytes(size: float) -> str:
    return f"{size / 1e3:.2f}"


def _megabits(rate: float) -> str:
    return f"{rate / 1e6:.2f}"
