"""Codes of states, applied to a canonical space (FORMAT.md, sections 4 and 5)."""

from __future__ import annotations

from typing import Any

from tests.makers.vectors.formulas import Row, coding_of, listed, rotated, state_row, total
from tests.makers.vectors.text import Table
from tests.support.vectors import Case, cases

STATIC = 255


def table() -> Table:
    return {"cases": [_made(case) for case in cases("states")]}


def _made(case: Case) -> Case:
    """A case with the rows that its level carries, and what every row is in each frame."""
    depths = case["canonical"]["depths"]
    carried = [row for row, depth in enumerate(depths) if case["level"] <= depth < STATIC]
    return case | {"rows": carried, "frames": [_frame(case, carried, frame) for frame in range(len(case["frames"]))]}


def _frame(case: Case, carried: list[int], frame: int) -> dict[str, Any]:
    shown, coding, codes = _rows(case["canonical"]), coding_of(case), case["frames"][frame]["codes"]
    for row, numbers in zip(carried, zip(*_summed(case, frame), strict=True), strict=False):
        shown[row] = state_row(shown[row], numbers, coding, case["canonical"]["classes"][row])
    return {"codes": codes, **listed(shown, limit=True)}


def _summed(case: Case, frame: int) -> list[list[float]]:
    """The codes of a frame with what slopes add, one list a channel."""
    codes, last = case["frames"][frame]["codes"], len(case["frames"]) - 1
    if "slopes" not in case:
        return list(codes)
    time = (2 * frame - last) / last
    pairs = zip(codes, case["slopes"], strict=True)
    return [[c + time * s for c, s in zip(channel, rise, strict=True)] for channel, rise in pairs]


def _rows(space: Case) -> list[Row]:
    names = ("means", "quaternions", "log_scales", "alpha", "colours")
    return [
        Row(
            *([total([v]) for v in mean], rotated(turn), [total([v]) for v in size], total([alpha])),
            [total([v]) for v in colour],
        )
        for mean, turn, size, alpha, colour in zip(*(space[name] for name in names), strict=True)
    ]
