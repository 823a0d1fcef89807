"""Two thousand mutated packages; `python -m tools.fuzz` runs a hundred thousand."""

import pytest

from tools import fuzz


@pytest.mark.parametrize("start", range(0, 2000, 250))
def test_mutants_decode_or_are_refused(start):
    outcomes = list(fuzz.run(range(start, start + 250)))
    assert [o for o in outcomes if o[2]] == []
    assert {"decodes", "bad_value"} <= {o[1] for o in outcomes}


def test_the_corpus_decodes_to_itself():
    for index in range(len(fuzz.corpus())):
        assert fuzz.decode_all(dict(fuzz.corpus()[index])) == fuzz.codes(index)
