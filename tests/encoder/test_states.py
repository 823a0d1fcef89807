"""States of rows that are not drawn in some frames."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.escapes import LIMIT, UNIT
from airgs_codec.encoder.level import LEAST_HIDDEN, hide_undrawn


@given(
    npst.arrays(np.float64, (6, 5), elements=st.sampled_from([0.0, 0.002, 0.005, 0.02, 0.3, 1.0])),
    st.floats(0.001, 0.02),
)
def test_rows_that_are_not_drawn_are_hidden_by_bases_and_others_are_as_they_were(alpha, unit):
    base = np.array([0.0, 0.01, 0.3, 0.6, 1.0])
    changes, bases = hide_undrawn(alpha - base, base, unit)
    shown = base + changes - bases * UNIT * unit
    drawn = alpha >= 1 / 255
    np.testing.assert_allclose(shown[drawn], alpha[drawn], atol=1e-12)
    assert (bases[drawn] == 0).all()
    hidden = bases > 0
    assert (shown[hidden] <= -(UNIT - LIMIT) * unit + 1e-9).all()  # whatever the video codec errs
    assert (np.abs(shown - alpha)[~drawn & ~hidden] <= LEAST_HIDDEN * unit + 1e-9).all()


def test_samples_of_a_row_that_goes_and_comes_do_not_change():
    alpha = np.array([[0.8, 0.0, 0.8, 0.0, 0.0, 0.8]]).T
    changes, bases = hide_undrawn(alpha - 0.5, np.array([0.5]), 0.01)
    assert np.ptp(changes) == 0 and bases[:, 0].tolist() == [0, 1, 0, 1, 1, 0]
