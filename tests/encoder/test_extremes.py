"""Every extreme sequence comes back within its bound, or is refused for its reason; nothing is silently not finite."""

from dataclasses import replace

import pytest

from tools.lab.numerics.extremes import LINES, page, row
from tools.lab.numerics.sequences import CASES, Outcome, measure_case
from tools.lab.published import read_figures


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_extreme(case, tmp_path):
    outcome = measure_case(case, tmp_path)
    assert case.refused in outcome.refusal and bool(case.refused) == bool(outcome.refusal), outcome
    assert case.repaired in outcome.repairs, outcome
    assert outcome.finite
    assert outcome.worst <= 1, outcome
    if not case.refused:
        assert outcome.compared > 0 and outcome.bytes_a_gaussian > 0


def test_ten_lines_hold_every_sequence_and_all_are_published():
    assert len(LINES) == 10
    assert sorted(name for line in LINES for name in line.names) == sorted(case.name for case in CASES)
    table = read_figures()["extremes"]["tables"]["extremes"]
    published = [dict(zip(table["columns"], values, strict=True)) for values in table["rows"]]
    assert [(one["sequence"], one["verdict"]) for one in published] == [
        (case.name, "refused" if case.refused else "bounded") for case in CASES
    ]


@pytest.mark.parametrize(
    ("refused", "outcome", "verdict", "good"),
    [
        ("", {}, "bounded", True),
        ("", {"worst": 1.01}, "out of its bound", False),
        ("", {"finite": False}, "out of its bound", False),
        ("", {"refusal": "too many codes"}, "refused", False),
        ("codes", {"refusal": "too many codes"}, "refused", True),
        ("codes", {"refusal": "no such file"}, "refused", False),
        ("codes", {}, "bounded", False),
    ],
)
def test_a_sequence_that_ends_otherwise_than_it_should_fails_the_page(refused, outcome, verdict, good):
    end = Outcome("", worst=1.0, bytes_a_gaussian=31.4)
    rows = [row(case, replace(end, name=case.name, refusal=case.refused)) for case in CASES]
    assert not page(rows).failed
    rows[0] = row(replace(CASES[0], refused=refused), replace(end, name=CASES[0].name, **outcome))
    assert (rows[0]["verdict"], rows[0]["good"]) == (verdict, good)
    made = page(rows)
    assert made.failed is not good
    left = "1 of them leave a bound" if verdict == "out of its bound" else "none leaves a bound"
    assert left in made.sections[0].answer
    assert made.sections[0].tables[0].rows[6]["what to do"] == "track them, or pay up to 31 bytes a row and frame"
