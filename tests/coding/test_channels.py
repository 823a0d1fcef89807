"""The colour transform that is stored inverts exactly."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.channels import OPACITY_MARGIN, fit_colour_transform, from_klt, from_opacity, to_klt, to_opacity
from tests.faces import pack_matrix, unpack_matrix


@pytest.mark.parametrize("channels", [3, 12, 27, 48])
def test_the_stored_colour_transform_inverts_exactly(channels):
    colour = np.random.default_rng(0).normal(size=(500, channels)) @ np.random.default_rng(1).normal(
        size=(channels,) * 2
    )
    stored = unpack_matrix(pack_matrix(fit_colour_transform(colour)), channels)
    np.testing.assert_allclose(stored @ stored.T, np.eye(channels), atol=1e-3)
    back = from_klt(to_klt(colour, stored), stored)
    np.testing.assert_allclose(back, colour, atol=1e-9 * np.abs(colour).max())


def test_the_colour_transform_of_constant_colours_is_orthonormal():
    t = fit_colour_transform(np.ones((5, 12)))
    np.testing.assert_allclose(t @ t.T, np.eye(12), atol=1e-12)


@given(npst.arrays(np.float32, 20, elements=st.floats(-0.5, 1.5, width=32)))
def test_decoded_opacity_always_has_a_finite_logit_and_is_exact_inside(alpha):
    logits = from_opacity(alpha)
    assert np.isfinite(logits).all()
    inside = np.clip(alpha, OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    np.testing.assert_allclose(to_opacity(logits), inside, atol=2e-7)


def test_logit_extremes_have_finite_opacity():
    assert to_opacity(np.array([-np.inf, -100.0, 0.0, 100.0, np.inf])).tolist()[::2] == [0.0, 0.5, 1.0]
