"""The colour transform that is stored inverts exactly."""

import numpy as np
import pytest

from airgs_codec.coding.channels import fit_colour_transform, from_klt, to_klt
from airgs_codec.package.tables import pack_matrix, unpack_matrix


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
