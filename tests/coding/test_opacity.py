"""Opacity: alpha and its logit invert one another wherever a logit is finite."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.channels import OPACITY_MARGIN, from_opacity, to_opacity


@given(npst.arrays(np.float32, 20, elements=st.floats(-0.5, 1.5, width=32)))
def test_decoded_opacity_always_has_a_finite_logit_and_is_exact_inside(alpha):
    logits = from_opacity(alpha)
    assert np.isfinite(logits).all()
    inside = np.clip(alpha, OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    np.testing.assert_allclose(to_opacity(logits), inside, atol=2e-7)


def test_logit_extremes_have_finite_opacity():
    assert to_opacity(np.array([-np.inf, -100.0, 0.0, 100.0, np.inf])).tolist()[::2] == [0.0, 0.5, 1.0]
