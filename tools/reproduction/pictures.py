"""The figures of a reproduction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec._report import new_figure, plain_log_ticks, save_figure
from tools.reproduction.ablations import Outcome
from tools.reproduction.training import Trained

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


def plot_quality(trained: Sequence[Trained], path: Path) -> None:
    """PSNR of every frame, a panel a scene."""
    figure, panels = _panels((t.scene for t in trained), 5.2)
    for scene, axis in panels.items():
        for t in (t for t in trained if t.scene == scene):
            axis.plot([f.psnr for f in t.frames], color=COLOURS.get(t.method), label=t.method)
            keys = [i for i, f in enumerate(t.frames) if f.kind == "key"]
            if len(keys) < len(t.frames):
                axis.plot(keys, [t.frames[i].psnr for i in keys], "o", markersize=4, color=COLOURS.get(t.method))
        axis.set(xlabel="frame", ylabel="PSNR at held-out cameras, dB")
        axis.grid(alpha=0.3)
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8)
    save_figure(figure, path)


def plot_sizes(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """PSNR over bytes a frame, a panel a scene."""
    figure, panels = _panels((row["scene"] for row in rows), 4.4)
    for scene, axis in panels.items():
        for row in (row for row in rows if row["scene"] == scene):
            axis.plot(row["kb_frame"], row["psnr"], "o", color=COLOURS.get(row["method"]))
            axis.annotate(row["method"], (row["kb_frame"], row["psnr"]), (4, 4), textcoords="offset points", fontsize=8)
        axis.set_xscale("log")
        axis.margins(0.2)
        plain_log_ticks(axis.xaxis)
        axis.set(xlabel="kB a frame", ylabel="PSNR at held-out cameras, dB")
        axis.grid(alpha=0.3)
    save_figure(figure, path)


def plot_times(streams: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Distributions of transmission times, a panel a scene."""
    figure, panels = _panels((row["scene"] for row in streams), 5.2)
    for scene, axis in panels.items():
        for row in (row for row in streams if row["scene"] == scene):
            style = "-" if row["chooser"] == "unpruned" else "--"
            name = f"{row['method']}, {row['chooser']}" if row["method"].startswith("airgs") else row["method"]
            times = row["percentiles_ms"]
            axis.plot(times, range(len(times)), style, color=COLOURS.get(row["method"]), label=name)
        axis.set_xscale("log")
        plain_log_ticks(axis.xaxis)
        axis.set(xlabel="transmission of a frame, ms", ylabel="share of frames sent, %")
        axis.grid(alpha=0.3)
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    save_figure(figure, path)


def plot_pruning(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """What pruning costs by each ranking, and what it saves in time; of the first scene."""
    scene = rows[0]["scene"]
    figure = new_figure(9.5, 3.8)
    quality, milliseconds = figure.subplots(1, 2)
    for ranking in dict.fromkeys(row["ranking"] for row in rows):
        some = [row for row in rows if row["ranking"] == ranking and row["scene"] == scene]
        shares = [100 * row["pruned"] for row in some]
        quality.plot(shares, [row["psnr"] for row in some], "o-", markersize=3, label=ranking)
        milliseconds.plot(shares, [row["ms"] for row in some], "o-", markersize=3, label=ranking)
    quality.set(title=f"{scene}: what pruning costs", xlabel="updates pruned, %", ylabel="PSNR to what was trained, dB")
    milliseconds.set(title="and saves", xlabel="updates pruned, %", ylabel="states over the mean link, ms a frame")
    for axis in (quality, milliseconds):
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    save_figure(figure, path)


def plot_ablations(outcomes: Sequence[Outcome], path: Path) -> None:
    """PSNR and bytes of every change, beside the trainer as it is."""
    figure = new_figure(10, 0.32 * len(outcomes) + 1)
    left, right = figure.subplots(1, 2, sharey=True)
    names = [o.name if o.question == "default" else f"{o.question}: {o.name}" for o in outcomes]
    for axis, values, label in (
        (left, [o.psnr for o in outcomes], "PSNR at held-out cameras, dB"),
        (right, [o.kb_frame for o in outcomes], "kB a frame"),
    ):
        colours = ["#d62728" if o.question == "default" else "#8fa8c8" for o in outcomes]
        axis.barh(names, values, color=colours)
        axis.axvline(values[0], color="#d62728", linewidth=0.8)
        axis.set_xlabel(label)
        known = [v for v in values if v == v]  # a run that failed has none
        if axis is left:
            axis.set_xlim(min(known) - 0.5, max(known) + 0.3)
    left.invert_yaxis()
    save_figure(figure, path)


def _panels(scenes: Iterable[str], width: float) -> tuple[Figure, dict[str, Axes]]:
    """A figure with a panel of `width` inches for each different scene, which is its title."""
    names = list(dict.fromkeys(scenes))
    figure = new_figure(width * len(names), 3.8)
    panels = dict(zip(names, figure.subplots(1, len(names), squeeze=False)[0], strict=True))
    for name, axis in panels.items():
        axis.set_title(name)
    return figure, panels
