"""Rows of two frames as one."""

import numpy as np

from airgs_codec.scene.gaussians import mix_rows
from tests.support.scenes import random_gaussians


def test_rows_come_from_one_or_the_other_in_all_columns():
    a, b = (random_gaussians(6, 1, seed) for seed in (1, 2))
    choose = np.array([True, False, False, True, True, False])
    mixed = mix_rows(a, b, choose)
    for name in a.__slots__:
        column = getattr(mixed, name)
        assert column.dtype == np.float32
        np.testing.assert_array_equal(column[choose], getattr(a, name)[choose])
        np.testing.assert_array_equal(column[~choose], getattr(b, name)[~choose])
