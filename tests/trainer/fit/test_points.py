"""The cloud that a first frame starts from, points found in pictures, and the pixels that points fall into."""

import numpy as np
import pytest

from airgs_codec.render import Camera, cpu, read_cameras
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.points import (
    degrees_apart,
    from_points,
    initial_points,
    intersect,
    project,
    scene_extent,
    triangulate,
)
from tests.support.paths import FOX, FOX_VIEWS
from tests.support.views import coloured_cloud, ring, views_of


def test_few_points_are_joined_by_random_ones_that_views_see():
    views = views_of(coloured_cloud(), ring(8))
    few = Points(np.zeros((3, 3), np.float32), None)
    points = initial_points(few, views, 500, np.random.default_rng(0))
    assert 400 < len(points.positions) <= 500
    assert np.isfinite(points.colours).all() and points.colours.shape == points.positions.shape


def test_points_that_are_not_finite_are_left_out():
    positions = np.zeros((200, 3), np.float32)
    positions[7] = np.nan
    views = views_of(coloured_cloud(), ring(4))
    points = initial_points(Points(positions, None), views, 100, np.random.default_rng(0))
    assert len(points.positions) == 199


def test_a_scene_is_as_wide_as_its_rig_or_as_far_as_what_a_narrow_rig_sees():
    cameras = ring()
    places = np.stack([camera.position for camera in cameras])
    rig = 1.1 * np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    near, far = (Points(places.mean(axis=0) + np.array([[0, 0, z]]), None) for z in (0.1 * rig, 40 * rig))
    assert scene_extent(cameras) == pytest.approx(rig) == scene_extent(cameras, near)
    assert scene_extent(cameras, far) == pytest.approx(40 * rig)
    assert scene_extent(cameras[:1]) == 1.0
    assert scene_extent(cameras[:1], Points(cameras[0].position[None], None)) == 1.0


def test_cameras_of_a_ring_are_its_angle_apart():
    level = ring(16)[::2]  # all at one height
    assert degrees_apart(level) == pytest.approx(45 * np.cos(0.2), abs=1.5)
    assert degrees_apart(level[:1]) == 0


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


def test_projection_agrees_with_what_the_renderer_draws():
    """The convention, end to end: a small Gaussian is drawn where its mean projects to."""
    for camera in [*ring(4), *read_cameras(FOX / "transforms.json")[:4]]:
        point = np.array([[0.21, 0.13, -0.17]])
        g = from_points(point.astype(np.float32), np.ones((1, 3), np.float32), 0, 0.99, 0.02)
        rows, columns, inside = project(camera, point)
        picture = cpu.render(g, camera).rgb.sum(axis=2)
        drawn = np.unravel_index(picture.argmax(), picture.shape)
        assert inside.tolist() == [0]
        assert abs(drawn[0] - rows[0]) <= 1 and abs(drawn[1] - columns[0]) <= 1
