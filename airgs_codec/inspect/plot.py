"""A picture of a package: quality of its rungs over their bytes, and bytes over time.

F frames of the sequence.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import BLUE, GREY, new_figure, save_figure
from airgs_codec.inspect.summary import RungSummary, summarise
from airgs_codec.package.manifest import Manifest


def plot_ladder(m: Manifest, manifest_bytes: int, path: Path) -> None:
    """Write the picture in the format that the ending of `path` names. Raises ConfigError."""
    figure = new_figure(11, 4.2)
    rungs, time = figure.subplots(1, 2)
    plot_rungs(summarise(m, manifest_bytes).rungs, rungs)
    rungs.set_title("Rungs (grey: others show more)")
    _plot_bytes(time, m)
    save_figure(figure, path, dpi=110)


def plot_rungs(rungs: Sequence[RungSummary], axes: Any) -> None:
    """Every rung that was measured by its bytes and PSNR: those on the ladder are joined and named, others grey."""
    named = ((r.bytes_per_frame / 1e3, r.psnr, f"{r.key}+{r.state}", r.best) for r in rungs)
    measured = sorted((x, y, name, best) for x, y, name, best in named if y is not None)
    for best, form, colour in ((True, "o-", BLUE), (False, "o", GREY)):
        some = [(x, y) for x, y, _, on in measured if on == best]
        axes.plot([x for x, _ in some], [y for _, y in some], form, color=colour, ms=4)
    for x, y, name, best in measured:
        if best:
            axes.annotate(name, (x, y), (-5, 4), textcoords="offset points", fontsize=8, color=BLUE, ha="right")
    axes.margins(0.18, 0.1)
    axes.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB")
    if not measured:
        axes.text(0.5, 0.5, "quality was not measured", ha="center", transform=axes.transAxes)
    axes.grid(alpha=0.3)


def _plot_bytes(axes: Any, m: Manifest) -> None:
    edges = np.arange(m.frames + 1) - 0.5
    for j, level in enumerate(m.levels):
        name = f"{level.id} ({100 * level.pruned:g} % pruned, x{level.factor:g})"
        axes.stairs(_picture_bytes(m, j) / 1e3, edges, label=name, linewidth=1.4, baseline=None)
    name = f"keys in {m.qualities[0].id}, spread over their group"
    axes.stairs(_key_bytes(m) / 1e3, edges, fill=True, color="0.88", label=name, zorder=0)
    for group in m.groups[1:]:
        axes.axvline(group.start - 0.5, color="0.6", linestyle=":", linewidth=1)
    axes.set(xlabel="frame (dotted: a new group)", ylabel="kB", title="Bytes over time: state pictures and keys")
    axes.set_ylim(0, 1.3 * axes.get_ylim()[1])  # room for the legend
    axes.locator_params(axis="x", integer=True)
    axes.legend(loc="upper center", fontsize=8, ncols=2)
    axes.set_axisbelow(True)
    axes.grid(alpha=0.3)


def _picture_bytes(m: Manifest, level: int) -> NDArray[np.float64]:
    """(F,) H.264 bytes of each frame of a level; 0 where a segment has no files."""
    sizes = np.zeros(m.frames)
    for segment in m.segments:
        if pictures := segment.levels[level].frame_bytes:
            sizes[segment.start : segment.stop] = pictures
    return sizes


def _key_bytes(m: Manifest) -> NDArray[np.float64]:
    """(F,) bytes of the keys in Q0, spread over the frames of their group."""
    sizes = np.zeros(m.frames)
    for g, group in enumerate(m.groups):
        total = sum(m.bytes_of(m.key_files(g, t, 0)) for t in range(m.tiers))
        sizes[group.start : group.stop] = total / (group.stop - group.start)
    return sizes
