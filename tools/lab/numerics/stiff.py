"""Stiff and extreme cases: where the trainer, the codec and the selector converge, are bounded, or refuse.

Exit status 1 where the code as it is diverges or is not finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from airgs_codec.render import cpu
from tools.lab import Lab, Page, PagePicture, Row, Section, Table, content, rows_of, setting
from tools.lab.numerics import fits, gradients, plans, steps
from tools.lab.numerics.outcome import ENDS, FAULTS, UNFIT, Case, Cell, count_ends

if TYPE_CHECKING:
    from matplotlib.figure import Figure


CASES: tuple[Case, ...] = (*fits.cases(), *gradients.cases(), *steps.cases(), *plans.cases())
PARTS = tuple(dict.fromkeys(case.part for case in CASES))
RATES = {f"{factor:g}": f"x{factor:g}" for factor in fits.FACTORS}  # rows of maps, and columns
HOW = (
    "Exact is a fit whose pictures are right to less than 8 bits show, a gradient within 1e-3 of float64, steps at the "
    "optimum, a plan within 0.01 dB of its relaxation, a session without waiting. A fit has 30 iterations, 6 to 12 "
    "Gaussians and two pictures of 32 x 32; it is slow where it leaves more than half of the loss. What does not fit "
    "stays as it was."
)


@dataclass(frozen=True, slots=True)
class Line:
    """What a user may meet, in the cases of these names, and what to do."""

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
    Line("Distance / extent of the scene", ("train-distance",), "bring cameras to a distance like the extent"),
    Line("Motion a frame / size", ("train-motion",), "expect motion of about a size to be followed"),
    Line("The same with the temporal loss", ("train-changes",), "give such frames more iterations"),
    Line("Opacity logits at the start", ("train-opacity",), "start where it can be seen"),
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
            lab.tell(f"{case.name:<24} {count_ends(case.shipped(cells))}")
    return page(cells)


def page(cells: Sequence[Cell]) -> Page:
    tried = [case for case in CASES if case.shipped(cells)]
    wrong = [cell for case in tried for cell in case.shipped(cells) if cell.end in FAULTS]
    tables = [Table("stiff-lines", [row for line in LINES if (row := row_of(line, tried, cells))])]
    pictures = []
    if rates := [row_of_rates(case, cells) for case in tried if case.part == "trainer"]:
        head = {"start": ("what is hard", "")} | {name: (f"rate x {name[1:]}", ".2g") for name in RATES.values()}
        tables.insert(0, Table("stiff-rates", rates, head))
        pictures = [
            PagePicture(
                "stiff-rates", "Loss after thirty iterations, over learning rates", partial(draw, rates), (7, 3.2)
            )
        ]
    more = {"faults": rows_of(wrong)}
    return Page(
        [Section("", "", pictures, tables)], HOW, failed=bool(wrong), more=more, data=[Table("stiff", rows_of(cells))]
    )


def row_of(line: Line, cases: Sequence[Case], cells: Sequence[Cell]) -> Row:
    """Return a line of the page; {} where none of its cases was tried."""
    own = [cell for case in cases if case.name in line.names for cell in case.shipped(cells)]
    counts = count_ends(own)
    return (
        {"what you meet": line.meet} | {end: counts.get(end, 0) for end in ENDS} | {"what to do": line.do}
        if own
        else {}
    )


def row_of_rates(case: Case, cells: Sequence[Cell]) -> Row:
    """Return the largest loss that fits leave of that at their start, for each factor on the learning rates."""
    own = [cell for cell in cells if cell.case == case.name and cell.panel == case.own[0] and cell.end != UNFIT]
    row = {name: max((c.value for c in own if c.row == factor), default=None) for factor, name in RATES.items()}
    return {"start": case.title} | row


def draw(rows: Sequence[Row], figure: Figure) -> None:
    axis = figure.subplots()
    for row in rows:
        axis.plot(
            list(map(float, RATES)), [row[name] for name in RATES.values()], "o-", markersize=4, label=row["start"]
        )
    axis.axhline(1, color="black", linewidth=0.8, linestyle="--")
    axis.set(xscale="log", yscale="log", xlabel="factor on the default learning rates")
    axis.set_ylabel("loss after thirty iterations / before")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.yaxis.set_major_formatter("{x:g}")
    figure.legend(loc="outside right center")
