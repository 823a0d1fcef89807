"""Maps of sweeps: a field for each cell, coloured by its end, with the number that was measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from airgs_codec._report import new_figure, save_figure
from tools.stiffness.outcome import BOUNDED, CONVERGES, DIVERGES, ENDS, NOT_FINITE, REFUSED, Cell, Sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    CONVERGES: "#b7dfb9",
    BOUNDED: "#fff2a8",
    REFUSED: "#c9d7f0",
    DIVERGES: "#f2a79b",
    NOT_FINITE: "#b06fb5",
}
DPI = 90


def draw_maps(sweeps: Sequence[Sweep], path: Path, columns: int) -> None:
    """All panels of some sweeps, sweep after sweep, `columns` in a row."""
    panels = [(sweep, panel) for sweep in sweeps for panel in _drawn(sweep)]
    rows = -(-len(panels) // columns)
    tall = max(len({cell.y for cell in sweep.cells}) for sweep in sweeps)
    figure = new_figure(4.3 * columns, (1.5 + 0.24 * tall) * rows + 0.4)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, (sweep, panel) in zip(axes, panels, strict=False):
        _draw_panel(axis, sweep, panel)
    for axis in axes[len(panels) :]:
        axis.axis("off")
    used = [end for end in ENDS if any(cell.end == end for sweep in sweeps for cell in sweep.cells)]
    from matplotlib.patches import Patch

    handles = [Patch(facecolor=COLOURS[end], edgecolor="#888888", label=end) for end in used]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(used), fontsize=9, frameon=False)
    save_figure(figure, path, DPI)


def _drawn(sweep: Sweep) -> list[str]:
    """The panels of more than one column, and all of a sweep that has no others."""
    columns = {panel: {cell.x for cell in sweep.cells if cell.panel == panel} for panel in _panels(sweep)}
    return [panel for panel, xs in columns.items() if len(xs) > 1] or list(columns)


def _panels(sweep: Sweep) -> list[str]:
    return list(dict.fromkeys(cell.panel for cell in sweep.cells))


def _draw_panel(axis: Axes, sweep: Sweep, panel: str) -> None:
    cells = [cell for cell in sweep.cells if cell.panel == panel]
    xs = sorted({cell.x for cell in cells})
    ys = list(dict.fromkeys(cell.y for cell in cells))
    picture = np.ones((len(ys), len(xs), 3))
    from matplotlib.colors import to_rgb

    for cell in cells:
        at = ys.index(cell.y), xs.index(cell.x)
        picture[at] = to_rgb(COLOURS[cell.end])
        axis.text(at[1], at[0], _short(cell), ha="center", va="center", fontsize=6)
    axis.imshow(picture, aspect="auto", origin="lower", interpolation="nearest")
    axis.set_xticks(range(len(xs)), [f"{x:.3g}" for x in xs], fontsize=6, rotation=45)
    axis.set_yticks(range(len(ys)), ys, fontsize=6)
    axis.set_xlabel(sweep.x_label, fontsize=7)
    axis.set_ylabel(sweep.y_label, fontsize=7)
    axis.set_title(f"{sweep.title}: {panel}\n{sweep.value_label}", fontsize=8)


def _short(cell: Cell) -> str:
    if not math.isfinite(cell.value):
        return ""
    if cell.value == 0 or 0.01 <= abs(cell.value) < 100:
        return f"{cell.value:.2g}"
    return f"{cell.value:.0e}".replace("e-0", "e-").replace("e+0", "e")
