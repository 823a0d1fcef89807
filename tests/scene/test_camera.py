"""Cameras: the convention, what files hold, who may be looked at and who is measured on."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import look_at, training_views
from airgs_codec.scene.cameras.read import read_cameras
from tests.support.multiview_files import matrix_of
from tests.support.paths import FOX
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


def test_cameras_come_back_from_a_file_once_each(tmp_path):
    views = ring(3)
    frames = [entry(v, camera=v.name, time_index=t, near=0.2) for t in range(2) for v in views]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    back = read_cameras(tmp_path / "transforms.json")
    assert [c.name for c in back] == [v.name for v in views] and {c.near for c in back} == {0.2}
    for a, b in zip(back, views, strict=True):
        np.testing.assert_allclose(a.world_to_camera, b.world_to_camera, atol=1e-12)


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


def test_the_cameras_of_the_embedded_scene():
    assert len(training_views(read_cameras(FOX / "transforms.json"))) < 20
