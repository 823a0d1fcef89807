"""Rays that intersect, and tracks of real pictures."""

import numpy as np
import pytest

from airgs_codec.render import Camera
from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.fit.triangulate import intersect, triangulate
from tests.support.paths import FOX_VIEWS
from tests.support.views import ring


def pixel(camera: Camera, point: np.ndarray) -> np.ndarray:
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


def test_rays_intersect_at_the_point_they_come_from():
    point = np.array([0.3, -0.2, 0.1])
    cameras = ring(4)[:3]
    places = np.stack([pixel(c, point) for c in cameras])
    assert intersect(cameras, places) == pytest.approx(point, abs=1e-9)
    wrong = places + np.array([[0, 0], [9, 0], [0, 9]])
    assert intersect(cameras, wrong) is None
    assert intersect([cameras[0], cameras[0]], places[[0, 0]]) is None  # parallel
    behind = 2 * cameras[0].position
    assert intersect(cameras, np.stack([pixel(c, behind) for c in cameras])) is None


def test_tracks_of_real_pictures_lie_on_the_scene():
    views = Pictures(open_scene(FOX_VIEWS)).train(0)
    points = triangulate(views)
    given = np.load(FOX_VIEWS / "points3d.npy")
    assert len(points.positions) > 50
    nearest = np.linalg.norm(points.positions[:, None] - given[None], axis=2).min(axis=1)
    assert np.median(nearest) < 0.1  # the floor is 2.4 wide, 2,500 points
    assert points.colours.min() >= 0 and points.colours.max() <= 1
