"""Every extreme sequence comes back within its bound, or is refused for its reason; nothing is silently not finite."""

import pytest

from tests.support.extremes import CASES, measure_case


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_extreme(case, tmp_path):
    outcome = measure_case(case, tmp_path)
    assert case.refused in outcome.refusal and bool(case.refused) == bool(outcome.refusal), outcome
    assert case.repaired in outcome.repairs, outcome
    assert outcome.finite
    assert outcome.worst <= 1, outcome
    if not case.refused:
        assert outcome.compared > 0 and outcome.bytes_a_gaussian > 0
