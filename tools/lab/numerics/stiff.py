"""Stiff and extreme cases: where the trainer, the codec and the selector converge, are bounded, or refuse.

Exit status 1 where the code as it is diverges or is not finite.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from airgs_codec.render import cpu
from tools.lab import Lab, Page, PagePicture, Section, Table, content, rows_of, setting
from tools.lab.numerics import fits, gradients, outcome, plans, steps
from tools.lab.numerics.outcome import BOUNDED, DIVERGES, EXACT, NOT_FINITE, REFUSED, UNFIT, Case, Cell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


CASES: tuple[Case, ...] = (*fits.cases(), *gradients.cases(), *steps.cases(), *plans.cases())
PARTS = tuple(dict.fromkeys(case.part for case in CASES))
COLUMNS = {"trainer": 4, "gradients": 3, "codec": 3, "selector": 2}  # panels in a row of a map
COLOURS = {
    EXACT: "#b7dfb9",
    BOUNDED: "#fff2a8",
    REFUSED: "#c9d7f0",
    UNFIT: "#e3c9a8",
    DIVERGES: "#f2a79b",
    NOT_FINITE: "#b06fb5",
}
HAPPENS = "what happens (experiments)"
HOW = (
    "Exact is a fit whose pictures are right to less than 8 bits show, a gradient within 1e-3 of float64, steps at the "
    "optimum, a plan within 0.01 dB of its relaxation, a session without waiting. A fit has 30 iterations, 6 to 12 "
    "Gaussians and two pictures of 32 x 32. What does not fit stays as it was."
)


@dataclass(frozen=True, slots=True)
class Line:
    """What a user may meet, in the cases of these names, and what to do; `{well}`: where fits do well."""

    meet: str
    names: tuple[str, ...]
    do: str


LINES = (
    Line(
        "Needles, coincident rows, quaternions of any length",
        ("train-needles", "train-coincident", "train-quaternions"), "nothing",
    ),
    Line(
        "Their gradients, and those far away or hardly opaque", tuple(case.name for case in gradients.cases()),
        "nothing",
    ),
    Line("Distance / extent of the scene", ("train-distance",), "stay at {well}"),
    Line("Motion a frame / size", ("train-motion",), "expect {well} of a size to be followed"),
    Line("The same at the price of changes", ("train-changes",), "give such frames more iterations"),
    Line("Opacity logits at the start", ("train-opacity",), "start at {well}"),
    Line("Steps that matter unequally", ("codec-closed-form", "codec-scenes"), "look for a scene that cameras see"),
    Line("Steps from tiny to huge", ("codec-steps",), "scale scenes to ordinary sizes"),
    Line("Rows that matter unequally, colours on a line", ("codec-classes", "codec-klt"), "nothing"),
    Line(
        "Links from 1e-30 to 1e30 bit/s", ("selector-programmes", "selector-margin", "selector-sessions"),
        "offer a rung that fits the slowest link",
    ),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    only: tuple[str, ...] = setting(PARTS, "parts", choices=PARTS)
    quick: bool = setting(False, "a third of the values")


def run(options: Options, lab: Lab) -> Page:
    torch.set_num_threads(1)
    cells: list[Cell] = []
    reads = {"quick": options.quick, "code": content(Path(__file__).parent)}
    with cpu.one_thread():
        for case in (case for case in CASES if case.part in options.only):
            cells += lab.results.once(case.name, reads, partial(case.run, options.quick))
            lab.tell(f"{case.name:<24} {outcome.count_ends(case.shipped(cells))}")
    return page(cells)


def page(cells: Sequence[Cell]) -> Page:
    tried = [case for case in CASES if case.shipped(cells)]
    own = [cell for case in tried for cell in case.shipped(cells)]
    pictures = []
    for part in dict.fromkeys(case.part for case in tried):
        maps = panels_of([case for case in tried if case.part == part], cells)
        columns = COLUMNS[part]
        tall = max(len({cell.row for cell in some}) for _, _, some in maps)
        size = 4.3 * columns, (1.5 + 0.24 * tall) * -(-len(maps) // columns) + 0.4
        caption = f"How experiments end: {part}"
        pictures.append(PagePicture(f"stiff-{part}", caption, partial(draw, maps, columns), size))
    wrong = [cell for cell in own if cell.end in outcome.FAULTS]
    words = ", ".join(f"{count} {plural(end)}" for end, count in outcome.count_ends(own).items())
    faults = f"{len(wrong)} diverge or are not finite" if wrong else "none diverges or is not finite"
    answer = f"Of {len(own)} experiments with the code as it is, {words}; {faults}. {HOW} Bold: the loss is halved."
    rows = [row for line in LINES if (row := row_of(line, tried, cells))]
    table = Table("stiff-lines", rows, {key: (key, "") for key in ("what you meet", HAPPENS, "what to do")})
    sections = [Section("", tables=[table]), Section(answer, "Where it ends how", pictures)]
    data = [Table("stiff", rows_of(cells))]
    return Page(sections, failed=bool(wrong), more={"faults": rows_of(wrong)}, data=data)


def row_of(line: Line, cases: Sequence[Case], cells: Sequence[Cell]) -> dict[str, str]:
    """Return a line of the page; {} where none of its cases was tried."""
    of = {case.name: case for case in cases if case.name in line.names}
    own = [cell for case in of.values() for cell in case.shipped(cells)]
    counts, words = outcome.count_ends(own), dict.fromkeys(outcome.ENDS, "")
    words[BOUNDED] = " by " + ", ".join(bounds_of(list(of.values()), cells))
    words[UNFIT] = ": " + ", ".join(dict.fromkeys(cell.note for cell in own if cell.end == UNFIT))
    words[REFUSED] = ": " + ", ".join(case.refused for case in of.values() if case.refused)
    happens = "; ".join(f"{end}{words[end]} ({count})" for end, count in counts.items())
    well = outcome.ranges(own, outcome.does_well)
    return {"what you meet": line.meet, HAPPENS: happens, "what to do": line.do.format(well=well)} if own else {}


def bounds_of(cases: Sequence[Case], cells: Sequence[Cell]) -> list[str]:
    """Return what bounds some cases, each with the least and the largest of its bounded figures."""
    found: dict[str, list[float]] = {}
    for case in cases:
        found.setdefault(case.why, []).extend(cell.value for cell in case.shipped(cells) if cell.end == BOUNDED)
    ends = {why: sorted({f"{end:.2g}": end for end in (min(v), max(v))}, key=float) for why, v in found.items() if v}
    return [why.format(span=" to ".join(span)) for why, span in ends.items()]


def plural(end: str) -> str:
    return {DIVERGES: "diverge", UNFIT: "do not fit"}.get(end, f"are {end}")


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
    used = [end for end in outcome.ENDS if any(cell.end == end for _, _, some in maps for cell in some)]
    handles = [Patch(facecolor=COLOURS[end], edgecolor="#888888", label=end) for end in used]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(used), fontsize=9, frameon=False)


def _draw_map(axis: Axes, case: Case, panel: str, cells: Sequence[Cell]) -> None:
    from matplotlib.colors import to_rgb

    xs, ys = sorted({cell.x for cell in cells}), list(dict.fromkeys(cell.row for cell in cells))
    picture = np.ones((len(ys), len(xs), 3))
    for cell in cells:
        at = ys.index(cell.row), xs.index(cell.x)
        picture[at] = to_rgb(COLOURS[cell.end])
        weight = "bold" if case.part == "trainer" and outcome.does_well(cell) else "normal"
        axis.text(at[1], at[0], _short(cell.value), ha="center", va="center", fontsize=6, weight=weight)
    axis.imshow(picture, aspect="auto", origin="lower", interpolation="nearest")
    axis.grid(visible=False)
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
