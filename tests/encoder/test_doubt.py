"""How sure what pictures show is, with values worked out by hand and draws anew."""

import math

import numpy as np
import pytest

from airgs_codec.encoder.doubt import RungSeen, doubt_of_ratio, doubt_of_top

# Student's t at 97.5 % over that of a normal distribution, by the number of pictures that are free.
WIDER = {1: 12.706205 / 1.959964, 2: 4.302653 / 1.959964, 6: 2.446912 / 1.959964}


def seen(*segments, places=None):
    """What was seen in segments: (error of a rung, of the top one) of each picture, all from one place by default."""
    numbers = places or [[0] * len(of) for of in segments]
    return [
        RungSeen([own for own, _ in of], [top for _, top in of], at, [])
        for of, at in zip(segments, numbers, strict=True)
    ]


def test_the_doubt_of_a_rung_is_what_its_ratio_to_the_top_one_spreads_by():
    """Of ratios that are the same in all pictures there is none, however pictures differ; without error neither."""

    def doubt(*segments):
        return doubt_of_ratio(seen(*segments), np.full(len(segments), 1 / len(segments)))

    assert doubt([(2.0, 1.0), (6.0, 3.0)], [(4.0, 2.0)]) == 0.0
    assert doubt([(0.0, 1.0), (0.0, 3.0)], [(0.0, 2.0)]) == 0.0
    # Own errors 1, 3 and 2, 2 about a ratio of 2: left are -1, 1, 0, 0, their variance 2 / 2, of the mean of four.
    assert doubt([(1.0, 1.0), (3.0, 1.0)], [(2.0, 1.0), (2.0, 1.0)]) == pytest.approx(WIDER[2] * (2 / 2 / 4) ** 0.5 / 2)
    # The top one shows no error: the spread is that of the rung's own errors.
    assert doubt([(1.0, 0.0), (3.0, 0.0)], [(2.0, 0.0), (2.0, 0.0)]) == pytest.approx(WIDER[2] * (2 / 2 / 4) ** 0.5 / 2)
    # One picture of each segment: segments tell their spread, 1 and 3 about 2.
    assert doubt([(1.0, 0.0)], [(3.0, 0.0)]) == pytest.approx(WIDER[1] * (2 / 1 / 2) ** 0.5 / 2)
    assert doubt([(1.0, 1.0)]) == math.inf


def test_what_places_and_segments_explain_is_no_doubt():
    """Errors of 1 from one place and 3 from another, in two segments of which one has twice the error of the other."""
    shares, at = np.array([0.25, 0.75]), [[0, 1, 0, 1], [0, 1, 0, 1]]
    even = seen([(1.0, 0.0), (3.0, 0.0)] * 2, [(4.0, 0.0), (6.0, 0.0)] * 2, places=at)
    assert doubt_of_top(even, shares) == 0.0
    blind = seen([(1.0, 0.0), (3.0, 0.0)] * 2, [(4.0, 0.0), (6.0, 0.0)] * 2)
    # Left are -1, 1, -1, 1 in either: a variance of 8 / 6, in each mean over 4, of which the shares are a mean.
    assert doubt_of_top(blind, shares) == pytest.approx(WIDER[6] * (8 / 6 / 4 * (0.25**2 + 0.75**2)) ** 0.5 / 4.25)


def test_places_that_are_looked_at_less_often_than_others_leave_a_doubt():
    """One of two places is seen in three of four pictures: the mean is off by a quarter of what they differ by."""
    uneven = seen([(1.0, 0.0), (1.0, 0.0), (1.0, 0.0), (5.0, 0.0)], places=[[0, 0, 0, 1]])
    assert doubt_of_top(uneven, np.ones(1)) == pytest.approx(WIDER[2] * 0.25 * 4 / 2)


def test_doubts_hold_for_pictures_that_are_drawn_anew():
    """Of 400 draws from places that differ, the true mean is off by two standard errors in about one of twenty."""
    rng, means = np.random.default_rng(5), np.array([1.0, 2.0, 4.0, 9.0])
    off = []
    for _ in range(400):
        at = [rng.permutation(np.repeat(np.arange(4), 3)).tolist()[:10] for _ in range(2)]
        errors = [[(float(means[p] * rng.gamma(4.0, 0.25)), 0.0) for p in of] for of in at]
        found = np.mean([[own for own, _ in of] for of in errors])
        doubt = doubt_of_top(seen(*errors, places=at), np.full(2, 0.5))
        off.append(abs(found - means.mean()) > 2 * doubt * found)
    assert 0.02 < np.mean(off) < 0.1
