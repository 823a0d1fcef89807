"""Rows of two frames as one; quaternions and rotation vectors, Morton codes and indices invert one another."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from scipy.spatial.transform import Rotation

from tests.faces import (
    conjugate,
    from_rotation_vector,
    mix_rows,
    morton_decode,
    morton_encode,
    multiply,
    to_matrices,
    to_rotation_vector,
)
from tests.support.scenes import random_gaussians

unit = npst.arrays(np.float64, (20, 4), elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q, axis=1).min() > 1e-3
)


def test_rows_come_from_one_or_the_other_in_all_columns():
    a, b = (random_gaussians(6, 1, seed) for seed in (1, 2))
    choose = np.array([True, False, False, True, True, False])
    mixed = mix_rows(a, b, choose)
    for name in a.__slots__:
        column = getattr(mixed, name)
        assert column.dtype == np.float32
        np.testing.assert_array_equal(column[choose], getattr(a, name)[choose])
        np.testing.assert_array_equal(column[~choose], getattr(b, name)[~choose])


@given(unit, unit)
def test_rotation_vectors_invert_up_to_sign(a, b):
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    relative = to_rotation_vector(multiply(a, conjugate(b)))
    back = multiply(from_rotation_vector(relative), b)
    np.testing.assert_allclose(np.abs((back * a).sum(axis=1)), 1, atol=1e-7)
    assert np.linalg.norm(relative, axis=1).max() <= np.pi + 1e-9


def test_rotation_vectors_at_the_extremes():
    q = np.array([[1, 0, 0, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [1, 1e-12, 0, 0]])
    v = to_rotation_vector(q)
    np.testing.assert_allclose(v, [[0, 0, 0], [0, 0, 0], [np.pi, 0, 0], [2e-12, 0, 0]], atol=1e-15)


def test_matrices_are_those_of_scipy():
    q = np.random.default_rng(0).normal(size=(20, 4))
    np.testing.assert_allclose(to_matrices(q), Rotation.from_quat(q, scalar_first=True).as_matrix(), atol=1e-12)


@given(npst.arrays(np.int64, st.tuples(st.integers(1, 50), st.just(3)), elements=st.integers(0, 2**21 - 1)))
def test_morton_codes_invert(index):
    np.testing.assert_array_equal(morton_decode(morton_encode(index)), index)


def test_morton_bits_interleave_x_first():
    assert morton_encode(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [3, 3, 3]])).tolist() == [1, 2, 4, 8, 63]
