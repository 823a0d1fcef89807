"""What stands around a rig that looks inwards, and what stands in it."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.scene.camera import look_at, looked_at
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.fit.points import from_points
from airgs_codec.trainer.fit.surround import Cloud, sparse_cloud, surround, surroundings
from tests.support.views import coloured_cloud, joined, ring, views_of

RADIUS = 3.0  # of a round room
DEPTH = 0.25  # two sigma of the balls of its walls, which are seen from within


def inside(count=8):
    """Cameras in the wall of the room that look at its middle, from two heights."""
    cameras = []
    for i in range(count):
        turn, rise = 2 * np.pi * i / count, (0.1, 0.6)[i % 2]
        place = 2.9 * np.array([np.cos(turn) * np.cos(rise), -np.sin(rise), np.sin(turn) * np.cos(rise)])
        camera = look_at(place, np.zeros(3), np.array([0.0, -1.0, 0.0]), size=96, fov_y=1.2, name=f"cam{i:02d}")
        cameras.append(replace(camera, near=0.5))
    return cameras


GIVEN = Points(np.random.default_rng(1).normal(0, 0.2, (500, 3)).astype(np.float32), None)


@pytest.fixture(scope="module")
def room() -> Gaussians:
    """A round room with waves on its walls, and a red thing in the middle."""
    rng = np.random.default_rng(3)
    places = rng.normal(size=(6000, 3))
    places *= RADIUS / np.linalg.norm(places, axis=1, keepdims=True)
    colours = 0.6 + 0.09 * np.sin(8 * places)
    walls = from_points(places.astype(np.float32), colours.astype(np.float32), 0, 0.99, 0.2)
    thing = coloured_cloud(200)
    colour = np.tile(np.array([1.5, -1.5, -1.5], np.float32), (200, 1))
    thing = replace(thing, means=0.5 * thing.means, log_scales=thing.log_scales - 0.5, sh_dc=colour)
    return joined(walls, thing)


@pytest.fixture(scope="module")
def views(room):
    return views_of(room, inside())


def test_cameras_surround_what_they_look_at_or_stand_before_it():
    assert surround(inside())
    assert not surround(inside(3))
    before = [replace(c, name=f"{i}") for i, c in enumerate(inside()[:2] * 3)]
    assert not surround(before)


def test_walls_are_found_where_cameras_see_them(views):
    points = surroundings(views)
    distance = np.linalg.norm(points - looked_at([v.camera for v in views]), axis=1)
    assert np.median(np.abs(distance - (RADIUS - DEPTH))) < 0.1 * RADIUS
    assert (distance > 0.6 * RADIUS).mean() > 0.9


def test_points_that_cover_a_part_stay_and_the_rest_is_found(views):
    cloud = sparse_cloud(GIVEN, views, 4000, np.random.default_rng(0))
    assert isinstance(cloud, Cloud) and len(cloud.points.positions) <= 4000
    positions = {tuple(p) for p in cloud.points.positions.tolist()}
    assert {tuple(p) for p in GIVEN.positions.tolist()} <= positions
    assert (np.linalg.norm(cloud.points.positions, axis=1) > 0.6 * RADIUS).sum() > 1000


def test_cameras_that_stand_close_together_are_no_sparse_rig(room):
    dense = views_of(room, inside(24))
    assert surround([view.camera for view in dense])
    assert sparse_cloud(GIVEN, dense, 4000, np.random.default_rng(0)) is None


def test_points_that_tell_the_scene_are_left_alone_and_so_is_what_was_cut_out(views):
    rng = np.random.default_rng(0)
    walls = rng.normal(size=(3000, 3))
    walls *= RADIUS / np.linalg.norm(walls, axis=1, keepdims=True)
    assert sparse_cloud(Points(walls.astype(np.float32), None), views, 4000, rng) is None
    assert sparse_cloud(GIVEN, views_of(coloured_cloud(), ring(8)), 4000, rng) is None
    assert sparse_cloud(None, views, 4000, rng) is None, "nobody tells what stands within the walls"
