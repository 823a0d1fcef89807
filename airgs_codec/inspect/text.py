"""The figures of a package as tables of text, and which attributes its bytes go to: an estimate by entropy.

P planes of an atlas, N rows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec import _report
from airgs_codec.coding.atlas import extract
from airgs_codec.decoder.states import expect_size
from airgs_codec.inspect.summary import LevelSummary, RungSummary, Summary, span
from airgs_codec.media.h264 import open_segment
from airgs_codec.package.layout import STATE, Layout, key_layout
from airgs_codec.package.package import Package
from airgs_codec.package.region import world_words
from airgs_codec.package.tables import Atlas

NOTHING = ("0", "0 %", "-", "", "…")  # cells of a column that this scene does not need
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
        *_keys(s),
        "",
        "levels, without keys; PSNR, that of the worst picture, SSIM and ΔE (mean CIEDE2000) with every key in Q0:",
        *_levels(s),
        "",
        *_errors(s),
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
            *_quality(v),
        ]
        for v in s.levels
    ]
    head = ["level", "Gaussians", "pruned", "steps", "kB/frame", "Mbit/s", "peak"]
    return table(head + QUALITY_HEADS, rows)


def _errors(s: Summary) -> list[str]:
    """The table under its heading; nothing where no level carries anything."""
    if not any(error for v in s.levels for error in v.max_error.values()):
        return []
    rows = [[v.id, *(f"{v.max_error[name]:.3g}" for name in STATE.attributes)] for v in s.levels]
    words = "largest error of what a level carries (max_error), in the units of its channels:"
    return [words, *table(["level", *(ERROR_HEADS[name] for name in STATE.attributes)], rows), ""]


def _rungs(rungs: Sequence[RungSummary], marked: bool = True) -> list[str]:
    rows = [
        [f"{r.key} + {r.state}", _kilobytes(r.bytes_per_frame), f"{r.mean_bps / 1e6:.2f}", *_quality(r)]
        + ["*" * r.best] * marked
        for r in rungs
    ]
    return table(["rung", "kB/frame", "Mbit/s", *QUALITY_HEADS, *[""] * marked], rows)


def _quality(entry: LevelSummary | RungSummary) -> list[str]:
    values = ((entry.psnr, 2), (entry.worst, 1), (entry.ssim, 4), (entry.delta_e, 2))
    return [f"{value:.{digits}f}" if value is not None else "-" for value, digits in values]


def _kilobytes(size: float) -> str:
    return f"{size / 1e3:.2f}"


def bytes_by_attribute(package: Package) -> dict[str, float]:
    """Bytes of the top rung (all key tiers in Q0, and L0) by attribute, the largest first.

    H.264 codes an atlas as a whole, so its bytes are shared out by zero-order entropy: of the samples in key pictures,
    of their change from picture to picture in state segments. Key sidecars are canonical means, and so are the 3 bits a
    row that Q0 adds for every power of 2 by which its cells are finer than the coarsest. Raises FormatError.
    """
    out = dict.fromkeys(STATE.attributes, 0.0)
    for attribute, size in (*_of_keys(package), *_of_states(package)):
        out[attribute] += size
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def format_attributes(package: Package) -> str:
    """`bytes_by_attribute` as one line."""
    frames = package.manifest.frames
    parts = [f"{name} {size / frames / 1e3:.2f}" for name, size in bytes_by_attribute(package).items()]
    return f"top rung by attribute, kB/frame, shared out by entropy: {', '.join(parts)}"


def _of_keys(package: Package) -> Iterator[tuple[str, float]]:
    m = package.manifest
    for g, group in enumerate(m.groups):
        for t, tier in enumerate(group.tiers):
            yield "means", tier.sidecar.bytes
            for media in m.key_files(g, t, 0)[1:]:
                detail = 0 if group.keeps else 3 * m.qualities[-1].coarser * tier.count / 8
                fine = min(detail, tier.pictures[0].bytes)
                yield "means", fine
                samples = _samples(package, media, tier.qualities[0])
                yield from _shares(tier.pictures[0].bytes - fine, tier.qualities[0], samples, key_layout(group))


def _of_states(package: Package) -> Iterator[tuple[str, float]]:
    m = package.manifest
    for s, segment in enumerate(m.segments):
        atlas, level = m.groups[m.group_of(s)].levels[0], segment.levels[0]
        for media in m.state_files(s, 0):
            samples = _samples(package, media, atlas, bool(level.line))
            yield from _shares(sum(level.frame_bytes), atlas, samples, STATE)


def _samples(package: Package, media: str, atlas: Atlas, lined: bool = False) -> Iterator[NDArray[np.int16]]:
    """(P, N) of each picture; `lined`: the first is one of slopes."""
    _, pictures = open_segment(package.read(media), media, atlas.pages)
    for picture in itertools.chain(*pictures.cut()) if lined else pictures:
        expect_size(picture, atlas, media)
        yield extract(picture, atlas).astype(np.int16)


def _shares(
    size: float, atlas: Atlas, samples: Iterator[NDArray[np.int16]], layout: Layout
) -> Iterator[tuple[str, float]]:
    """`size` bytes shared out among the planes of an atlas, by the entropy of their changes."""
    entropy = np.zeros(len(atlas.planes))
    previous = np.zeros((len(atlas.planes), atlas.rows), np.int16)
    for picture in samples:
        for p, change in enumerate(picture - previous):
            counts = np.bincount(change + 255)  # changes of 8-bit samples
            shares = counts[counts > 0] / atlas.rows
            entropy[p] -= float((shares * np.log2(shares)).sum())
        previous = picture
    total = entropy.sum()
    for plane, part in zip(atlas.planes, entropy, strict=True):
        yield layout.attribute_of(plane), size * float(part / total if total > 0 else 1 / len(entropy))
