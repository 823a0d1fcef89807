"""The first cloud: random points where it is thin, what is left out, what is refused."""

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.train.data.multiview import Points
from airgs_codec.train.fit.points import initial_points, scene_extent
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


def test_one_view_without_points_is_refused():
    with pytest.raises(SceneError, match="at least two training views"):
        initial_points(None, views_of(coloured_cloud(), ring(1)), 100, np.random.default_rng(0))


def test_a_scene_is_as_wide_as_its_rig_or_as_far_as_what_a_narrow_rig_sees():
    cameras = ring()
    places = np.stack([camera.position for camera in cameras])
    rig = 1.1 * np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    near, far = (Points(places.mean(axis=0) + np.array([[0, 0, z]]), None) for z in (0.1 * rig, 40 * rig))
    assert scene_extent(cameras) == pytest.approx(rig) == scene_extent(cameras, near)
    assert scene_extent(cameras, far) == pytest.approx(40 * rig)
    assert scene_extent(cameras[:1]) == 1.0
    assert scene_extent(cameras[:1], Points(cameras[0].position[None], None)) == 1.0
