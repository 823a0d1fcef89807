"""The pictures of a reproduction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tools.lab import plain_log_ticks
from tools.lab.paper.training import Trained

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {
    "airgs": "#d62728",
    "airgs-paper": "#ff9896",
    "v3": "#1f77b4",
    "3dgstream": "#2ca02c",
    "4dgs": "#9467bd",
    "naive3dgs": "#7f7f7f",
}
STYLES = {"unpruned": "-", "paper": "--", "paper-no-cliff": ":", "paper-literal": "-."}
BUBBLE = 20  # square points of a second
HELD_OUT = "PSNR at held-out cameras, dB"
Rows = Sequence[Mapping[str, Any]]


def draw_quality(trained: Sequence[Trained], figure: Figure) -> None:
    """PSNR of every frame, a panel a scene; dots are keyframes of methods that have other frames."""
    for scene, axis in _panels((t.scene for t in trained), figure).items():
        for t in (t for t in trained if t.scene == scene):
            axis.plot([f.psnr for f in t.frames], color=COLOURS.get(t.method), label=t.method)
            keyframes = [i for i, f in enumerate(t.frames) if f.kind == "keyframe"]
            if len(keyframes) < len(t.frames):
                axis.plot(
                    keyframes, [t.frames[i].psnr for i in keyframes], "o", markersize=4, color=COLOURS.get(t.method)
                )
        axis.set(xlabel="frame", ylabel=HELD_OUT)
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8)


def draw_sizes(rows: Rows, figure: Figure) -> None:
    """PSNR over bytes a frame, a panel a scene; the area of a point is the time of training a frame."""
    for scene, axis in _panels((row["scene"] for row in rows), figure).items():
        for row in (row for row in rows if row["scene"] == scene):
            area = BUBBLE * row["train_s_frame"]
            axis.scatter(row["kb_frame"], row["psnr"], area, color=COLOURS.get(row["method"]), alpha=0.6)
            axis.annotate(row["method"], (row["kb_frame"], row["psnr"]), (4, 4), textcoords="offset points", fontsize=8)
        axis.set_xscale("log")
        axis.margins(0.2)
        plain_log_ticks(axis.xaxis)
        axis.set(xlabel="kB a frame", ylabel=HELD_OUT)


def draw_side_by_side(sheet: Mapping[str, Mapping[str, Any]], figure: Figure) -> None:
    """Pictures (H, W, 3) by scene and by whose they are, all of a scene of one view and frame."""
    across = max(map(len, sheet.values()))
    grid = figure.subplots(len(sheet), across, squeeze=False)
    for row, (scene, shown) in zip(grid, sheet.items(), strict=True):
        for axis, (name, picture) in zip(row, shown.items(), strict=False):
            axis.imshow(picture)
            axis.set_title(f"{scene}: {name}", fontsize=8)
        for axis in row:
            axis.set_axis_off()


def draw_times(rows: Rows, figure: Figure) -> None:
    """Distributions of transmission times over all frames, a panel a scene; a frame that is skipped never comes."""
    for scene, axis in _panels((row["scene"] for row in rows), figure).items():
        for row in (row for row in rows if row["scene"] == scene):
            alone = row["chooser"] == "unpruned" and not row["method"].startswith("airgs")
            name = row["method"] if alone else f"{row['method']}, {row['chooser']}"
            times, style = row["percentiles_ms"], STYLES[row["chooser"]]
            axis.plot(times, range(len(times)), style, color=COLOURS.get(row["method"]), label=name)
        axis.set_xscale("log")
        plain_log_ticks(axis.xaxis)
        axis.set_xticks([1, 100, 10_000])
        axis.set(xlabel="transmission of a frame, ms", ylabel="share of frames, %")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)


def _panels(scenes: Iterable[str], figure: Figure) -> dict[str, Axes]:
    names = list(dict.fromkeys(scenes))
    panels = dict(zip(names, figure.subplots(1, len(names), squeeze=False)[0], strict=True))
    for name, axis in panels.items():
        axis.set_title(name)
    return panels
