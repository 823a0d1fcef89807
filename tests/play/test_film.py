"""A viewer's walk: by all places of a region and back, without a jump, and never through what he looks at."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.play.film import MOST_PIXELS, STEP_S, walk, walk_through
from tests.faces import Offers, SessionSettings, Trace, simulate
from tests.support.manifests import tiny_manifest
from tests.support.regions import arc, row


def positions(walk):
    return np.array([camera.position for camera in walk])


@pytest.mark.parametrize(
    ("some", "steps"),
    [(arc(315, 8, 1.2), 14), (arc(180, 2, 0.0), 2), (row(6, 0.7), 10)],
    ids=["ring", "opposite", "row"],
)
def test_a_walk_comes_by_all_places_without_a_jump_and_begins_again(some, steps):
    views = walk_through(some, np.linspace(0, STEP_S * steps, 2001))
    assert np.linalg.norm(np.diff(positions(views), axis=0), axis=1).max() < 0.03
    for place in some.places:
        assert np.linalg.norm(positions(views) - place.position, axis=1).min() < 0.01
    np.testing.assert_allclose(views[-1].world_to_camera, views[0].world_to_camera, atol=1e-9)


@pytest.mark.parametrize("degrees", [315, 180])
def test_nobody_walks_through_what_he_looks_at(degrees):
    for count in (2, 7):
        views = walk_through(arc(degrees, count, 0.1), np.linspace(0, 2 * STEP_S * count, 500))
        np.testing.assert_allclose(np.linalg.norm(positions(views), axis=1), 3, atol=1e-9)
        towards = np.array([camera.world_to_camera[2, :3] for camera in views])
        np.testing.assert_allclose(towards, -positions(views) / 3, atol=1e-9)


@pytest.mark.parametrize("reach", [0.0, 1.0])
def test_about_one_place_he_goes_in_a_circle_of_half_its_reach(reach):
    some = row(1, reach)
    views = walk_through(some, np.linspace(0, 8 * STEP_S, 100))
    away = np.linalg.norm(positions(views) - some.places[0].position, axis=1)
    assert away.max() == pytest.approx(0.5 * reach) and away.min() >= 0.4 * reach


def test_a_session_has_a_picture_for_every_tick_and_they_have_a_bound():
    for size, shown in (((32, 24), (32, 24)), ((1500, 3000), (MOST_PIXELS // 2, MOST_PIXELS))):
        m = replace(tiny_manifest(), region=replace(row(1, 1.0), width=size[0], height=size[1]))
        log = simulate(Offers(m, 0, 1000), Trace.open("const:9"), "fixed:0", SessionSettings(loops=2))
        views = walk(log)
        assert len(views) == len(log.screen_ticks) == 40 and {(v.width, v.height) for v in views} == {shown}
