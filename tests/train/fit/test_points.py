"""The first cloud: random points where it is thin, what is left out, what is refused."""

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.train.data.multiview import Points
from airgs_codec.train.fit.points import initial_points
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
