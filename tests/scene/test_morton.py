"""Morton codes invert, and their bits interleave x first."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.scene.morton import morton_decode, morton_encode


@given(npst.arrays(np.int64, st.tuples(st.integers(1, 50), st.just(3)), elements=st.integers(0, 2**21 - 1)))
def test_morton_codes_invert(index):
    np.testing.assert_array_equal(morton_decode(morton_encode(index)), index)


def test_morton_bits_interleave_x_first():
    assert morton_encode(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [3, 3, 3]])).tolist() == [1, 2, 4, 8, 63]
