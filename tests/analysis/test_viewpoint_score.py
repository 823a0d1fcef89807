"""A picture of small flat Gaussians without holes scores; a few rows stand for all."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.floor import find_floor
from airgs_codec.analysis.viewpoint_score import Look, Sample
from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import look_at
from tests.support.places import ball, filmed_room, floor, needles
from tests.support.scenes import random_gaussians
from tests.support.views import joined


def camera(position, target):
    up = np.array([0.0, -1.0, 0.0])
    return look_at(np.array(position), np.array(target), up, size=32, fov_y=1.0, name="test")


def test_the_filmed_side_scores_and_needles_do_not():
    sample = Sample.of(filmed_room(), 4000)
    front, aside = sample.look(camera([0, 0, 0.0], [0, 0, 4.0])), sample.look(camera([0, 0, 0.0], [-4, 0, 0.0]))
    assert front.score > 0.05 and aside.score < 0.2 * front.score


def test_holes_and_splintered_depth_lower_a_score():
    whole = Look(0.5, 1.0, 0.05, 3.0)
    assert replace(whole, covered=0.7).score < 0.5 * whole.score
    assert replace(whole, rough=0.25).score < 0.5 * whole.score


def test_a_few_rows_stand_for_all():
    g, view = filmed_room(), camera([0.5, 0, 0.0], [0, 0, 4.0])
    full, part = (Sample.of(g, rows).look(view) for rows in (len(g), 4000))
    assert part.covered == pytest.approx(full.covered, abs=0.05)
    assert part.score == pytest.approx(full.score, rel=0.2)
    assert part.distance == pytest.approx(full.distance, rel=0.1)
    assert len(Sample.of(g, 2000).flatness) == pytest.approx(2000, rel=0.1)


def test_the_distance_is_that_of_what_is_seen():
    assert Sample.of(ball(), 1000).look(camera([0, 0, -5.0], [0, 0, 0.0])).distance == pytest.approx(5, rel=0.05)


def test_objects_are_solid_and_needles_are_not():
    view = camera([0, 0, -2.0], [0, 0, 0.0])
    assert Sample.of(ball(), 3000).solidity(view) > 0.6
    assert Sample.of(needles(), 3000).solidity(view) < 0.4


def test_a_look_away_from_everything_is_nothing():
    assert Sample.of(ball(), 1000).look(camera([0, 0, -5.0], [0, 0, -9.0])).score == 0


def test_what_cannot_be_seen_has_no_sample():
    g = random_gaussians(5)
    with pytest.raises(SceneError, match="opacity"):
        Sample.of(replace(g, opacity_logits=np.full(5, -20, np.float32)), 10)


def test_a_floor_has_everything_on_one_side():
    up = find_floor(joined(ball(), floor(-0.55)))
    assert up is not None and up @ [0, 1, 0] > 0.99
    assert find_floor(ball()) is None
    assert find_floor(joined(ball(), floor(0.0))) is None, "as much below as above"
