"""Escapes are lossless, keep luma off its ends, and jump as seldom as can be."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding import escapes

codes = npst.arrays(
    np.int32,
    st.tuples(st.integers(1, 6), st.integers(1, 3), st.integers(1, 8)),
    elements=st.one_of(st.integers(-100, 100), st.integers(-(2**30) + 1, 2**30 - 1)),
)


@given(codes)
@settings(max_examples=200)  # the first call compiles
def test_escapes_are_lossless_and_stay_off_the_ends_of_luma(values):
    luma, bases = escapes.split(values)
    assert luma.min() >= 32 and luma.max() <= 224
    np.testing.assert_array_equal(luma.astype(np.int64) - 128 + escapes.UNIT * bases.astype(np.int64), values)
    unpacked = escapes.unpack(escapes.pack(escapes.Escapes.of(bases)) or None, values.shape, "here")
    for t in range(len(values)):
        np.testing.assert_array_equal(unpacked.bases(t), bases[t])
    for running, expected in zip(unpacked.running(), bases, strict=True):
        shown = [np.zeros_like(line) if base is None else base for base, line in zip(running, expected, strict=True)]
        np.testing.assert_array_equal(shown, expected)


@given(codes)
@settings(max_examples=50)
def test_planes_that_are_split_one_by_one_have_the_escapes_of_all_together(values):
    whole = escapes.Escapes.of(escapes.split(values)[1])
    planes = [escapes.Escapes.of(escapes.split(values[:, p : p + 1])[1]) for p in range(values.shape[1])]
    joined = escapes.Escapes.join(planes)
    assert joined.shape == whole.shape
    assert joined.index.tolist() == whole.index.tolist() and joined.jumps.tolist() == whole.jumps.tolist()


def fewest_jumps(series):
    """Of one sample, by trying every base in every frame."""
    cost = {0: 0}
    for code in series:
        serving = [b for b in range(-4, 5) if abs(code - escapes.UNIT * b) <= escapes.LIMIT]
        cost = {b: min(c + (b != a) for a, c in cost.items()) for b in serving}
    return min(cost.values())


@given(st.lists(st.integers(-400, 400), min_size=1, max_size=9))
def test_no_choice_of_bases_jumps_less(series):
    _, bases = escapes.split(np.array(series, np.int32)[:, None, None])
    assert np.count_nonzero(np.diff(bases[:, 0, 0], prepend=0)) == fewest_jumps(series)


def test_a_base_jumps_no_further_than_it_must():
    _, bases = escapes.split(np.array([[0, 0], [300, -300]], np.int32)[:, None])
    np.testing.assert_array_equal(bases[1, 0], [2, -2])  # 3 and -3 would serve as well
