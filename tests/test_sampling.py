"""A few of many: ascending, within bounds, evenly spaced."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from airgs_codec._sampling import evenly_spaced, middle_frames


@given(st.integers(1, 500), st.integers(1, 50))
def test_evenly_spaced_picks_have_the_first_and_last_among_them(count, most):
    picks = evenly_spaced(count, most)
    assert len(picks) == min(count, most) and picks == sorted(set(picks)) and picks[0] == 0
    if most > 1:
        gaps = [b - a for a, b in pairwise(picks)]
        assert picks[-1] == count - 1 and (not gaps or max(gaps) - min(gaps) <= 2)


@given(st.integers(0, 100), st.integers(1, 200), st.integers(1, 50))
def test_middle_frames_lie_in_the_middle_of_equal_parts(start, length, most):
    picks = middle_frames(start, start + length, most)
    parts = min(most, length)
    assert len(picks) == parts
    for i, frame in enumerate(picks):
        assert abs(frame + 0.5 - (start + (i + 0.5) * length / parts)) <= 0.5
