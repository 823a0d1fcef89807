"""Columns of whole numbers come back exactly, in few bytes; what is refused is in the vectors (tests/vectors)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.rangecoder import MOST, ColumnReader, encode_columns

columns = st.lists(
    st.tuples(
        npst.arrays(np.int64, st.integers(0, 60), elements=st.one_of(st.integers(0, 9), st.integers(0, MOST))),
        st.sampled_from([0, 1]),
    ),
    max_size=4,
)


@given(columns)
def test_coded_columns_are_exact(written):
    reader = ColumnReader(encode_columns(written), "x")
    for values, order in written:
        np.testing.assert_array_equal(reader.column(len(values), order), values)
    reader.close()


def test_columns_longer_than_a_batch_are_exact_and_near_their_entropy():
    rng = np.random.default_rng(3)
    values = rng.geometric(0.3, 100_000)
    coded = encode_columns([(values, 0)])
    np.testing.assert_array_equal(ColumnReader(coded, "x").column(len(values), 0), values)
    share = 0.3 * 0.7 ** (np.arange(1, 60) - 1)
    entropy = -(share * np.log2(share)).sum()
    assert 8 * len(coded) / len(values) < 1.03 * entropy


def test_the_number_before_helps_order_1():
    walk = np.random.default_rng(3).integers(0, 2, 5000).cumsum() // 100 % 9
    assert len(encode_columns([(walk, 1)])) < 0.5 * len(encode_columns([(walk, 0)]))


def test_negative_numbers_are_no_columns():
    with pytest.raises(ValueError, match="-1"):
        encode_columns([(np.array([3, -1]), 0)])
