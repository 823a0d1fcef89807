"""Quantisation errs by at most half a code and never clips."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.quantize import STEP_LIMITS, to_codes
from tests.faces import SceneError, from_codes


@given(
    values=npst.arrays(np.float64, (3, 2, 5), elements=st.floats(-1e3, 1e3)),
    step=st.floats(1e-3, 10),
    gain=st.floats(1, 16),
)
def test_quantisation_error_is_at_most_half_a_code(values, step, gain):
    steps = np.array([step, 2 * step])
    for t in range(3):
        back = from_codes(to_codes(values, steps, gain)[t], steps, gain)
        error = np.abs(back - values[t])
        bound = steps[:, None] / (2 * gain) + 1e-6 * np.abs(values[t]) + 1e-9
        assert (error <= bound).all()


@pytest.mark.parametrize("value", [1e30, np.inf, np.nan])
def test_what_no_code_holds_is_refused_and_never_clipped(value):
    with np.errstate(all="ignore"), pytest.raises(SceneError, match="channel 1"):
        to_codes(np.array([[[0.0], [value]]]), np.array([1.0, 1.0]), 3.0)


@pytest.mark.parametrize("step", [1e-40, 1e40, 0.0, math.inf, math.nan])
def test_a_step_that_float32_cannot_hold_is_refused(step):
    values = np.zeros((1, 2, 3))
    with pytest.raises(SceneError, match=r"channel 1: expected a step of 1e-30 to 1e\+30, got"):
        to_codes(values, np.array([1.0, step]), 1.0)
    for held in STEP_LIMITS:
        steps = np.array([1.0, held])
        assert (from_codes(to_codes(values, steps, 1.0)[0], steps, 1.0) == 0).all()
