"""Write docs/results/extremes.csv: every case of tests/support/extremes.py with its bound and error, or its refusal.

python -m tests.makers.extremes

Each sequence is encoded with --keep-all at the default steps, validated, decoded and compared with its original. A row
has the attribute of the top rung that comes nearest to its bound, in the unit of its channel.
"""

from __future__ import annotations

import csv
import tempfile
from pathlib import Path

from tests.support.extremes import CASES, Outcome, measure_case
from tests.support.paths import REPOSITORY

TABLE = REPOSITORY / "docs" / "results" / "extremes.csv"
COLUMNS = ("sequence", "nearest to its bound", "measured", "bound", "bytes a row and frame", "refused")


def row(outcome: Outcome) -> list[str]:
    """A case as a row of the table."""
    if outcome.refusal:
        return [outcome.name, "", "", "", "", outcome.refusal]
    figures = [f"{value:.3g}" for value in (outcome.error, outcome.bound, outcome.bytes_a_gaussian)]
    return [outcome.name, outcome.attribute.replace("group 0 ", ""), *figures, ""]


def main() -> None:
    """Measure and write."""
    rows = []
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(row(measure_case(case, Path(folder))))
    with TABLE.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
