"""The region that cameras and a scene suggest: places, margins, and never into what is there."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.region import region_around
from airgs_codec.errors import ConfigError
from airgs_codec.package.region import place_view
from airgs_codec.package.tables import MAX_PLACES
from airgs_codec.scene.camera import look_at
from airgs_codec.trainer.fit.points import from_points
from tests.support.views import joined, ring


def wall(z, *, side=3.0):
    """Opaque blobs in a square of the plane at `z`, where cameras at z = 0 look."""
    x, y = np.meshgrid(np.linspace(-side, side, 40), np.linspace(-side, side, 40))
    means = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1).astype(np.float32)
    return from_points(means, np.zeros_like(means), 0, 0.9975, side / 20)


def row(*xs, size=32):
    up = np.array([0.0, -1.0, 0.0])
    return [look_at(np.array([x, 0, 0.0]), np.array([x, 0, 1.0]), up, size=size, fov_y=0.6, name=f"x{x:g}") for x in xs]


def reaches(region):
    return [place.reach for place in region.places]


def test_places_stand_at_the_cameras_and_look_at_the_content():
    cameras = [replace(c, near=0.2) for c in row(-0.2, 0.2)]
    found = region_around(cameras, wall(4.0))
    assert (found.source, found.width, found.height, found.near) == ("cameras", 32, 32, 0.2)
    assert found.fov_y == pytest.approx(np.degrees(0.6))
    for place, camera in zip(found.places, cameras, strict=True):
        assert place.focus == pytest.approx([*camera.position[:2], 4.0], abs=0.1)
        view = place_view(found, place)
        np.testing.assert_allclose(view.world_to_camera, camera.world_to_camera, atol=1e-5)
        assert view.fy == pytest.approx(camera.fy)


@pytest.mark.parametrize(
    ("half", "margin"),
    [
        (0.1, 0.4),  # a tenth of the distance of 4
        (1.2, 0.6),  # a quarter of the rig of 2.4
        (2.4, 1.0),  # a quarter of the distance, though the rig is 4.8
    ],
)
def test_the_default_margin(half, margin):
    found = region_around(row(-half, half), wall(4.0, side=6.0))
    assert reaches(found) == pytest.approx([margin] * 2, rel=0.03) and found.turn == 5
    found = region_around(row(-half, half), wall(4.0), margin=0.0)
    assert reaches(found) == [0, 0] and found.turn == 0


@pytest.mark.parametrize("count", [9, 97])
def test_viewers_begin_in_the_middle_of_the_cameras(count):
    arc = np.radians(np.linspace(-35, 35, count))
    up, focus = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 4.0])
    around = [focus + 4 * np.array([np.sin(turn), 0, -np.cos(turn)]) for turn in arc]
    cameras = [look_at(position, focus, up, size=32, fov_y=0.6, name="c") for position in around]
    found = region_around(cameras, wall(4.0))
    xs = [place.position[0] for place in found.places]
    assert xs[0] == pytest.approx(0, abs=0.3) and xs[1:] == sorted(xs[1:]) and len(xs) == min(count, MAX_PLACES)
    turning = [look_at(focus, position, up, size=32, fov_y=0.6, name="c") for position in around[:: count // 9]]
    assert abs(region_around(turning, wall(0.0)).places[0].focus[0]) < 0.6, "in one place they look aside"


def test_a_ring_of_cameras_has_no_middle():
    """The one above it, which is nearest to all, shows what nobody would look at first."""
    up, focus = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 4.0])
    around = [focus + 4 * np.array([np.sin(turn), -0.4, -np.cos(turn)]) for turn in np.radians(range(0, 360, 30))]
    above = focus + np.array([0.1, -4.0, 0.0])
    cameras = [look_at(position, focus, up, size=32, fov_y=0.6, name="c") for position in [*around, above]]
    places = region_around(cameras, wall(4.0)).places
    assert np.allclose(places[0].position, around[0], atol=0.01) and len(places) == 13


def test_nobody_walks_into_what_he_sees():
    beside = wall(4.0)
    pole = wall(1.0, side=0.15)
    close, free = (region_around(row(0.0), g, margin=1.5) for g in (joined(beside, pole), beside))
    assert reaches(close) == pytest.approx([0.5], rel=0.05)
    assert reaches(free) == pytest.approx([1.5], rel=0.05)
    assert reaches(region_around(row(0.0), beside, margin=9.0)) == pytest.approx([2.0], rel=0.05)


def test_many_cameras_leave_as_many_places_as_are_allowed():
    cameras = ring(150)
    found = region_around(cameras, wall(0.0, side=0.5))
    assert len(found.places) == MAX_PLACES
    positions = np.array([place.position for place in found.places])
    for camera in cameras:  # whoever was left out has a neighbour
        assert np.linalg.norm(positions - camera.position, axis=1).min() < 0.7


def test_cameras_that_turn_about_one_point_are_all_places():
    axes = [np.array([np.sin(a), 0.0, np.cos(a)]) for a in np.linspace(0, 1, 80)]
    up = np.array([0.0, -1.0, 0.0])
    head = [look_at(np.zeros(3), axis, up, size=16, fov_y=0.6, name="head") for axis in axes]
    found = region_around(head, wall(4.0, side=6.0))
    assert len({tuple(place.focus) for place in found.places}) == MAX_PLACES


def test_a_camera_that_sees_nothing_and_a_scene_far_from_the_origin_give_directions():
    behind = region_around(row(0.0), wall(-4.0))
    assert behind.places[0].focus[2] > 0 and np.isfinite(reaches(behind)).all()
    far = np.array([1e6, 0.0, 0.0])
    (camera,) = row(0.0)
    matrix = camera.world_to_camera.copy()
    matrix[:3, 3] -= matrix[:3, :3] @ far
    g = wall(4.0)
    moved = replace(g, means=(g.means + far).astype(np.float32))
    (place,) = region_around([replace(camera, world_to_camera=matrix)], moved).places
    assert place.position == pytest.approx([1e6, 0, 0], abs=1e-4) and place.focus[2] == pytest.approx(4, abs=0.2)


@pytest.mark.parametrize("margin", [-0.1, float("nan"), float("inf")])
def test_a_margin_that_is_no_length_is_refused(margin):
    with pytest.raises(ConfigError, match="margin: expected 0 or more world units"):
        region_around(row(0.0), wall(4.0), margin=margin)
