"""Steps and ladder of a scene, and when they are found anew."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from airgs_codec.encoder.calibrate import STEPS, Subject, balance, calibrate, solve_steps
from airgs_codec.encoder.pipeline import CALIBRATION

from tests import faces
from tests.faces import EncodeSettings, GaussianSequence, GroupSpan, StepSettings, ViewPlan, get_step, open_sequence
from tests.support.jobs import prepared_as_one_group
from tests.support.scenes import moving_frames, random_gaussians, write_demo, write_sequence

FAST = EncodeSettings(preset="veryfast", threads=2)
LARGEST = math.sqrt(51)  # a factor on a step: every step has 2 % of all bytes and error at least
MOTION = "means", "quaternions", "log_scales"


@pytest.fixture(scope="module")
def fox(tmp_path_factory):
    """A part of the embedded scene: its sequence, the survey of its only group, and its views."""
    sequence = open_sequence(write_demo(tmp_path_factory.mktemp("calibrate") / "fox", frames=4, rows=2500, scale=0.5))
    views = ViewPlan.of(sequence, 24)
    return sequence, faces.survey_group(sequence, GroupSpan(0, 0, 4), views), views


@pytest.fixture(scope="module")
def calibration(fox):
    return calibrate(*fox[:2], FAST)


def test_a_calibration_is_the_same_every_time_and_survives_the_cache(fox, calibration, tmp_path):
    sequence, survey, views = fox
    assert calibrate(sequence, survey, FAST) == calibration
    cache = faces.open_store(tmp_path / "cache")
    with faces.temporary_work() as work:
        prepared = prepared_as_one_group(sequence, views, work)
        job = prepared.job(CALIBRATION, 0, FAST)
        assert prepared.job(CALIBRATION, 0, replace(FAST, segment_s=0.5)).entry != job.entry
        cache.write(job.entry, faces.pack(calibration))
        assert work.cached(job, cache) == (calibration, True)
        assert work.cached(job, cache) == (calibration, False)  # the store of the work has it now


def test_a_calibration_is_found_anew_when_anything_that_it_reads_changes(tmp_path):
    folder, digests = write_sequence(tmp_path / "scene", moving_frames(30, 6)), []

    def digest():
        sequence = open_sequence(folder)
        with faces.temporary_work() as work:
            prepared = prepared_as_one_group(sequence, ViewPlan.of(sequence, 24), work)
            return prepared.job(CALIBRATION, 0, FAST).entry

    digests.append(digest())
    for number in (1, 2, 4):  # neither first, canonical nor last
        faces.write_ply(sorted(folder.glob("*.ply"))[number], random_gaussians(30, seed=number))
        digests.append(digest())
    for total in (np.ones(30), 2 * np.ones(30)):
        faces.save_usage(folder / faces.USAGE_NAME, {(0, 6): faces.Usage(total, np.ones(30), np.ones(30, np.int64))})
        digests.append(digest())
    assert len(set(digests)) == len(digests)
    assert digest() == digests[-1]


def test_steps_are_named_once_and_replaced_one_at_a_time():
    steps, names = StepSettings(), [*STEPS, "rows"]
    for name in names:
        changed = faces.with_step(steps, name, 7.0)
        assert {n: get_step(changed, n) for n in names} == {n: get_step(steps, n) for n in names} | {name: 7.0}


def test_a_step_far_from_its_price_comes_back(fox):
    """Means four times too fine or too coarse: calibration moves them the other way."""
    (sequence, survey, _), wanted = fox, []
    scaled = StepSettings().at_scale(survey.scale)
    for factor in (0.25, 1.0, 4.0):
        start = faces.with_step(scaled, "state.means", factor * scaled.state.means)
        subject = Subject.of(sequence, survey, replace(FAST, steps=start))
        sample = subject.sample(24.0)
        steps, price, saved = solve_steps(sample, subject)
        assert price > 0
        # what slopes foretell, and what two trials find, at errors that are not quite equal
        assert saved == pytest.approx(sample.cost(start).bytes - sample.cost(steps).bytes, rel=0.4)
        means, *others = (get_step(steps, f"state.{n}") / get_step(start, f"state.{n}") for n in MOTION)
        wanted.append(means / float(np.mean(others)))
    assert wanted[0] > 1.3 * wanted[1] > 1.3**2 * wanted[2]


def test_ladders_descend(calibration):
    levels, factors = calibration.levels, calibration.key_factors
    assert levels[0].factor == 1 and levels[0].quality == 0
    for above, below in itertools.pairwise(levels):
        assert above.pruned <= below.pruned and above.factor < below.factor
        assert above.tiers >= below.tiers > 0 and above.quality <= below.quality
    assert len(set(levels)) == len(levels) > 1
    assert factors[0] == 1 and all(a < b for a, b in itertools.pairwise(factors))
    assert len(factors) == levels[-1].quality + 1  # every key quality has its levels
    assert sum(calibration.tiers) == pytest.approx(1)
    settings = calibration.apply(FAST)
    assert [replace(level, pruned=0.0) for level in settings.levels] == list(levels)
    assert settings.steps == calibration.steps
    shares = [level.pruned for level in settings.levels]
    assert shares == sorted(shares) and [level.pruned for level in settings.at(0.1).levels] <= shares
    alone = calibration.apply(replace(FAST, calibrate="steps"))
    assert (alone.steps, alone.levels, alone.key_factors) == (calibration.steps, FAST.levels, FAST.key_factors)


def test_a_scene_that_stands_still_has_one_level():
    frame = random_gaussians(300)
    sequence = GaussianSequence.from_arrays([frame], cameras=faces.orbit_views(frame, count=4, size=64))
    found = calibrate(sequence, faces.survey_group(sequence, GroupSpan(0, 0, 1), ViewPlan.of(sequence, 24)), FAST)
    assert (found.levels, found.key_factors) == ((faces.LevelSettings(0.0),), (1.0,))
    assert found.steps.state == StepSettings().state


def slopes(errors):
    return {name: (1.0, error) for name, error in zip(STEPS, errors, strict=False)}


def test_steps_are_balanced_within_the_limit_and_stay_where_nothing_depends_on_them():
    factors, price = balance(slopes([3.0] * 6))
    assert list(factors.values()) == pytest.approx([1.0] * 6)  # equal slopes change nothing
    assert price == pytest.approx(2 * 3.0)
    factors, _ = balance({"state.means": (1.0, 0.0), "state.opacity": (0.0, 1.0)})
    assert factors == {"state.means": pytest.approx(LARGEST), "state.opacity": pytest.approx(1 / LARGEST)}
    for nothing in ({"grid": (0.0, 1.0)}, {"grid": (1.0, 0.0)}, {"grid": (-1.0, -1.0)}, {}):
        assert balance(nothing) == ({}, 0.0), nothing


def test_slopes_over_many_decades_keep_within_the_limit_and_in_order_and_are_refused_where_not_finite():
    for decades in (12, 300):
        factors = list(balance(slopes([10.0 ** (-decades * i / 11) for i in range(12)]))[0].values())
        assert factors == sorted(factors)
        assert 1 / LARGEST <= factors[0] < 1 < factors[-1] <= LARGEST
    for slope in ((math.nan, 1.0), (1.0, math.inf), (1.0, math.nan)):
        with pytest.raises(faces.SceneError, match=r"finite bytes and errors of grid, got"):
            balance({"state.means": (1.0, 1.0), "grid": slope})
