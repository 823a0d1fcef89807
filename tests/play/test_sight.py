"""What is in sight, and what is expected to be."""

import numpy as np
import pytest
from airgs_codec.play.sight import BEFORE_S, DECAY_S, Boxes, Velocity, expected

from airgs_codec.scene.camera import look_at
from tests.support.tiled import Turning, tiled_manifest

UP = np.array([0.0, 1, 0])


def towards(degrees, position=(0.0, 0.0, 0.0)):
    """A camera of 90 degrees."""
    ahead = np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])
    place = np.array(position)
    return look_at(place, place + ahead, UP, size=64, fov_y=np.pi / 2, name="")


def heading(camera):
    x, _, z = camera.world_to_camera[2, :3]
    return float(np.degrees(np.arctan2(x, z)))


def test_a_margin_widens_what_is_in_sight():
    """A camera of 90 degrees, and a box 60 degrees off its axis."""
    middle = np.array([np.sin(np.radians(60)), 0.0, np.cos(np.radians(60))])
    box = Boxes.of([(middle - 0.01, middle + 0.01)])
    camera = towards(0)
    assert [bool(box.in_sight(camera, margin)[0]) for margin in (0.0, 10.0, 20.0)] == [False, False, True]
    assert box.degrees_off(camera)[0] == pytest.approx(15, abs=1)


def test_what_is_behind_is_further_off_than_what_is_beside():
    off = Boxes.of_tiles(tiled_manifest(4).groups[0].tiles).degrees_off(towards(0))
    assert off[0] < 0 < off[1] < off[2] and off[1] == pytest.approx(off[3])


def test_above_counts_as_beside_does():
    box = Boxes.of([((-0.01, np.tan(np.radians(60)), 0.99), (0.01, np.tan(np.radians(60)) + 0.01, 1.01))])
    assert box.degrees_off(towards(0))[0] == pytest.approx(15, abs=1)


def test_a_tile_without_rows_is_nowhere():
    boxes = Boxes.of_tiles(tiled_manifest(4, empty=[0, 2]).groups[0].tiles)
    assert boxes.has_rows.tolist() == [False, True, False, True]
    assert np.isinf(boxes.degrees_off(towards(0))[[0, 2]]).all()
    assert not boxes.in_sight(towards(0), 1000.0)[0]


def test_a_viewer_is_expected_to_go_on_turning_for_a_while():
    velocity = Velocity.between(towards(0), towards(4))
    assert heading(expected(towards(4), velocity, 0.0)) == pytest.approx(4)
    soon, later = (heading(expected(towards(4), velocity, ahead)) for ahead in (0.1, 100.0))
    assert soon == pytest.approx(4 + 40 * DECAY_S * (1 - np.exp(-0.1 / DECAY_S)))
    assert later == pytest.approx(4 + 40 * DECAY_S)
    rotation = expected(towards(4), velocity, 9.0).world_to_camera[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3))


def test_a_viewer_is_expected_to_go_on_walking_for_a_while():
    velocity = Velocity.between(towards(0), towards(0, (0.1, 0.0, 0.0)))
    assert np.allclose(velocity.shift, [0.1 / BEFORE_S, 0, 0]) and np.allclose(velocity.turn, 0)
    assert np.allclose(expected(towards(0, (0.1, 0.0, 0.0)), velocity, 100.0).position, [0.1 + DECAY_S, 0, 0])


def test_who_stands_still_is_expected_to():
    view = Turning()
    velocity = Velocity.between(view.at(0.0), view.at(1.0))
    assert np.allclose(expected(view.at(1.0), velocity, 1.0).world_to_camera, view.at(0.0).world_to_camera)
