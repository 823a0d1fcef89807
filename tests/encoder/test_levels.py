"""Tiers and levels are nested, and hold what is used most."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.encoder.levels import assign_depths, assign_tiers
from airgs_codec.package.tables import STATIC


def test_tiers_hold_the_most_used_first():
    usage = np.array([0.1, 0.9, 0.5, 0.7, 0.3])
    assert assign_tiers(usage, (0.4, 0.6)).tolist() == [1, 0, 1, 0, 1]
    assert assign_tiers(np.ones(1), (0.8, 0.2)).tolist() == [0]
    assert assign_tiers(np.array([1.0, 2.0]), (0.1, 0.9)).tolist() == [1, 0]  # the first is never empty


@given(
    npst.arrays(np.float64, 30, elements=st.floats(0, 10)),
    npst.arrays(np.bool_, 30),
    st.lists(st.floats(0, 0.99), min_size=1, max_size=6).map(sorted),
)
def test_levels_are_nested_and_withhold_their_share_of_the_lowest_scores(score, moving, shares):
    depths = assign_depths(score, moving, shares)
    assert (depths[~moving] == STATIC).all()
    for level, share in enumerate(shares):
        kept = (depths >= level) & (depths != STATIC)
        assert kept.sum() == round((1 - share) * moving.sum())
        if kept.any() and (moving & ~kept).any():
            assert score[kept].min() >= score[moving & ~kept].max()
