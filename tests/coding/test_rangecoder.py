"""Columns of whole numbers come back exactly, in few bytes; what is refused is in the vectors (tests/vectors)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding import rangecoder
from airgs_codec.coding.rangecoder import MOST, ColumnReader, encode_columns, sum_gaps
from tests.faces import FormatError

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


def test_compiled_loops_give_the_bytes_and_numbers_of_plain_ones(monkeypatch):
    rng = np.random.default_rng(5)
    wide = rng.integers(0, 1 << 62, 500) >> rng.integers(0, 62, 500)
    columns = [(wide, 0), (rng.geometric(0.3, rangecoder._BATCH + 9), 1), (np.full(3, MOST), 1), (np.empty(0, int), 0)]
    gaps, low = rng.integers(0, 9, 500), 3 * rng.integers(0, 3, 500)
    found, compiles = [], rangecoder._compiled
    assert compiles(rangecoder._decode) is not None
    for compiled in (False, True):
        monkeypatch.setattr(rangecoder, "LOADING", 0 if compiled else 1 << 62)
        monkeypatch.setattr(rangecoder, "_compiled", compiles if compiled else lambda loop: None)
        coded = encode_columns(columns)
        reader = ColumnReader(coded, "x")
        numbers = [reader.column(len(values), order) for values, order in columns]
        reader.close()
        assert all(np.array_equal(a, b) for a, (b, _) in zip(numbers, columns, strict=True))
        with pytest.raises(FormatError, match="got the end"):
            ColumnReader(coded[: len(coded) // 2], "x").column(len(wide) + len(columns[1][0]), 0)
        found.append((coded, sum_gaps(gaps, low, 63), sum_gaps(gaps, low, 4)))
    assert found[0][0] == found[1][0] and np.array_equal(found[0][1], found[1][1])
    assert found[0][2] is None and found[1][2] is None


def test_negative_numbers_are_no_columns():
    with pytest.raises(ValueError, match="-1"):
        encode_columns([(np.array([3, -1]), 0)])
