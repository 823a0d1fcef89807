"""Cases of `stiff`: experiments along one or two axes, and how each of them ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from airgs_codec.errors import AirgsError

EXACT, BOUNDED, SLOW, UNFIT, REFUSED = VERDICTS = ("exact", "bounded", "slow", "does not fit", "refused")
DIVERGES, NOT_FINITE = "diverges", "not finite"
ENDS = (*VERDICTS, DIVERGES, NOT_FINITE)
FAULTS = (DIVERGES, NOT_FINITE)  # ends that the code as it is may not have
HALVED = 0.5  # of the loss at the start: a fit that ends above is slow, whatever bounds it
INVISIBLE = 1e-4  # loss: a tenth of the mean error of rounding pictures to 8 bits; what stays below is exact

Judged = tuple[str, float, str]  # end, what was measured, the message of a refusal or what bounds
At = tuple[str, str, float]  # panel of the map (the method), its row, its column


@dataclass(frozen=True, slots=True)
class Cell:
    case: str
    panel: str
    row: str
    x: float
    end: str  # of ENDS
    value: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class Case:
    """Experiments along one or two axes, and which of them are the code as it is."""

    part: str
    name: str
    title: str
    own: tuple[str, str]  # panel and row of the code as it is; "" stands for all of them
    points: tuple[At, ...]
    judge: Callable[[str, str, float], Judged]

    def run(self, quick: bool = False) -> list[Cell]:
        """All experiments; `quick`: a third of the axis. An AirgsError is a refusal, other errors are raised."""
        chosen = sorted({x for _, _, x in self.points})[:: 3 if quick else 1]
        return [Cell(self.name, *at, *attempt(self.judge, at)) for at in self.points if at[2] in chosen]

    def shipped(self, cells: Iterable[Cell]) -> list[Cell]:
        panel, row = self.own
        own = [c for c in cells if c.case == self.name and panel in ("", c.panel) and row in ("", c.row)]
        return sorted(own, key=lambda c: c.x)


def attempt(judge: Callable[[str, str, float], Judged], at: At) -> Judged:
    try:
        return judge(*at)
    except AirgsError as error:
        return REFUSED, math.nan, str(error)


def grid(panels: Iterable[str], rows: Iterable[str], xs: Iterable[float]) -> tuple[At, ...]:
    rows, xs = list(rows), list(xs)
    return tuple((panel, row, x) for panel in panels for row in rows for x in xs)


def fit_end(before: float, after: float, finite: bool) -> str:
    """Return how a fit ended, from its loss before and after and whether all that it fitted is finite."""
    if not (finite and math.isfinite(before) and math.isfinite(after)):
        return NOT_FINITE
    if after > max(before, INVISIBLE):
        return DIVERGES
    return EXACT if after <= INVISIBLE else BOUNDED if after <= HALVED * before else SLOW


def error_end(error: float, close: float) -> str:
    """Return how a comparison ended: an error of at most `close` is exact, a larger one is bounded by what it is."""
    if not math.isfinite(error):
        return NOT_FINITE
    return EXACT if error <= close else BOUNDED


def count_ends(cells: Sequence[Cell]) -> dict[str, int]:
    return {end: sum(cell.end == end for cell in cells) for end in ENDS if any(cell.end == end for cell in cells)}


def number(value: float) -> str:
    return f"{value:.3g}"
