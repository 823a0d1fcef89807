"""Write docs/results/extremes.csv, every case of tests/support/extremes.py, and the ten lines of numerics.md beside it.

python -m tests.makers.extremes

Each sequence is encoded with --keep-all at the default steps, validated, decoded and compared with its original. A row
has the attribute of the top rung that comes nearest to its bound, in the unit of its channel.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.support.extremes import CASES, LINES, Line, Outcome, measure_case
from tests.support.paths import REPOSITORY
from tools.lab.page import Table, markdown_table

RESULTS = REPOSITORY / "docs" / "results"
TABLE, PAGE = RESULTS / "extremes.csv", RESULTS / "numerics.md"
COLUMNS = ("sequence", "verdict", "nearest to its bound", "measured", "bound", "bytes a row and frame")
MARKS = "<!-- extremes: begin -->", "<!-- extremes: end -->"


def row(outcome: Outcome) -> list[str]:
    """A case as a row of the table."""
    if outcome.refusal:
        return [outcome.name, "refused", "", "", "", ""]
    figures = [f"{value:.3g}" for value in (outcome.error, outcome.bound, outcome.bytes_a_gaussian)]
    return [outcome.name, "bounded", outcome.attribute.replace("group 0 ", ""), *figures]


def line(of: Line, rows: Sequence[Sequence[str]]) -> dict[str, str]:
    """A line of the page, from the rows of the table that are its cases."""
    own = [dict(zip(COLUMNS, one, strict=True)) for one in rows if one[0] in of.names]
    kept = [one for one in own if one["verdict"] == "bounded"]
    parts = [f"bounded by `max_error` ({len(kept)})"] + [f"refused ({len(own) - len(kept)})"] * (len(kept) < len(own))
    most = max(float(one[COLUMNS[-1]]) for one in kept)
    happens = {"what you meet": of.meet, "what happens (sequences)": "; ".join(parts)}
    return happens | {"what to do": of.do.format(bytes=f"{most:.2g}")}


def lines(rows: Sequence[Sequence[str]]) -> str:
    """The ten lines as a table of Markdown."""
    return "\n".join(markdown_table(Table("extremes", [line(one, rows) for one in LINES])))


def main() -> None:
    """Measure and write."""
    rows = []
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(row(measure_case(case, Path(folder))))
    with TABLE.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    show(rows)


def show(rows: Sequence[Sequence[str]]) -> None:
    """Put the lines into the page."""
    text = PAGE.read_text()
    before, after = text.partition(MARKS[0])[0], text.partition(MARKS[1])[2]
    PAGE.write_text(f"{before}{MARKS[0]}\n\n{lines(rows)}\n\n{MARKS[1]}{after}")


if __name__ == "__main__":
    main()
