"""How sure what pictures show is, with values worked out by hand and draws anew."""

import math

import numpy as np
import pytest

from airgs_codec.encoder.doubt import RungSeen, doubt_db, doubt_of_ratio, doubt_of_top, ratio_of

# Student's t at 97.5 % over that of a normal distribution, by the number of pictures that are free.
STUDENT = {1: 12.706205, 2: 4.302653, 3: 3.182446, 5: 2.570582, 6: 2.446912}
WIDER = {free: t / 1.959964 for free, t in STUDENT.items()}


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
    # Two pictures of two segments are enough for two places.
    assert doubt_of_top(seen([(1.0, 0.0), (3.0, 0.0)], [(4.0, 0.0), (6.0, 0.0)], places=[[0, 1]] * 2), shares) == 0.0
    blind = seen([(1.0, 0.0), (3.0, 0.0)] * 2, [(4.0, 0.0), (6.0, 0.0)] * 2)
    # Left are -1, 1, -1, 1 in either: a variance of 8 / 6, in each mean over 4, of which the shares are a mean.
    assert doubt_of_top(blind, shares) == pytest.approx(WIDER[6] * (8 / 6 / 4 * (0.25**2 + 0.75**2)) ** 0.5 / 4.25)


def test_places_that_are_looked_at_less_often_than_others_leave_a_doubt():
    """One of two places is seen in three of four pictures: the mean is off by a quarter of what they differ by."""
    uneven = seen([(1.0, 0.0), (1.0, 0.0), (1.0, 0.0), (5.0, 0.0)], places=[[0, 0, 0, 1]])
    assert doubt_of_top(uneven, np.ones(1)) == pytest.approx(WIDER[2] * 0.25 * 4 / 2)


def test_places_that_segments_are_looked_at_from_unevenly_count_by_the_shares_of_these():
    """Left of segments -1, -1, -1, 3 and -3, 1, 1, 1; of places as well 0.5 thrice and 1.5, and the same below 0."""
    first, second = [1.0, 1.0, 1.0, 5.0], [1.0, 5.0, 5.0, 5.0]
    places = [[0, 0, 0, 1], [0, 1, 1, 1]]
    uneven = seen([(e, 0.0) for e in first], [(e, 0.0) for e in second], places=places)
    chance, looked = 6 / 5 * 4 * (0.0625**2 + 0.1875**2), 1.5 * (0.625 - 0.375)
    assert doubt_of_top(uneven, np.array([0.25, 0.75])) == pytest.approx(WIDER[5] * (chance + looked**2) ** 0.5 / 3.5)


def test_of_segments_with_fewer_pictures_each_picture_counts_for_more():
    """Left of segments -1, -1, -1, 3 and -1, 1; of places as well 1 and -1, of those that are looked at twice."""
    some = seen([(e, 0.0) for e in (1.0, 1.0, 1.0, 5.0)], [(2.0, 0.0), (4.0, 0.0)], places=[[0, 0, 0, 1], [0, 1]])
    chance, looked = 2 / 3 * (4 * 0.0625**2 + 2 * 0.375**2), 0.5 * -1 + 0.5 * 2 - (0.5625 * -1 + 0.4375 * 2)
    assert doubt_of_top(some, np.array([0.25, 0.75])) == pytest.approx(WIDER[3] * (chance + looked**2) ** 0.5 / 2.75)


def test_places_tell_nothing_of_fewer_than_two_pictures_each():
    """Six pictures of one segment from four places: the spread about their mean, whatever the places."""
    errors = [(e, 0.0) for e in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)]
    few = doubt_of_top(seen(errors, places=[[0, 1, 2, 3, 0, 1]]), np.ones(1))
    assert few == pytest.approx(WIDER[5] * (17.5 / 5 / 6) ** 0.5 / 3.5)


def test_what_shows_no_error_is_in_no_doubt():
    none = seen([(0.0, 0.0)] * 3)
    assert doubt_of_top(none, np.ones(1)) == doubt_of_ratio(none, np.ones(1)) == 0.0
    assert doubt_db(0.0) == 0.0 and doubt_db(0.5) == pytest.approx(10 * math.log10(2))


def test_a_rung_is_scaled_by_what_the_top_one_shows_in_more_pictures():
    (top,), (part,) = seen([(2.0, 2.0), (4.0, 4.0), (9.0, 9.0)]), seen([(8.0, 2.0), (20.0, 4.0)])
    assert ratio_of({(0, 0): top, (1, 0): part}, part) == pytest.approx(5.0 / 3.0)
    assert ratio_of({(0, 0): top, (1, 0): part}, top) == 1.0
    (still,) = seen([(8.0, 0.0)])
    assert ratio_of({(0, 0): top, (1, 0): still}, still) == 1.0


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
