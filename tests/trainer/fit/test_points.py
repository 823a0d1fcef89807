"""The cloud that a first frame starts from, points found in pictures, and the pixels that points fall into."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.trainer.fit import points as fit_points
from airgs_codec.trainer.fit.points import degrees_apart, initial_points, intersect, project, triangulate
from tests.faces import Pictures, Points, from_points, look_at, open_scene, read_cameras, render, scene_extent
from tests.support.paths import FOX, FOX_VIEWS
from tests.support.views import coloured_cloud, joined, ring, views_of


def test_few_points_are_joined_by_random_ones_that_views_see_and_those_that_are_not_finite_are_left_out():
    broken, views, rng = np.zeros((200, 3), np.float32), views_of(coloured_cloud(), ring(8)), np.random.default_rng(0)
    broken[7] = np.nan
    points = initial_points(Points(broken[:3], None), views, 500, rng)
    assert 400 < len(points.positions) <= 500
    assert np.isfinite(points.colours).all() and points.colours.shape == points.positions.shape
    assert len(initial_points(Points(broken, None), views, 100, rng).positions) == 199


def test_a_scene_is_as_wide_as_its_rig_or_as_far_as_what_a_narrow_rig_sees():
    cameras = ring()
    places = np.stack([camera.position for camera in cameras])
    rig = 1.1 * np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    near, far = (Points(places.mean(axis=0) + np.array([[0, 0, z]]), None) for z in (0.1 * rig, 40 * rig))
    assert scene_extent(cameras) == pytest.approx(rig) == scene_extent(cameras, near)
    assert scene_extent(cameras, far) == pytest.approx(40 * rig)
    both = np.concatenate([np.tile(far.positions, (7, 1)), cameras[0].position + np.eye(3) * rig / 50, [[np.nan] * 3]])
    assert scene_extent(cameras, Points(both, None)) == pytest.approx(100 * rig / 50)
    assert scene_extent(cameras[:1]) == 1.0 == scene_extent(cameras[:1], Points(cameras[0].position[None], None))


def test_cameras_of_a_ring_are_its_angle_apart():
    level = ring(16)[::2]  # all at one height
    assert degrees_apart(level) == pytest.approx(45 * np.cos(0.2), abs=1.5)
    assert degrees_apart(level[:1]) == 0


def pixel(camera, point):
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


def test_rays_intersect_at_the_point_they_come_from():
    point, cameras = np.array([0.3, -0.2, 0.1]), ring(4)[:3]
    places = np.stack([pixel(c, point) for c in cameras])
    assert intersect(cameras, places) == pytest.approx(point, abs=1e-9)
    wrong = places + np.array([[0, 0], [9, 0], [0, 9]])
    assert intersect(cameras, wrong) is None
    assert intersect([cameras[0], cameras[0]], places[[0, 0]]) is None  # parallel
    behind = 2 * cameras[0].position
    assert intersect(cameras, np.stack([pixel(c, behind) for c in cameras])) is None


def test_tracks_of_real_pictures_lie_on_the_scene():
    views = Pictures(open_scene(FOX_VIEWS)).train(0)
    points, given = triangulate(views), np.load(FOX_VIEWS / "points3d.npy")
    assert len(points.positions) > 50
    nearest = np.linalg.norm(points.positions[:, None] - given[None], axis=2).min(axis=1)
    assert np.median(nearest) < 0.1  # the floor is 2.4 wide, 2,500 points
    assert points.colours.min() >= 0 and points.colours.max() <= 1


def test_projection_agrees_with_what_the_renderer_draws():
    """The convention, end to end: a small Gaussian is drawn where its mean projects to."""
    point = np.array([[0.21, 0.13, -0.17]])
    g = from_points(point.astype(np.float32), np.ones((1, 3), np.float32), 0, 0.99, 0.02)
    for camera in [*ring(4), *read_cameras(FOX / "transforms.json")[:4]]:
        rows, columns, inside = project(camera, point)
        picture = render(g, camera).rgb.sum(axis=2)
        row, column = np.unravel_index(picture.argmax(), picture.shape)
        assert inside.tolist() == [0] and abs(row - rows[0]) <= 1 and abs(column - columns[0]) <= 1


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


def on_the_walls(rng, count):
    places = rng.normal(size=(count, 3))
    return places * RADIUS / np.linalg.norm(places, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def room():
    """A round room with waves on its walls, and a red thing in the middle."""
    rng = np.random.default_rng(3)
    places = on_the_walls(rng, 6000)
    colours = 0.6 + 0.09 * np.sin(8 * places)
    walls = from_points(places.astype(np.float32), colours.astype(np.float32), 0, 0.99, 0.2)
    thing, red = coloured_cloud(200), np.tile(np.array([1.5, -1.5, -1.5], np.float32), (200, 1))
    return joined(walls, replace(thing, means=0.5 * thing.means, log_scales=thing.log_scales - 0.5, sh_dc=red))


@pytest.fixture(scope="module")
def views(room):
    return views_of(room, inside())


def test_cameras_surround_what_they_look_at_or_stand_before_it():
    before = [replace(c, name=f"{i}") for i, c in enumerate(inside()[:2] * 3)]
    assert fit_points.surround(inside()) and not fit_points.surround(inside(3)) and not fit_points.surround(before)


def test_walls_are_found_where_cameras_see_them(views):
    distance = np.linalg.norm(fit_points.surroundings(views), axis=1)  # from what the cameras look at
    assert np.median(np.abs(distance - (RADIUS - DEPTH))) < 0.1 * RADIUS
    assert (distance > 0.6 * RADIUS).mean() > 0.9


def test_points_that_cover_a_part_stay_and_the_rest_is_found(views):
    positions = fit_points.sparse_cloud(GIVEN, views, 4000, np.random.default_rng(0))[0].positions
    assert len(positions) <= 4000
    assert set(map(tuple, GIVEN.positions.tolist())) <= set(map(tuple, positions.tolist()))
    assert (np.linalg.norm(positions, axis=1) > 0.6 * RADIUS).sum() > 1000


def test_points_that_tell_the_scene_are_left_alone_and_so_is_what_was_cut_out_or_seen_from_close_together(room, views):
    rng = np.random.default_rng(0)
    walls = Points(on_the_walls(rng, 3000).astype(np.float32), None)
    assert fit_points.sparse_cloud(walls, views, 4000, rng) is None
    assert fit_points.sparse_cloud(GIVEN, views_of(coloured_cloud(), ring(8)), 4000, rng) is None
    assert fit_points.sparse_cloud(None, views, 4000, rng) is None, "nobody tells what stands within the walls"
    assert (
        fit_points.surround(inside(24))
        and fit_points.sparse_cloud(GIVEN, views_of(room, inside(24)), 4000, rng) is None
    )
