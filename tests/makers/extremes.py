"""Write docs/extremes.md: every case of tests/support/extremes.py with its bound and measured error, or its refusal.

python -m tests.makers.extremes
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.support.extremes import CASES, Outcome, measure_case
from tests.support.paths import REPOSITORY

PAGE = REPOSITORY / "docs" / "extremes.md"
HEAD = """# Extreme sequences

Each is encoded with `--keep-all` at the default steps, validated, decoded and compared with its original, attribute by
attribute, against the `max_error` in its package (FORMAT.md, section 4). The column shows the top rung's attribute that
comes nearest to its bound, in the unit of its channel; no other, nor any other rung, exceeds its own. Written by
`python -m tests.makers.extremes` from tests/support/extremes.py; tests/encoder/test_extremes.py checks the same.

| sequence | nearest to its bound | measured | bound | bytes a row and frame | what was repaired, or why it is refused |
|---|---|---|---|---|---|
"""


def line(outcome: Outcome) -> str:
    """A row of the table."""
    if outcome.refusal:
        return f"| {outcome.name} | refused | | | | {outcome.refusal} |"
    return (
        f"| {outcome.name} | {outcome.attribute.replace('group 0 ', '')} | {outcome.error:.3g} | {outcome.bound:.3g} | "
        f"{outcome.bytes_a_gaussian:.3g} | {outcome.repairs.replace('scene frames', 'frames')} |"
    )


def main() -> None:
    """Measure and write."""
    rows = []
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(line(measure_case(case, Path(folder))))
    PAGE.write_text(HEAD + "\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
