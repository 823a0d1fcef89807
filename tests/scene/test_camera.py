"""Cameras: the convention, what files hold, who may be looked at and who is measured on; made ones see the scene."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.scene.camera import dome_views
from tests.faces import Gaussians, SceneError, look_at, orbit_views, read_cameras, render, training_views
from tests.support.multiview_files import matrix_of
from tests.support.scenes import random_gaussians
from tests.support.views import ring


def test_what_a_camera_looks_at_is_in_the_middle_and_up_is_up():
    view = look_at(np.array([3.0, 1, -2]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0]), size=64, fov_y=0.8, name="a")
    x, y, z = view.world_to_camera[:3, :3] @ [0, 0, 1] + view.world_to_camera[:3, 3]
    assert (x, y) == pytest.approx((0, 0)) and z == pytest.approx(np.linalg.norm([3, 1, -3]))
    assert (view.world_to_camera[:3, :3] @ [0, 1, 0])[1] < 0  # y of a picture points down
    np.testing.assert_allclose(view.position, [3, 1, -2])
    assert np.linalg.det(view.world_to_camera[:3, :3]) == pytest.approx(1)


def test_a_camera_that_looks_along_up_is_finite():
    view = look_at(np.zeros(3), np.array([0, 2.0, 0]), np.array([0, 1.0, 0]), size=8, fov_y=1.0, name="a")
    assert np.isfinite(view.world_to_camera).all()


def entry(view, **fields):
    intrinsics = {"w": view.width, "h": view.height, "fl_x": view.fx, "fl_y": view.fy, "cx": view.cx, "cy": view.cy}
    return {"transform_matrix": matrix_of(view), **intrinsics, **fields}


@pytest.mark.parametrize(
    "fields",
    [
        {"w": 0},
        {"near": 0},
        {"near": float("inf")},
        {"transform_matrix": [[1]]},
        {"fl_x": None},
        {"transform_matrix": np.zeros((4, 4)).tolist()},
        {"transform_matrix": np.full((4, 4), np.nan).tolist()},
    ],
)
def test_an_entry_that_describes_no_camera_is_refused(tmp_path, fields):
    (tmp_path / "t.json").write_text(json.dumps({"frames": [entry(ring(1)[0], **fields)]}))
    with pytest.raises(SceneError, match=r"t\.json: expected a nerfstudio"):
        read_cameras(tmp_path / "t.json")


def test_held_out_cameras_are_never_trained_on():
    views = ring(8, held_out=2)
    assert training_views(views) == views[:6]
    for split, held_out in (("train", False), ("test", True)):  # where there is no choice, all are trained on
        alike = [replace(v, split=split) for v in views]
        assert {v.held_out for v in alike} == {held_out} and training_views(alike) == alike


def test_generated_views_see_the_scene():
    g = random_gaussians(400)
    for view in orbit_views(g, 4, 64):
        covered = (render(g, view).transmittance < 0.9).mean()
        assert 0.1 < covered < 0.95


def test_generated_views_of_one_gaussian_far_from_the_origin_are_finite():
    g = random_gaussians(1)
    far = Gaussians(g.means + np.float32(1e6), *(getattr(g, n) for n in g.__slots__[1:]))
    assert all(np.isfinite(v.world_to_camera).all() for v in orbit_views(far, 3))


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 2)])
def test_a_ring_is_above_the_horizon_and_upright(up):
    axis = np.array(up, float) / np.linalg.norm(up)
    for view in orbit_views(random_gaussians(50), 6, 32, np.array(up, float)):
        assert -view.world_to_camera[2, :3] @ axis >= np.sin(np.radians(9)) and view.world_to_camera[1, :3] @ axis < 0


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 2), (1, -1, 0.5)])
def test_a_dome_is_above_its_horizon_and_all_around(up):
    axis = np.array(up, float) / np.linalg.norm(up)
    views = dome_views(random_gaussians(50), 20, 64, np.array(up, float), (0.2, 0.9))
    sides = np.stack([-v.world_to_camera[2, :3] for v in views])
    assert np.sin(0.2) <= (sides @ axis).min() < 0.3 and 0.7 < (sides @ axis).max() <= np.sin(0.9)
    assert np.linalg.norm((sides - np.outer(sides @ axis, axis)).mean(axis=0)) < 0.1, "as much on every side"
    assert all(v.world_to_camera[1, :3] @ axis <= 0 for v in views), "up is up in the pictures"


def test_a_whole_sphere_has_no_side_that_is_not_seen():
    sides = np.stack(
        [-v.world_to_camera[2, :3] for v in dome_views(random_gaussians(50), 12, 64, np.array([0, 1.0, 0]))]
    )
    assert (np.eye(3) @ sides.T).max(axis=1).min() > 0.8 and (np.eye(3) @ sides.T).min(axis=1).max() < -0.8
