"""What is measured of every rung, with how many pictures, and how sure that is."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder.measure import ERROR_DB, FIRST, Seen, measure, say_useless, with_quality
from tests import faces
from tests.faces import Difference, EncodeSettings, GaussianSequence, encode, open_package, orbit_views, psnr
from tests.support.packages import TWO_LEVELS
from tests.support.scenes import moving_frames

RUNGS = [(0, 0), (0, 1), (1, 0), (1, 1)]  # level, keyframe quality
MOST = 64  # pictures


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A package of two segments of three frames, L0 with Q0 and L1 with Q1, not measured, and what pictures show."""
    folder, frames = tmp_path_factory.mktemp("quality") / "out", moving_frames(80, 6)
    sequence = GaussianSequence.from_arrays(frames, cameras=orbit_views(frames[0], count=4, size=64))
    quick = {"calibrate": "none", "measure_pictures": 0, "preset": "ultrafast"}
    report = encode(sequence, folder, EncodeSettings(levels=TWO_LEVELS, segment_s=0.1, **quick))
    opened = open_package(folder)
    assert not opened.manifest.rungs and not opened.manifest.segments[0].levels[0].psnr
    return opened.manifest, measure(opened, sequence, report.plan.views, faces.CPU, MOST, range(2))


def test_every_rung_is_measured_in_the_first_pictures_of_the_top_one_from_all_segments(package):
    m, seen = package
    counts = {rung: len(seen.differences[rung]) for rung in RUNGS}
    assert FIRST <= min(counts.values()) <= max(counts.values()) == counts[0, 0] == len(seen.segments) <= MOST
    assert counts[0, 1] == counts[1, 0] == FIRST  # what viewers only have while they change
    halves = [seen.segments[:FIRST].count(segment) for segment in (0, 1)]
    assert halves == [FIRST / 2] * 2
    measured = with_quality(m, [seen])
    assert measured.views.measured == counts[0, 0]
    for level, quality in RUNGS:
        rung, own = measured.rungs[quality][level], seen.differences[level, quality]
        top = np.array([one.mse for one in seen.differences[0, 0]])
        ratio = np.mean([one.mse for one in own]) / top[: len(own)].mean()
        assert rung.psnr == round(psnr(ratio * top.mean()), 2) and rung.pictures == len(own)
        assert rung.low == round(float(np.quantile([psnr(one.mse) for one in own], 0.05)), 1) < rung.psnr
        assert rung.ssim == pytest.approx(np.mean([one.ssim for one in own[:FIRST]]), abs=1e-4)
        sure = math.hypot(measured.rungs[0][0].error, max(ERROR_DB, measured.rungs[0][0].error / 2))
        assert rung.error <= 1.5 * sure or rung.pictures in (FIRST, MOST)
        for number, segment in enumerate(measured.segments):
            there = top[np.array(seen.segments) == number].mean()
            assert segment.levels[level].psnr[quality] == round(psnr(ratio * there), 2)


def test_levels_and_keyframe_qualities_that_show_less_than_cheaper_ones_are_named(package):
    m, seen = package
    assert say_useless(with_quality(m, [seen])).decisions == m.decisions
    worse = {rung: seen.differences[rung] for rung in RUNGS} | {(1, 1): [Difference(1e-9, 1.0, 0.0)] * FIRST}
    found = say_useless(with_quality(m, [Seen(seen.segments, worse)])).decisions[len(m.decisions) :]
    said = [re.sub(r" shows \d.* less than (.*), which.*", r" below \1", line) for line in found]
    assert said == ["Q0+L1 below Q1+L1", "Q1+L0 below Q1+L1"]


@pytest.mark.parametrize(("name", "asked"), [("fox", 8), ("paper", 1)])
def test_an_encode_has_as_many_pictures_as_were_asked_for(package_of, name, asked):
    m = open_package(package_of(name)).manifest
    assert m.views.measured == asked == max(rung.pictures for of_quality in m.rungs for rung in of_quality)


def rungs_of(m, top, other):
    """The rungs L0 and L1 with Q0, of which pictures of the first segment have shown these squared errors."""
    named = {rung: [Difference(e, 1.0, 0.0) for e in (other if rung == (1, 0) else top)] for rung in RUNGS}
    return with_quality(m, [Seen([0] * len(top), named)]).rungs[0]


def test_a_claim_is_as_sure_as_its_pictures_agree(package):
    """Two standard errors hold for most draws of pictures, whose errors are heavy-tailed: here, log-normal."""
    m, rng, inside = package[0], np.random.default_rng(0), 0
    assert [rung.error for rung in rungs_of(m, [2e-4] * 4, [3e-4] * 4)] == [0.0, 0.0]
    spread = 10 * math.log10(1 + (4 / 3 / 4) ** 0.5 / 2)  # four pictures, each 1e-4 off their mean of 2e-4
    first, second = rungs_of(m, [1e-4, 3e-4] * 2, [2e-4, 6e-4] * 2)
    assert first.error == second.error == pytest.approx(spread, abs=1e-3)  # the second has twice the error in all
    assert rungs_of(m, [1e-4, 3e-4] * 2, [2e-4, 2e-4] * 2)[1].error > first.error
    for _ in range(400):
        errors = 1e-4 * rng.lognormal(sigma=0.7, size=32)
        top, _ = rungs_of(m, errors.tolist(), errors.tolist())
        sure = 2 * (10 ** (top.error / 10) - 1)
        inside += abs(errors.mean() / (1e-4 * math.exp(0.7**2 / 2)) - 1) <= sure
    assert 0.88 <= inside / 400 <= 0.98


def test_where_views_were_guessed_the_harder_half_tells_the_psnr_and_pictures_of_nothing_tell_nothing(package):
    m = package[0]
    guessed = replace(m, region=replace(m.region, source="found"))
    for of, claimed in ((m, 2e-4), (guessed, 3e-4)):
        assert rungs_of(of, [1e-4, 3e-4] * 2, [1e-4, 3e-4] * 2)[0].psnr == round(psnr(claimed), 2)
    named = {rung: [Difference(0.0, 1.0, 0.0, True), Difference(1e-4, 1.0, 0.0)] for rung in RUNGS}
    assert with_quality(m, [Seen([0, 0], named)]).rungs[0][0].psnr == 40.0
