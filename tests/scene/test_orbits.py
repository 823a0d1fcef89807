"""Generated cameras see the scene, and a path passes through its cameras."""

import numpy as np

from airgs_codec.render import render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.orbits import camera_path, orbit_views
from tests.support.scenes import random_gaussians


def test_generated_views_see_the_scene():
    g = random_gaussians(400)
    for view in orbit_views(g, 4, 64):
        covered = (render(g, view).transmittance < 0.9).mean()
        assert 0.1 < covered < 0.95


def test_generated_views_of_one_gaussian_far_from_the_origin_are_finite():
    g = random_gaussians(1)
    far = Gaussians(g.means + np.float32(1e6), *(getattr(g, n) for n in g.__slots__[1:]))
    assert all(np.isfinite(v.world_to_camera).all() for v in orbit_views(far, 3))


def test_a_path_passes_through_its_cameras():
    views = orbit_views(random_gaussians(50), 4)
    path = camera_path(views, 10)
    assert len(path) == 10
    for got, want in ((path[0], views[0]), (path[3], views[1]), (path[9], views[3])):
        np.testing.assert_allclose(got.world_to_camera, want.world_to_camera, atol=1e-9)


def test_a_path_through_one_camera_stays_there():
    view = orbit_views(random_gaussians(50), 1)[0]
    assert camera_path([view], 3) == [view] * 3
