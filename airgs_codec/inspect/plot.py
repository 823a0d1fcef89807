"""A picture of a package: quality of its rungs over their bytes, bytes over time, and its viewing region.

F frames of the sequence.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, save_figure
from airgs_codec.inspect.summary import summarise
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.region import levelled
from airgs_codec.play.report.map import draw_region


def plot_ladder(m: Manifest, manifest_bytes: int, path: Path) -> None:
    """Write the picture in the format that the ending of `path` names. Raises ConfigError."""
    figure = new_figure(15, 4.2)
    rungs, time, place = figure.subplots(1, 3, width_ratios=(3, 3, 2))
    _plot_rungs(rungs, m, manifest_bytes)
    _plot_bytes(time, m)
    draw_region(place, levelled(m.region, m.world))
    save_figure(figure, path, dpi=110)


def _plot_rungs(axes: Any, m: Manifest, manifest_bytes: int) -> None:
    """A curve for each key quality, and a small mark for the worst picture of each rung."""
    rungs = [rung for rung in summarise(m, manifest_bytes).rungs if rung.psnr is not None]
    for q, quality in enumerate(m.qualities):
        points = [(r.bytes_per_frame / 1e3, r.psnr or 0.0, r.state) for r in rungs if r.key == quality.id]
        x, y = [point[0] for point in points], [point[1] for point in points]
        (line,) = axes.plot(x, y, "o-", label=f"key {quality.id} (steps x{quality.factor:g})")
        worst = [r.worst for r in rungs if r.key == quality.id]
        axes.plot(x, worst, "v:", ms=4, lw=0.8, color=line.get_color(), label=f"{quality.id}, the worst picture")
        for a, b, state in points:  # on either side, since curves cross
            offset, align = ((6.0, -9.0), "left") if q % 2 == 0 else ((-6.0, 4.0), "right")
            axes.annotate(
                state, (a, b), offset, textcoords="offset points", fontsize=8, color=line.get_color(), ha=align
            )
    axes.margins(0.08)
    axes.set(xlabel="kB a frame, everything fetched", ylabel="PSNR of the pooled error, dB", title="Rungs")
    if rungs:
        axes.legend()
    else:
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
    axes.legend(fontsize=8, ncols=2)
    axes.set_axisbelow(True)
    axes.grid(alpha=0.3)


def _picture_bytes(m: Manifest, level: int) -> NDArray[np.float64]:
    """(F,) H.264 bytes of each frame of a level; 0 where a segment has no files."""
    sizes = np.zeros(m.frames)
    for segment in m.segments:
        if pictures := segment.levels[level].picture_bytes:
            sizes[segment.start : segment.stop] = pictures
    return sizes


def _key_bytes(m: Manifest) -> NDArray[np.float64]:
    """(F,) bytes of the keys in Q0, spread over the frames of their group."""
    sizes = np.zeros(m.frames)
    for g, group in enumerate(m.groups):
        total = sum(m.bytes_of(m.key_files(g, k, 0)) for k in range(m.units))
        sizes[group.start : group.stop] = total / (group.stop - group.start)
    return sizes
