"""What is measured of every rung, and with how many pictures."""

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder import measure
from airgs_codec.encoder.measure import (
    LOWER,
    OFF_LADDER,
    ROUNDS,
    Quest,
    Rounds,
    RungSeen,
    measure_groups,
    measure_round,
    pictures_of,
)
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.survey import ViewPlan
from airgs_codec.media.metrics import psnr
from airgs_codec.package.manifest import Groups, on_ladder, pooled_quality
from airgs_codec.package.package import Package, open_package
from airgs_codec.scene.sequence import open_sequence
from tests.support.scenes import moving_frames, write_sequence

LEVELS = (LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A package of two segments, L0 with Q0 and L1 with Q1, not measured."""
    folder = tmp_path_factory.mktemp("quality")
    sequence = open_sequence(write_sequence(folder / "scene", moving_frames(80, 6)))
    settings = EncodeSettings(calibrate="none", levels=LEVELS, measure_pictures=0, preset="ultrafast", segment_s=0.1)
    encode(sequence, folder / "out", settings)
    return open_package(folder / "out"), sequence


def measured(small, monkeypatch, unsure, lower):
    """For every rung (segment, level, key quality) squared errors of it and of the top rung; and the tables.

    24 pictures a round, until doubts are as small as `unsure` and `lower`.
    """
    package, sequence = small
    errors, tops = defaultdict(list), {}

    def ask(asked):
        pictures = pictures_of(views, package.manifest, 0, asked, len(package.manifest.segments))
        found = measure_round(package, sequence, views.renderer, 0, pictures)
        for segment, of_segment in enumerate(found):
            by_rung = dict(zip(asked.strides, of_segment, strict=True))
            if (0, 0) in by_rung:
                tops[segment, asked.number] = by_rung[0, 0].squared
            for (level, key), of_rung in by_rung.items():
                assert len(of_rung.alike) == (len(of_rung.squared) if asked.number == 0 else 0)
                top = tops[segment, asked.number][:: asked.strides[level, key]]
                errors[segment, level, key] += zip(of_rung.squared, top, strict=True)
        return [found]

    monkeypatch.setattr(measure, "UNSURE", unsure)
    monkeypatch.setattr(measure, "UNSURE_LOWER", lower)
    views = ViewPlan.of(sequence, 24)  # small pictures: twice as many
    found = measure_groups(Quest(package.manifest, [0], views, Rounds(12), ask))
    assert len(package.manifest.groups) == 1 and len(errors) == len(package.manifest.segments) * 4
    return errors, found.whole(package.manifest)


def test_every_rung_is_measured_once_with_fewer_pictures_than_the_top_one(small, monkeypatch):
    """What is measured in few pictures is scaled by what the top rung shows in others."""
    errors, m = measured(small, monkeypatch, unsure=100.0, lower=100.0)
    few = -(-24 // OFF_LADDER)
    check_scaled(errors, m, {(0, 0): 24, (1, 1): 24 // LOWER, (0, 1): few, (1, 0): few})


def test_more_pictures_of_the_top_rung_are_measured_until_its_error_is_sure(small, monkeypatch):
    errors, m = measured(small, monkeypatch, unsure=0.0, lower=100.0)
    few = -(-24 // OFF_LADDER)
    check_scaled(errors, m, {(0, 0): 24 * ROUNDS, (1, 1): 24 // LOWER, (0, 1): few, (1, 0): few})


def test_more_pictures_are_measured_of_unsure_rungs_that_no_mixture_beats(small, monkeypatch):
    """Here finest keys with coarse states are such a mixture."""
    more = 24 * (ROUNDS - 1)
    errors, m = measured(small, monkeypatch, unsure=100.0, lower=0.0)
    rungs = [(j, q) for j in range(2) for q in range(2)]
    ladder = on_ladder([(m.bytes_of(m.rung_files(q, j)), pooled_quality(m, j, q).psnr) for j, q in rungs])
    assert [rung for rung, there in zip(rungs, ladder, strict=True) if there] == [(0, 0), (0, 1), (1, 1)]
    few = -(-24 // OFF_LADDER)
    check_scaled(errors, m, {(0, 0): 24 + more, (1, 1): 24 // LOWER + more, (0, 1): few + more, (1, 0): few})


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
        return measure._doubt_of_ratio(seen(*segments), np.full(len(segments), 1 / len(segments)))

    assert doubt([(2.0, 1.0), (6.0, 3.0)], [(4.0, 2.0)]) == 0.0
    assert doubt([(0.0, 1.0), (0.0, 3.0)], [(0.0, 2.0)]) == 0.0
    # Own errors 1, 3 and 2, 2 about a ratio of 2: left are -1, 1, 0, 0, their variance 2 / 2, of the mean of four.
    assert doubt([(1.0, 1.0), (3.0, 1.0)], [(2.0, 1.0), (2.0, 1.0)]) == pytest.approx((2 / 2 / 4) ** 0.5 / 2)
    # The top one shows no error: the spread is that of the rung's own errors.
    assert doubt([(1.0, 0.0), (3.0, 0.0)], [(2.0, 0.0), (2.0, 0.0)]) == pytest.approx((2 / 2 / 4) ** 0.5 / 2)
    # One picture of each segment: segments tell their spread, 1 and 3 about 2.
    assert doubt([(1.0, 0.0)], [(3.0, 0.0)]) == pytest.approx((2 / 1 / 2) ** 0.5 / 2)
    assert doubt([(1.0, 1.0)]) == math.inf


def test_what_places_and_segments_explain_is_no_doubt():
    """Errors of 1 from one place and 3 from another, in two segments of which one has twice the error of the other."""
    shares, at = np.array([0.25, 0.75]), [[0, 1, 0, 1], [0, 1, 0, 1]]
    even = seen([(1.0, 0.0), (3.0, 0.0)] * 2, [(4.0, 0.0), (6.0, 0.0)] * 2, places=at)
    assert measure._doubt_of_top(even, shares) == 0.0
    blind = seen([(1.0, 0.0), (3.0, 0.0)] * 2, [(4.0, 0.0), (6.0, 0.0)] * 2)
    # Left are -1, 1, -1, 1 in either: a variance of 8 / 6, in each mean over 4, of which the shares are a mean.
    assert measure._doubt_of_top(blind, shares) == pytest.approx((8 / 6 / 4 * (0.25**2 + 0.75**2)) ** 0.5 / 4.25)


def test_places_that_are_looked_at_less_often_than_others_leave_a_doubt():
    """One of two places is seen in three of four pictures: the mean is off by a quarter of what they differ by."""
    uneven = seen([(1.0, 0.0), (1.0, 0.0), (1.0, 0.0), (5.0, 0.0)], places=[[0, 0, 0, 1]])
    assert measure._doubt_of_top(uneven, np.ones(1)) == pytest.approx(0.25 * 4 / 2)


def test_doubts_hold_for_pictures_that_are_drawn_anew():
    """Of 400 draws from places that differ, the true mean is off by two standard errors in about one of twenty."""
    rng, means = np.random.default_rng(5), np.array([1.0, 2.0, 4.0, 9.0])
    off = []
    for _ in range(400):
        at = [rng.permutation(np.repeat(np.arange(4), 3)).tolist()[:10] for _ in range(2)]
        errors = [[(float(means[p] * rng.gamma(4.0, 0.25)), 0.0) for p in of] for of in at]
        found = np.mean([[own for own, _ in of] for of in errors])
        doubt = measure._doubt_of_top(seen(*errors, places=at), np.full(2, 0.5))
        off.append(abs(found - means.mean()) > 2 * doubt * found)
    assert 0.02 < np.mean(off) < 0.1


@pytest.mark.parametrize(("rounds", "known"), [(1, False), (2, True)])
def test_one_picture_does_not_tell_its_doubt(small, rounds, known):
    package, sequence = small
    m, views = package.manifest, replace(ViewPlan.of(sequence, 24), small=False)
    m = replace(m, groups=Groups.of([replace(m.groups[0], segments=m.groups[0].segments[:1])]))

    def ask(asked):
        pictures = pictures_of(views, m, 0, asked, len(m.segments))
        return [measure_round(Package(package.files, m, 0), sequence, views.renderer, 0, pictures)]

    found = measure_groups(Quest(m, [0], views, Rounds(1).again(rounds), ask))
    assert found.pictures == rounds and math.isfinite(found.unsure) is known


def check_scaled(errors, m, counts):
    """Two levels in two key qualities, with so many pictures each; the first one of all has most."""
    assert m.views.measured == counts[0, 0]
    for (segment, level, key), of in errors.items():
        assert len(of) == counts[level, key]
        own, top = np.transpose(of)
        scale = np.mean(errors[segment, 0, 0]) / top.mean()
        table = m.segments[segment].levels[level]
        assert table.psnr[key] == round(psnr(scale * own.mean()), 2)
        assert table.worst[key] == round(psnr(scale * own.max()), 2)
