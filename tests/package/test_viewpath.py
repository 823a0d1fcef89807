"""A viewer's walk: by all places of a region and back, without a jump, and never through what he looks at."""

import numpy as np
import pytest

from airgs_codec.package.viewpath import STEP_S, path_of_region
from tests.support.regions import arc, region, row


def positions(walk):
    return np.array([camera.position for camera in walk])


@pytest.mark.parametrize("some", [arc(315, 8, 1.2), arc(180, 2, 0.0), row(6, 0.7)], ids=["ring", "opposite", "row"])
def test_a_walk_comes_by_all_places_without_a_jump_and_begins_again(some):
    path = path_of_region(some)
    seconds = STEP_S * (len(path.stops) - 1)
    walk = positions(path.cameras(np.linspace(0, seconds, 2001)))
    steps = np.linalg.norm(np.diff(walk, axis=0), axis=1)
    assert steps.max() < 0.03 and walk[-1] == pytest.approx(walk[0])
    for place in some.places:
        assert np.linalg.norm(walk - place.position, axis=1).min() < 0.01
    again, once = path.cameras(np.array([seconds + 0.3, 0.3]))
    np.testing.assert_allclose(again.world_to_camera, once.world_to_camera, atol=1e-9)


@pytest.mark.parametrize("degrees", [315, 180])
def test_nobody_walks_through_what_he_looks_at(degrees):
    for count in (2, 7):
        path = path_of_region(arc(degrees, count, 0.1))
        walk = path.cameras(np.linspace(0, STEP_S * len(path.stops), 500))
        np.testing.assert_allclose(np.linalg.norm(positions(walk), axis=1), 3, atol=1e-9)
        towards = np.array([camera.world_to_camera[2, :3] for camera in walk])
        np.testing.assert_allclose(towards, -positions(walk) / 3, atol=1e-9)


@pytest.mark.parametrize("reach", [0.0, 1.0])
def test_about_one_place_he_goes_in_a_circle_of_half_its_reach(reach):
    some = row(1, reach)
    walk = positions(path_of_region(some).cameras(np.linspace(0, 8 * STEP_S, 100)))
    away = np.linalg.norm(walk - some.places[0].position, axis=1)
    assert away.max() == pytest.approx(0.5 * reach) and away.min() >= 0.4 * reach


def test_pictures_are_those_of_the_region():
    camera = path_of_region(region()).at(1.0)
    assert (camera.width, camera.height, camera.near) == (32, 24, 0.01)
