"""Projection: where a point is drawn."""

import numpy as np

from airgs_codec.render import cpu, read_cameras
from airgs_codec.train.fit.parameters import from_points
from airgs_codec.train.fit.projection import project
from tests.support.paths import FOX
from tests.support.views import ring


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
