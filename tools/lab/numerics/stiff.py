"""Stiff and extreme cases: where the trainer, the codec and the selector converge, are bounded, or refuse.

Exit status 1 where the code as it is diverges or is not finite.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from airgs_codec._settings import setting
from airgs_codec.render import cpu
from tools.lab.numerics import fits, gradients, plans, steps
from tools.lab.numerics.outcome import (
    BOUNDED,
    CONVERGES,
    DIVERGES,
    ENDS,
    FAULTS,
    NOT_FINITE,
    REFUSED,
    UNFIT,
    Case,
    Cell,
    count_ends,
    ranges,
)
from tools.lab.options import expect_names
from tools.lab.page import Page, Picture, Section, Table, rows_of
from tools.lab.results import content

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tools.lab.command import Lab

CASES: tuple[Case, ...] = (*fits.cases(), *gradients.cases(), *steps.cases(), *plans.cases())
PARTS = tuple(dict.fromkeys(case.part for case in CASES))
COLUMNS = {"trainer": 4, "gradients": 3, "codec": 3, "selector": 2}  # panels in a row of a map
COLOURS = {
    CONVERGES: "#b7dfb9",
    BOUNDED: "#fff2a8",
    REFUSED: "#c9d7f0",
    UNFIT: "#e3c9a8",
    DIVERGES: "#f2a79b",
    NOT_FINITE: "#b06fb5",
}
HOW = (
    "Where numbers are at their ends every experiment converges, is bounded by something named, or is refused in one "
    "line. A fit converges that halves its loss in 30 iterations (6 to 12 Gaussians, two pictures of 32 x 32); a "
    "gradient, within 1e-3 of float64; steps, at the optimum; a plan, within 0.01 dB of its relaxation; a session, "
    "without waiting. It does not fit where nothing moves though pictures show an error."
)


@dataclass(frozen=True, slots=True)
class Options:
    """What is tried."""

    only: tuple[str, ...] = setting(PARTS, f"some of {', '.join(PARTS)}")
    quick: bool = setting(False, "a third of the values")


def run(options: Options, lab: Lab) -> Page:
    """Try what is missing, then write all cells. Raises ConfigError."""
    expect_names("--only", options.only, PARTS)
    torch.set_num_threads(1)
    cells: list[Cell] = []
    reads = {"quick": options.quick, "code": content(Path(__file__).parent)}
    with cpu.one_thread():
        for case in (case for case in CASES if case.part in options.only):
            cells += lab.results.once(case.name, reads, partial(case.run, options.quick))
            lab.tell(f"{case.name:<24} {count_ends(case.shipped(cells))}")
    return page(cells)


def page(cells: Sequence[Cell]) -> Page:
    """Return what the cells say."""
    tried = [case for case in CASES if case.shipped(cells)]
    own = [cell for case in tried for cell in case.shipped(cells)]
    pictures = []
    for part in dict.fromkeys(case.part for case in tried):
        maps = panels_of([case for case in tried if case.part == part], cells)
        columns = COLUMNS[part]
        tall = max(len({cell.row for cell in some}) for _, _, some in maps)
        size = 4.3 * columns, (1.5 + 0.24 * tall) * -(-len(maps) // columns) + 0.4
        caption = f"How experiments end: {part}"
        pictures.append(Picture(f"stiff-{part}", caption, partial(draw, maps, columns), size, grid=False))
    counts = [dict.fromkeys(ENDS, 0) | count_ends(case.shipped(cells)) for case in tried]
    rows: list[dict[str, Any]] = [{"case": case.title, **ends} for case, ends in zip(tried, counts, strict=True)]
    used = [end for end in ENDS if any(row[end] for row in rows)]
    limited = [row for row in rows if any(row[end] for end in used if end != CONVERGES)]
    table = Table("stiff-ends", limited, {"case": ("case", "")} | {end: (end, "d") for end in used})
    whole = ", ".join(case.title for case, row in zip(tried, rows, strict=True) if row not in limited)
    wrong = [cell for cell in own if cell.end in FAULTS]
    words = ", ".join(f"{count} {plural(end)}" for end, count in count_ends(own).items())
    answer = f"Of {len(own)} experiments with the code as it is, {words}; {len(wrong) or 'none'} of them is a fault."
    advice = [line for case in tried if (line := advice_of(case, cells))]
    sections = [
        Section("\n".join(f"- {line}" for line in [*advice, f"Nothing to heed: {whole}."]), "What to do"),
        Section(f"{answer} {rejected(cells)}".strip(), "Where it ends how", pictures, [table]),
    ]
    return Page(
        sections, HOW, failed=bool(wrong), more={"faults": rows_of(wrong)}, data=[Table("stiff", rows_of(cells))]
    )


def advice_of(case: Case, cells: Sequence[Cell]) -> str:
    """Return where all is well and what limits it elsewhere; '' where all converges."""
    own = case.shipped(cells)
    if all(cell.end == CONVERGES for cell in own):
        return ""
    fine = ranges(own, CONVERGES) if case.label and len({cell.row for cell in own}) == 1 else ""
    where = f" ({case.label} {fine} is well)" if fine else ""
    return f"{case.title}{where}: {case.why}."


def rejected(cells: Sequence[Cell]) -> str:
    """Return how the ways to step that were rejected end beside the trainer's, over all its cases and factors."""
    parts = []
    for name in fits.METHODS:
        some = [cell for cell in cells if cell.panel == name]
        ends = count_ends(some)
        if some:
            faults = sum(ends.get(end, 0) for end in FAULTS)
            parts.append(f"{name}: {ends.get(CONVERGES, 0)} of {len(some)} fits converge, {faults} diverge")
    return f"Over all factors on learning rates: {'; '.join(parts)}." if parts else ""


