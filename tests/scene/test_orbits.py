"""Generated cameras see the scene."""

import numpy as np
import pytest

from airgs_codec.render import render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.orbits import dome_views, orbit_views
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


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 2)])
def test_a_ring_is_above_the_horizon_and_upright(up):
    axis = np.array(up, float) / np.linalg.norm(up)
    for view in orbit_views(random_gaussians(50), 6, 32, np.array(up, float)):
        assert -view.world_to_camera[2, :3] @ axis >= np.sin(np.radians(9)) and view.world_to_camera[1, :3] @ axis < 0


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 2), (1, -1, 0.5)])
def test_a_dome_is_above_its_horizon_and_all_around(up):
    axis = np.array(up, float) / np.linalg.norm(up)
    views = dome_views(random_gaussians(50), 20, 64, np.array(up, float), lowest=0.2)
    sides = np.stack([-v.world_to_camera[2, :3] for v in views])
    assert np.sin(0.2) <= (sides @ axis).min() < 0.3 and (sides @ axis).max() > 0.95
    assert np.linalg.norm((sides - np.outer(sides @ axis, axis)).mean(axis=0)) < 0.1, "as much on every side"
    assert all(v.world_to_camera[1, :3] @ axis <= 0 for v in views), "up is up in the pictures"


def test_a_whole_sphere_has_no_side_that_is_not_seen():
    sides = np.stack(
        [-v.world_to_camera[2, :3] for v in dome_views(random_gaussians(50), 12, 64, np.array([0, 1.0, 0]))]
    )
    assert (np.eye(3) @ sides.T).max(axis=1).min() > 0.8 and (np.eye(3) @ sides.T).min(axis=1).max() < -0.8
