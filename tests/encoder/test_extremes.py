"""Every extreme sequence comes back within its bound, or is refused for its reason; nothing is silently not finite."""

import csv

import pytest

from tests.makers import extremes
from tests.support.extremes import CASES, LINES, measure_case


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_extreme(case, tmp_path):
    outcome = measure_case(case, tmp_path)
    assert case.refused in outcome.refusal and bool(case.refused) == bool(outcome.refusal), outcome
    assert case.repaired in outcome.repairs, outcome
    assert outcome.finite
    assert outcome.worst <= 1, outcome
    if not case.refused:
        assert outcome.compared > 0 and outcome.bytes_a_gaussian > 0


def test_ten_lines_hold_every_sequence_and_the_page_shows_them():
    assert len(LINES) == 10
    assert sorted(name for line in LINES for name in line.names) == sorted(case.name for case in CASES)
    head, *rows = csv.reader(extremes.TABLE.read_text().splitlines())
    assert tuple(head) == extremes.COLUMNS and [row[0] for row in rows] == [case.name for case in CASES]
    assert [row[1] for row in rows] == ["refused" if case.refused else "bounded" for case in CASES]
    assert extremes.lines(rows) in extremes.PAGE.read_text()
