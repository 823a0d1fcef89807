"""Steps and ladder of a scene."""

import itertools
import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from airgs_codec.encoder.steps import STEP_CHANNELS, TrialGroup, balance, find_steps, solve_steps
from tests import faces
from tests.faces import EncodeSettings, GaussianSequence, LevelSettings, StepSettings, get_step, open_sequence
from tests.support.scenes import random_gaussians, write_demo

FAST = EncodeSettings(preset="veryfast", threads=2)
LARGEST = math.sqrt(51)  # a factor on a step: every step has 2 % of all bytes and error at least
MOTION = "means", "quaternions", "log_scales"


@pytest.fixture(scope="module")
def fox(tmp_path_factory):
    """A part of the embedded scene: its frames, what is known of them, its views and settings at its scale."""
    sequence = open_sequence(write_demo(tmp_path_factory.mktemp("steps") / "fox", frames=4, rows=2500, scale=0.5))
    views, frames = faces.choose_views(sequence, FAST)[0], faces.Frames(sequence, 0, ((0, 4),))
    scaled = replace(FAST, steps=FAST.steps.at_scale(views.scale))
    return frames, faces.Survey.of(frames, views, faces.CPU), views, scaled


def test_steps_are_named_once_and_replaced_one_at_a_time():
    steps, names = StepSettings(), [*STEP_CHANNELS, "rows"]
    for name in names:
        changed = faces.with_step(steps, name, 7.0)
        assert {n: get_step(changed, n) for n in names} == {n: get_step(steps, n) for n in names} | {name: 7.0}


def test_a_step_far_from_its_price_comes_back(fox):
    """Means four times too fine or too coarse: they move the other way."""
    (*given, settings), wanted = fox, []
    for factor in (0.25, 1.0, 4.0):
        start = faces.with_step(settings.steps, "delta.means", factor * settings.steps.delta.means)
        subject = TrialGroup.of(*given, replace(settings, steps=start))
        sample = subject.sample(24.0)
        steps, price, saved = solve_steps(sample, subject)
        assert price > 0
        # what slopes foretell, and what two trials find, at errors that are not quite equal
        assert saved == pytest.approx(sample.cost(start).bytes - sample.cost(steps).bytes, rel=0.4)
        means, *others = (get_step(steps, f"delta.{n}") / get_step(start, f"delta.{n}") for n in MOTION)
        wanted.append(means / float(np.mean(others)))
    assert wanted[0] > 1.3 * wanted[1] > 1.3**2 * wanted[2]


def test_ladders_descend_and_are_the_same_every_time(fox):
    found = find_steps(*fox)
    settings = found.settings
    levels, factors, shares = settings.levels, settings.keyframe_factors, [level.pruned for level in settings.levels]
    assert find_steps(*fox) == found and settings.calibrate == "none"
    assert levels[0].factor == 1 and levels[0].quality == 0
    for above, below in itertools.pairwise(levels):
        assert above.pruned <= below.pruned and above.factor < below.factor
        assert above.tiers >= below.tiers > 0 and above.quality <= below.quality
    assert len(set(levels)) == len(levels) > 1
    assert factors[0] == 1 and all(a < b for a, b in itertools.pairwise(factors))
    assert len(factors) == levels[-1].quality + 1  # every keyframe quality has its levels
    assert sum(settings.tiers) == pytest.approx(1)
    assert shares == sorted(shares) and [level.pruned for level in settings.at(0.1).levels] <= shares
    alone = find_steps(*fox[:3], replace(fox[3], calibrate="steps")).settings
    assert alone.steps != FAST.steps and (alone.levels, alone.keyframe_factors) == (FAST.levels, FAST.keyframe_factors)


def test_a_scene_that_stands_still_has_one_level():
    frame = random_gaussians(300)
    plan = faces.decide(GaussianSequence.from_arrays([frame], cameras=faces.orbit_views(frame, count=4, size=64)), FAST)
    assert (plan.settings.levels, plan.settings.keyframe_factors) == ((LevelSettings(0.0),), (1.0,))
    deltas = (astuple(steps.delta) for steps in (plan.settings.steps, FAST.steps.at_scale(plan.views.scale)))
    assert next(deltas) == pytest.approx(next(deltas), rel=1e-8)  # steps have nine digits


def slopes(errors):
    return {name: (1.0, error) for name, error in zip(STEP_CHANNELS, errors, strict=False)}


def test_steps_are_balanced_within_the_limit_and_stay_where_nothing_depends_on_them():
    factors, price = balance(slopes([3.0] * 6))
    assert list(factors.values()) == pytest.approx([1.0] * 6)  # equal slopes change nothing
    assert price == pytest.approx(2 * 3.0)
    factors, _ = balance({"delta.means": (1.0, 0.0), "delta.opacity": (0.0, 1.0)})
    assert factors == {"delta.means": pytest.approx(LARGEST), "delta.opacity": pytest.approx(1 / LARGEST)}
    for nothing in ({"grid": (0.0, 1.0)}, {"grid": (1.0, 0.0)}, {"grid": (-1.0, -1.0)}, {}):
        assert balance(nothing) == ({}, 0.0), nothing


def test_slopes_over_many_decades_keep_within_the_limit_and_in_order_and_are_refused_where_not_finite():
    for decades in (12, 300):
        factors = list(balance(slopes([10.0 ** (-decades * i / 11) for i in range(12)]))[0].values())
        assert factors == sorted(factors)
        assert 1 / LARGEST <= factors[0] < 1 < factors[-1] <= LARGEST
    for slope in ((math.nan, 1.0), (1.0, math.inf), (1.0, math.nan)):
        with pytest.raises(faces.SceneError, match=r"finite bytes and errors of grid, got"):
            balance({"delta.means": (1.0, 1.0), "grid": slope})