def plural(end: str) -> str:
    """Return how several cells end."""
    known = {CONVERGES: "converge", DIVERGES: "diverge", UNFIT: "do not fit"}
    return known.get(end, end.replace("is ", "are ", 1))


def panels_of(cases: Sequence[Case], cells: Sequence[Cell]) -> list[tuple[Case, str, list[Cell]]]:
    """The maps of some cases: panels of more than one column, and all of a case that has no others."""
    found = []
    for case in cases:
        panels: dict[str, list[Cell]] = {}
        for cell in (cell for cell in cells if cell.case == case.name):
            panels.setdefault(cell.panel, []).append(cell)
        wide = {panel: some for panel, some in panels.items() if len({cell.x for cell in some}) > 1}
        found += [(case, panel, some) for panel, some in (wide or panels).items()]
    return found


def draw(maps: Sequence[tuple[Case, str, list[Cell]]], columns: int, figure: Figure) -> None:
    """All maps, `columns` in a row: a field for each cell, coloured by its end, with the number that was measured."""
    from matplotlib.patches import Patch

    axes = figure.subplots(-(-len(maps) // columns), columns, squeeze=False).ravel()
    for axis, one in zip(axes, maps, strict=False):
        _draw_map(axis, *one)
    for axis in axes[len(maps) :]:
        axis.axis("off")
    used = [end for end in ENDS if any(cell.end == end for _, _, some in maps for cell in some)]
    handles = [Patch(facecolor=COLOURS[end], edgecolor="#888888", label=end) for end in used]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(used), fontsize=9, frameon=False)


def _draw_map(axis: Axes, case: Case, panel: str, cells: Sequence[Cell]) -> None:
    from matplotlib.colors import to_rgb

    xs, ys = sorted({cell.x for cell in cells}), list(dict.fromkeys(cell.row for cell in cells))
    picture = np.ones((len(ys), len(xs), 3))
    for cell in cells:
        at = ys.index(cell.row), xs.index(cell.x)
        picture[at] = to_rgb(COLOURS[cell.end])
        axis.text(at[1], at[0], _short(cell.value), ha="center", va="center", fontsize=6)
    axis.imshow(picture, aspect="auto", origin="lower", interpolation="nearest")
    axis.set_xticks(range(len(xs)), [f"{x:.3g}" for x in xs], fontsize=6, rotation=45)
    axis.set_yticks(range(len(ys)), ys, fontsize=6)
    axis.set_xlabel(case.label, fontsize=7)
    axis.set_title(f"{case.title}: {panel}\n{case.value}", fontsize=8)


def _short(value: float) -> str:
    if not math.isfinite(value):
        return ""
    if value == 0 or 0.01 <= abs(value) < 100:
        return f"{value:.2g}"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")
