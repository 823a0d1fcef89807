"""Two thousand mutated packages; `python -m tests.long.fuzz` runs a hundred thousand."""

import pytest

from tests.long import fuzz


@pytest.mark.parametrize("start", range(0, 2000, 250))
def test_mutants_decode_or_are_refused(start):
    outcomes = list(fuzz.run(range(start, start + 250)))
    assert [o for o in outcomes if o.is_finding] == []
    assert {"decodes", "bad_value"} <= {o.text for o in outcomes}


def test_the_corpus_decodes_to_itself():
    for index in range(len(fuzz.corpus())):
        assert fuzz.decode_all(dict(fuzz.corpus()[index])) == fuzz.decoded(index)
