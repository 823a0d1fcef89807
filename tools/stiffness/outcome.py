"""Cells of a sweep, how each ends, and the regions that neighbouring cells of one end make."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from airgs_codec.errors import AirgsError

CONVERGES, BOUNDED, REFUSED, DIVERGES, NOT_FINITE = "converges", "is bounded", "is refused", "diverges", "is not finite"
ENDS = (CONVERGES, BOUNDED, REFUSED, DIVERGES, NOT_FINITE)
FAULTS = (DIVERGES, NOT_FINITE)  # ends that the code as it is may not have
NUMBERS = re.compile(r"\d[\d.e+-]*|inf")
HALVED = 0.5  # of the loss at the start: a fit that ends below converges
GROWN = 1.05  # of the loss at the start: a fit that ends above diverges
INVISIBLE = 1e-4  # loss: a tenth of the mean error of rounding pictures to 8 bits; what stays below does not diverge


@dataclass(frozen=True, slots=True)
class Cell:
    """One experiment."""

    panel: str  # a picture of the map: the method
    y: str  # its row
    x: float  # its column
    end: str  # of ENDS
    value: float  # what was measured
    note: str = ""  # the message of a refusal, or what bounds


@dataclass(frozen=True, slots=True)
class Sweep:
    """Experiments along one or two axes, and which of them are the code as it is."""

    name: str  # of the file
    title: str
    x_label: str
    y_label: str
    value_label: str
    own: tuple[str, str]  # panel and row of the code as it is; "" stands for all of them
    does: str  # what the code does about it
    cells: tuple[Cell, ...]

    @property
    def shipped(self) -> list[Cell]:
        """The cells of the code as it is, row by row, along x."""
        panel, row = self.own
        return [cell for cell in self.cells if panel in ("", cell.panel) and row in ("", cell.y)]


@dataclass(frozen=True, slots=True)
class Region:
    """Neighbouring cells of one row that end alike."""

    row: str
    first: float  # of x
    last: float
    end: str
    cells: tuple[Cell, ...]

    @property
    def notes(self) -> str:
        """What the cells say, who differ in numbers alone: the first one's words, and the last one's if they differ."""
        return "; ".join(dict.fromkeys(note for note in (self.cells[0].note, self.cells[-1].note) if note))


def _kind(cell: Cell) -> tuple[str, str, str]:
    """What cells of one region share: the row, the end, and what is said but for its numbers."""
    return cell.y, cell.end, NUMBERS.sub("", cell.note)


def regions(sweep: Sweep) -> list[Region]:
    """The regions of the code as it is."""
    found = []
    for (row, end, _), cells in itertools.groupby(sweep.shipped, key=_kind):
        some = tuple(cells)
        found.append(Region(row, some[0].x, some[-1].x, end, some))
    return found


def fit_end(before: float, after: float, finite: bool) -> str:
    """How a fit ended, from its loss before and after and whether all that it fitted is finite."""
    if not (finite and math.isfinite(before) and math.isfinite(after)):
        return NOT_FINITE
    if after > max(GROWN * before, INVISIBLE):
        return DIVERGES
    return CONVERGES if after <= HALVED * before and before > 0 else BOUNDED


def error_end(error: float, close: float) -> str:
    """How a comparison ended: an error of at most `close` converges, a larger one is bounded by what it is."""
    if not math.isfinite(error):
        return NOT_FINITE
    return CONVERGES if error <= close else BOUNDED


def attempt(panel: str, y: str, x: float, work: Callable[[], tuple[str, float, str]]) -> Cell:
    """The cell of an experiment that gives its end, value and note; an AirgsError is a refusal, others are raised."""
    try:
        return Cell(panel, y, x, *work())
    except AirgsError as error:
        return Cell(panel, y, x, REFUSED, math.nan, str(error))


def count_ends(cells: Sequence[Cell]) -> dict[str, int]:
    """How many cells end in each way, those that none does left out."""
    return {end: sum(cell.end == end for cell in cells) for end in ENDS if any(cell.end == end for cell in cells)}


def span(first: float, last: float) -> str:
    """A region of x in words."""
    return number(first) if first == last else f"{number(first)} to {number(last)}"


def number(value: float) -> str:
    """A number in three digits."""
    return f"{value:.3g}"
