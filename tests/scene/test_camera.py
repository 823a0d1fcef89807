"""Cameras that callers make, who may be looked at and who is measured on; made ones see the scene."""

from dataclasses import replace

import numpy as np
import pytest

from tests.faces import AirgsError, Camera, dome_views, look_at, orbit_views, render, training_views
from tests.support.scenes import random_gaussians
from tests.support.views import ring

EYE = np.eye(4)


def test_a_camera_sees_its_target_in_the_middle_and_up_is_up():
    camera = Camera.look_at((3, 1, -2), (0, 1, 4), (0, 1, 0), size=(200, 100), fov_y=60)
    inside = camera.world_to_camera @ [[0, 3], [1, 1.5], [4, -2], [1, 1]]
    x, y, z = inside[:3, 0]
    assert (camera.width, camera.height, camera.cx, camera.cy) == (200, 100, 100, 50)
    assert abs(x) < 1e-9 and abs(y) < 1e-9 and z == pytest.approx(45**0.5)
    assert inside[1, 1] < 0, "y is down in OpenCV's axes"
    assert np.isclose(2 * np.degrees(np.arctan(50 / camera.fy)), 60) and camera.fx == camera.fy
    assert np.allclose(camera.position, (3, 1, -2)) and np.isclose(np.linalg.det(camera.world_to_camera[:3, :3]), 1)
    view = look_at(np.zeros(3), np.array([0, 2.0, 0]), np.array([0, 1.0, 0]), size=64, fov_y=0.8, name="along up")
    assert np.isfinite(view.world_to_camera).all() and (view.width, view.height, view.cx, view.cy) == (64, 64, 32, 32)
    assert 2 * np.arctan(32 / view.fx) == pytest.approx(0.8) and view.fx == view.fy


def test_a_camera_is_made_of_either_matrix_and_of_either_lens():
    seen = Camera.look_at((3, 1, -2), (0, 1, 4), size=(200, 100), fov_y=60)
    pose = np.linalg.inv(seen.world_to_camera)
    lens = [[seen.fx, 0, 100], [0, seen.fy, 50], [0, 0, 1]]
    for matrix in ({"camera_to_world": pose}, {"world_to_camera": seen.world_to_camera[:3].tolist()}):
        for kind in ({"fov_y": 60}, {"intrinsics": lens}):
            made = Camera.from_matrix(**matrix, **kind, size=(200, 100), name=seen.name)
            assert np.allclose(made.world_to_camera, seen.world_to_camera)
            assert (made.width, made.height) == (200, 100)
            assert np.allclose((made.fx, made.fy, made.cx, made.cy), (seen.fx, seen.fy, 100, 50))


NONE = [
    ({}, "expected camera_to_world or world_to_camera"),
    ({"camera_to_world": EYE, "world_to_camera": EYE, "fov_y": 50}, "got both or none"),
    ({"camera_to_world": EYE}, "fov_y or intrinsics"),
    ({"camera_to_world": 2 * EYE, "fov_y": 50}, "not a rotation"),
    ({"camera_to_world": 0 * EYE, "fov_y": 50}, "camera_to_world"),
    ({"world_to_camera": np.eye(3), "fov_y": 50}, "world_to_camera: expected finite numbers of shape"),
    ({"world_to_camera": EYE * np.nan, "fov_y": 50}, "world_to_camera: expected finite"),
    ({"world_to_camera": EYE, "fov_y": 180}, "focal lengths"),
    ({"world_to_camera": EYE, "fov_y": "wide"}, "fov_y: expected finite numbers"),
    ({"world_to_camera": EYE, "fov_y": 50, "size": (0, 10)}, "has size 0x10"),
    ({"world_to_camera": EYE, "fov_y": 50, "size": 64}, "size: expected finite numbers of shape"),
]
AIM = {"position": (1, 1, 1), "target": (0, 0, 0), "size": (64, 64)}
NOWHERE = [{"target": (1, 1, 1)}, {"up": (0, 0, 0)}, {"target": (1, 2)}, {"target": (0, 0, np.inf)}, {"fov_y": 0}]


@pytest.mark.parametrize(
    ("make", "given", "line"),
    [(Camera.from_matrix, {"size": (64, 64)} | more, line) for more, line in NONE]
    + [(Camera.look_at, AIM | more, None) for more in NOWHERE],
)
def test_a_camera_that_is_none_or_looks_nowhere_is_refused(make, given, line):
    with pytest.raises(AirgsError, match=line) as caught:
        make(**given)
    assert "\n" not in str(caught.value)


def test_held_out_cameras_are_never_trained_on():
    views = ring(8, held_out=2)
    assert training_views(views) == views[:6]
    for split, held_out in (("train", False), ("test", True)):  # where there is no choice, all are trained on
        alike = [replace(v, split=split) for v in views]
        assert {v.held_out for v in alike} == {held_out} and training_views(alike) == alike


def test_generated_views_see_the_scene_and_are_finite_of_one_gaussian_far_from_the_origin():
    g = random_gaussians(400)
    for view in orbit_views(g, 4, 64):
        assert 0.1 < (render(g, view).transmittance < 0.9).mean() < 0.95
    g = random_gaussians(1)
    for view in orbit_views(replace(g, means=g.means + np.float32(1e6)), 3):
        assert np.isfinite(view.world_to_camera).all()


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 2), (1, -1, 0.5)])
def test_a_ring_and_a_dome_are_above_the_horizon_and_upright_and_all_around(up):
    g, along, axis = random_gaussians(50), np.array(up, float), np.array(up, float) / np.linalg.norm(up)
    for view in orbit_views(g, 6, 32, along):
        assert -view.world_to_camera[2, :3] @ axis >= np.sin(np.radians(9)) and view.world_to_camera[1, :3] @ axis < 0
    views = dome_views(g, 20, 64, along, (0.2, 0.9))
    sides = np.stack([-v.world_to_camera[2, :3] for v in views])
    assert np.sin(0.2) <= (sides @ axis).min() < 0.3 and 0.7 < (sides @ axis).max() <= np.sin(0.9)
    assert np.linalg.norm((sides - np.outer(sides @ axis, axis)).mean(axis=0)) < 0.1, "as much on every side"
    assert all(v.world_to_camera[1, :3] @ axis <= 0 for v in views), "up is up in the pictures"


def test_a_whole_sphere_has_no_side_that_is_not_seen():
    views = dome_views(random_gaussians(50), 12, 64, np.array([0, 1.0, 0]))
    sides = np.stack([-v.world_to_camera[2, :3] for v in views])
    assert sides.max(axis=0).min() > 0.8 and sides.min(axis=0).max() < -0.8
