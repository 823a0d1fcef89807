"""One picture a section: a question above each of its axes, error over time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from airgs_codec._report import new_figure, plain_log_ticks, save_figure
from tools.precision.panels import Panel, Section
from tools.precision.rows import Row
from tools.precision.words import pick, scenes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH, HEIGHT, ACROSS = 7.2, 3.7, 2  # inches of a panel, and how many of them stand side by side
FEW_TICKS = 5


def picture_path(folder: Path, section: Section) -> Path:
    """Where the picture of a section is."""
    return folder / f"precision-{section.name}.png"


def plot(section: Section, rows: list[Row], path: Path) -> None:
    """Every panel of a section that has rows, those of several scenes side by side. Raises ConfigError."""
    parts = [part for panel in section.panels for part in split(panel, section.rows_of(panel, rows))]
    across = min(ACROSS, len(parts))
    down = -(-len(parts) // across)
    figure = new_figure(WIDTH * across, HEIGHT * down)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, (panel, title, some) in zip(axes, parts, strict=False):
        (draw_bars if panel.bars else draw_curves)(axis, panel, some)
        axis.set_title(title, fontsize=11, loc="left")
        axis.set_xlabel(panel.x)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[len(parts) :]:
        axis.set_axis_off()
    save_figure(figure, path, dpi=80)


def split(panel: Panel, rows: list[Row]) -> list[tuple[Panel, str, list[Row]]]:
    """A panel, its title and rows for every scene, or for all of them where each is a curve."""
    names = scenes(rows)
    if panel.bars or len(names) < 2 or all(row.curve == row.scene for row in rows):
        return [(panel, panel.question, rows)] if rows else []
    return [(panel, f"{panel.question} ({name})", pick(rows, scene=name)) for name in names]


def draw_curves(axis: Axes, panel: Panel, rows: list[Row]) -> None:
    """A curve with bars from quartile to quartile, its settings beside its points."""
    drawn = [row for row in rows if not math.isnan(row.error) and (row.error > 0 or not panel.log_error)]
    for curve in dict.fromkeys(row.curve for row in drawn):
        some = pick(drawn, curve=curve)
        x, y = [panel.scale * row.seconds for row in some], [row.error for row in some]
        left = [panel.scale * (row.seconds - row.seconds_low) for row in some]
        right = [panel.scale * (row.seconds_high - row.seconds) for row in some]
        below, above = [row.error - row.error_low for row in some], [row.error_high - row.error for row in some]
        bars = axis.errorbar(x, y, (below, above), (left, right), "o", markersize=4, elinewidth=0.7, label=curve)
        bars[0].set_linestyle("none" if curve in panel.loose else "-")
        for row, at in zip(some, zip(x, y, strict=True), strict=True):
            if panel.labels and row.setting != curve:
                axis.annotate(row.setting, at, (4, 4), textcoords="offset points", fontsize=7.5)
    axis.set_xscale("log")
    axis.margins(0.12)
    plain_log_ticks(axis.xaxis, FEW_TICKS)
    if panel.log_error:
        axis.set_yscale("log")
        plain_log_ticks(axis.yaxis, FEW_TICKS)
    axis.set_ylabel(panel.y)
    axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def draw_bars(axis: Axes, panel: Panel, rows: list[Row]) -> None:
    """A bar for each scene, stage after stage."""
    names = scenes(rows)
    left = dict.fromkeys(names, 0.0)
    for curve in dict.fromkeys(row.curve for row in rows):
        some = pick(rows, curve=curve)
        lengths = [panel.scale * row.seconds for row in some]
        axis.barh([row.scene for row in some], lengths, left=[left[row.scene] for row in some], height=0.5, label=curve)
        for row, length in zip(some, lengths, strict=True):
            left[row.scene] += length
    axis.set_ylim(len(names) - 0.2, -0.8)  # from the top down
    axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
