"""Sequences at the ends of numbers: which of them come back within their bounds, and which are refused.

Each is encoded with --keep-all at the default steps, validated, decoded and compared with its original. A row has the
attribute of the top rung that comes nearest to its bound, in the unit of its channel. Exit status 1 where a value is
out of its bound or not finite, or a sequence ends otherwise than it should.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tools.lab import Lab, Page, Row, Section, Table, content
from tools.lab.numerics.outcome import BOUNDED, REFUSED
from tools.lab.numerics.sequences import CASES, Case, Outcome, measure_case

OUT = "out of its bound"


@dataclass(frozen=True, slots=True)
class Options:
    """There is nothing to choose."""


@dataclass(frozen=True, slots=True)
class Line:
    meet: str
    names: tuple[str, ...]
    do: str


def _named(*words: str) -> tuple[str, ...]:
    return tuple(case.name for case in CASES if case.name.startswith(words))


LINES = (
    Line(
        "Needles; sizes of e^-30 or e^30", _named("scale ratios", "log-scales of -30", "log-scales of +30"),
        "nothing",
    ),
    Line("Opacity 0, 1, or both in turn", _named("opacity"), "nothing"),
    Line("Quaternions of length 0 to 1e30, half turns", _named("zero quat", "quaternions of", "half turns"), "nothing"),
    Line("All at a point, on a line, equal, constant", _named("all ", "constant"), "nothing"),
    Line("1 to 4,097 Gaussians, 1 to 1,000 frames", _named("one ", "15", "17", "25", "40", "1000 frames"), "nothing"),
    Line("Coordinates of 1e6 with details of 1e-3", _named("1e6 from"), "move the scene to the origin"),
    Line(
        "Jumps of 1e4 steps; rows that share nothing", _named("a jump", "every channel", "the same"),
        "track them, or pay up to {bytes} bytes a row and frame",
    ),
    Line("Colours of 1,000, or subnormal", _named("SH DC of", "SH rest of", "subnormal"), "nothing"),
    Line("64 levels or tiers, tiers without rows", _named("64 ", "more tiers"), "nothing"),
    Line(
        "NaN, infinity, values of 1e30",
        _named("nan in", "inf in", "no finite", "means of 1e38", "log-scales of 1e30", "SH of 1e30"),
        "mend what is refused",
    ),
)  # fmt: skip


def run(options: Options, lab: Lab) -> Page:
    code, rows = content(Path(__file__).parent), []
    for case in CASES:
        rows.append(lab.results.once("extremes", [case.name, code], partial(_measured, case)))
        lab.tell(f"{case.name:<50} {rows[-1]['verdict']}")
    return page(rows)


def _measured(case: Case) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        return row(case, measure_case(case, Path(folder)))


def row(case: Case, outcome: Outcome) -> Row:
    """What became of a case; `good`: as it ought to."""
    kept: Row = {} if outcome.refusal else {
        "nearest to its bound": outcome.attribute.replace("group 0 ", ""), "measured": outcome.error,
        "bound": outcome.bound, "share of it": outcome.worst, "bytes a row and frame": outcome.bytes_a_gaussian,
    }  # fmt: skip
    verdict = REFUSED if outcome.refusal else BOUNDED if outcome.worst <= 1 and outcome.finite else OUT
    good = verdict == (REFUSED if case.refused else BOUNDED) and case.refused in outcome.refusal
    return {"sequence": case.name, "verdict": verdict, "good": good} | kept


def page(rows: Sequence[Row]) -> Page:
    table = Table("extremes-lines", [line_of(one, rows) for one in LINES])
    return Page(
        [Section("", tables=[table])], failed=not all(one["good"] for one in rows), data=[Table("extremes", rows)]
    )


def line_of(line: Line, rows: Sequence[Row]) -> Row:
    own = [one for one in rows if one["sequence"] in line.names]
    kept = [one for one in own if one["verdict"] != REFUSED]
    most = max(one["bytes a row and frame"] for one in kept)
    counts = {"within bounds": sum(one["verdict"] == BOUNDED for one in own), "refused": len(own) - len(kept)}
    return {"what you meet": line.meet} | counts | {"what to do": line.do.format(bytes=f"{most:.2g}")}
