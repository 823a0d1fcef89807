"""Where scenes without cameras are seen from: objects from all sides, places from where they were filmed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from airgs_codec.analysis.up import Subject, find_floor, find_front, guess_up
from tests import faces
from tests.faces import find_viewpoints, region_around
from tests.support.paths import FOX
from tests.support.scenes import random_gaussians
from tests.support.views import joined, ring, without_sh

UP, FOCUS = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 4.0])


def discs(means, normals, size, thickness=0.05):
    """Opaque discs of radius `size`, upright on their normals (N, 3), of `thickness` radii."""
    count, rng = len(means), np.random.default_rng(len(means))
    quaternions = np.concatenate([1 + normals[:, 2:], -normals[:, 1:2], normals[:, :1], np.zeros((count, 1))], axis=1)
    quaternions[np.linalg.norm(quaternions, axis=1) < 1e-6] = (0, 1, 0, 0)  # turns z to -z
    scales = np.log(size) + np.array([0, 0, np.log(thickness)])
    colours = rng.normal(size=(count, 3)) * 0.3
    return without_sh(means, quaternions, np.tile(scales, (count, 1)), np.full(count, 4.0), colours)


def directions(count, seed):
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def ball(count=3000):
    around = directions(count, 1)
    return discs(0.5 * around, around, 1 / np.sqrt(count))


def floor(height, count=2000):
    x, z = np.random.default_rng(2).uniform(-1, 1, (2, count))
    return discs(np.stack([x, np.full(count, height), z], axis=1), np.tile([0.0, 1.0, 0.0], (count, 1)), 0.05)


def needles(count, length=0.5):
    """What is left of a scene in which nothing was understood: long needles in every direction."""
    rng = np.random.default_rng(0)
    scales = np.log(length * np.array([1, 0.06, 0.06])) + rng.normal(size=(count, 3)) * 0.2
    means, quaternions, colours = rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), rng.normal(size=(count, 3))
    return without_sh(means, quaternions, scales, rng.normal(size=count) + 1, colours)


def filmed_room():
    """A room filmed from its middle towards the wall at z = 4: small discs there, needles behind and all around."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-4, 4, (2, 6000))
    depth = 4 + 0.3 * np.sin(x) + 0.2 * np.cos(2 * y)
    wall = discs(np.stack([x, y, depth], axis=1), np.tile([0.0, 0.0, -1.0], (6000, 1)), 0.07)
    around, side = rng.uniform(-5, 5, (3000, 3)), rng.integers(0, 3, 3000)
    around[np.arange(3000), side] = rng.choice([-1, 1], 3000) * rng.uniform(4.5, 5.5, 3000)
    return joined(wall, replace(needles(3000, 1.5), means=around.astype(np.float32)))


def places_of(found):
    return np.stack([camera.position for camera in found.cameras])


def directions_of(found):
    return np.stack([camera.world_to_camera[2, :3] for camera in found.cameras])


def test_an_object_is_seen_from_all_around_and_neither_from_straight_above_nor_from_below():
    found = find_viewpoints([ball()], UP)
    assert found.confident and "-30° to 60° above the horizon" in found.summary
    sides = -directions_of(found)
    low, high = np.sin(np.radians([-30, 60]))
    assert low <= sides[:, 1].min() < 0 and 0.5 < sides[:, 1].max() <= high
    anywhere = directions(200, 0)
    there = anywhere[(anywhere[:, 1] > low) & (anywhere[:, 1] < high)]
    assert (there @ sides.T).max(axis=1).min() > np.cos(np.radians(40))


@pytest.mark.parametrize("up", [1, -1])
def test_an_object_on_a_floor_is_seen_from_above_it(up):
    found = find_viewpoints([joined(ball(), floor(-0.55 * up))], form=".ply")
    assert found.confident and "over its floor" in found.summary
    habit = "though .ply files mostly have another" if up == 1 else "as .ply files mostly have it"
    assert found.guess == f"up is guessed to be (0, {up}, 0), {habit}; --up says otherwise"
    assert (places_of(found)[:, 1] * up > -0.55).all()
    assert all(camera.world_to_camera[1, 1] * up <= 0 for camera in found.cameras), "up is up in the pictures"


@pytest.mark.parametrize(("up", "above"), [((0, 0, 1), False), ((0.1, 2, 0), True)])
def test_an_object_stands_as_it_is_told(up, above):
    """What lies across is no floor: it is seen from below, too."""
    found = find_viewpoints([joined(ball(), floor(-0.55))], np.array(up, float))
    assert not found.guess and all(camera.world_to_camera[1] @ [*up, 0] <= 1e-9 for camera in found.cameras)
    assert (places_of(found)[:, 1] > (-0.7 if above else -0.55)).all() == above == ("over its floor" in found.summary)


def test_the_fox_is_seen_as_it_was_trained_and_a_place_from_where_it_was_filmed():
    found = find_viewpoints([faces.read_ply(path) for path in sorted(FOX.glob("*.ply"))[:2]])
    assert found.confident and (places_of(found)[:, 1] > 0).all()
    room = find_viewpoints([filmed_room()])
    first = slice(8)  # of the best ones, from which viewers begin; the others are from all over it
    assert room.confident and len(room.cameras) > 16
    assert (places_of(room)[first, 2] < 4).all() and (directions_of(room)[first, 2] > 0.5).all()
    assert all(faces.render(filmed_room(), camera).transmittance.mean() < 0.1 for camera in room.cameras[first])
    assert np.ptp(places_of(room), axis=0).min() > 1.5 * np.ptp(places_of(room)[first], axis=0).min()


def test_where_nothing_is_clear_it_says_so_and_an_object_in_a_haze_is_not_taken_for_a_place():
    found, again = (find_viewpoints([needles(800)]) for _ in range(2))
    assert not found.confident and "unclear" in found.summary
    np.testing.assert_array_equal(places_of(again), places_of(found))
    haze = needles(100, 0.6)
    thin = replace(haze, means=(0.7 * haze.means).astype(np.float32), opacity_logits=np.full(100, -2, np.float32))
    found = find_viewpoints([joined(ball(), thin)])
    assert not found.confident and "haze" in found.summary and found.cameras[0].name == "front"


def test_broken_rows_huge_numbers_and_scenes_that_cannot_be_seen_have_views():
    g = ball()
    means, quaternions, scales = g.means.copy(), g.quaternions.copy(), g.log_scales.copy()
    means[:20], quaternions[20:40], means[40], scales[41] = np.nan, 0, 1e30, 60
    found = find_viewpoints([replace(g, means=means, quaternions=quaternions, log_scales=scales)])
    assert all(np.isfinite(camera.world_to_camera).all() for camera in found.cameras)
    unseen = random_gaussians(10)
    assert not find_viewpoints([replace(unseen, opacity_logits=np.full(10, -20, np.float32))]).confident
    with pytest.raises(faces.SceneError, match="finite"):
        find_viewpoints([replace(unseen, means=np.full((10, 3), np.nan, np.float32))])


def tube(centre, half, count):
    normals = directions(count, count)
    return discs(np.array(centre) + np.array(half) * normals, normals, 0.05)


def animal():
    """A body on four legs, with a head whose colours vary; it looks along z, and y is up."""
    legs = [tube((x, 0.3, z), (0.06, 0.3, 0.06), 200) for x in (-0.2, 0.2) for z in (-0.4, 0.4)]
    head = tube((0, 1.05, 0.7), (0.15, 0.15, 0.2), 400)
    speckled = replace(head, sh_dc=8 * head.sh_dc)
    plain = [replace(part, sh_dc=0 * part.sh_dc) for part in (tube((0, 0.75, 0), (0.25, 0.2, 0.6), 1200), *legs)]
    return joined(joined(*plain[:2]), joined(joined(*plain[2:4]), joined(plain[4], speckled)))


def turned(g, turn):
    turns = np.tile(np.roll(turn.as_quat(), 1), (len(g), 1))
    quaternions = faces.multiply(turns, g.quaternions.astype(np.float64)).astype(np.float32)
    return replace(g, means=(g.means @ turn.as_matrix().T).astype(np.float32), quaternions=quaternions)


@pytest.mark.parametrize("turn", list(Rotation.create_group("O"))[::5], ids=lambda turn: str(turn.as_quat().round(1)))
def test_an_animal_stands_on_its_feet_and_is_seen_from_in_front_however_it_is_turned(turn):
    subject = Subject.of(turned(animal(), turn))
    up, _ = guess_up(subject, turn.apply(UP))
    front, clear = find_front(subject, up)
    assert up == pytest.approx(turn.apply(UP), abs=1e-6)
    assert front @ turn.apply([0, 0, 1]) > 0.9 and clear


def test_a_floor_has_everything_on_one_side_and_a_place_that_was_filmed_is_lighter_above():
    up = find_floor(joined(ball(), floor(-0.55)))
    assert up is not None and up @ UP > 0.99
    assert find_floor(ball()) is None
    assert find_floor(joined(ball(), floor(0.0))) is None, "as much below as above"
    room = filmed_room()
    for up in (UP, -UP):
        light = np.where((room.means @ up)[:, None] > 0, 1.0, -1.0).astype(np.float32) * np.ones_like(room.sh_dc)
        assert guess_up(Subject.of(replace(room, sh_dc=light)), filmed=True)[0] == pytest.approx(up)


@pytest.mark.parametrize("up", [UP, -UP])
def test_what_stands_on_no_floor_is_held_as_the_light_falls_and_that_is_doubted(up):
    g = ball()
    lit = replace(g, sh_dc=(0.3 * g.sh_dc + 0.6 * (g.means @ up)[:, None]).astype(np.float32))
    found = find_viewpoints([lit], form=".ply")
    assert found.up == pytest.approx(up) and "a side that may be its front" in found.summary
    assert found.guess.startswith(f"cannot tell up: showing (0, {up[1]:g}, 0), ")
    over = "--up=-y" if up[1] > 0 else "--up=y"
    assert f"{over}, or turn it over in the player" in found.guess and f"set-view PACKAGE {over}" in found.guess


def test_a_specification_is_followed_where_nothing_is_sure_and_a_floor_is_believed_before_it():
    flipped = turned(animal(), Rotation.from_euler("x", np.pi))
    doubted = find_viewpoints([flipped], axes=faces.SPZ.axes, form=".spz")
    assert doubted.up.tolist() == [0, 1, 0] and "as .spz files should have it" in doubted.guess
    sure = find_viewpoints([joined(ball(), floor(0.55))], axes=faces.SPZ.axes, form=".spz")
    assert sure.up[1] < -0.99 and "though .spz files should have another" in sure.guess


def places_in(camera, points):
    """How far from the middle of a picture points (N, 3) are shown, 1 at its border; and their depths."""
    x, y, z = camera.world_to_camera[:3, :3] @ points.T + camera.world_to_camera[:3, 3:]
    return np.maximum(np.abs(x), np.abs(y)) / z * camera.fx * 2 / camera.width, z


def test_the_first_view_shows_the_whole_subject_with_a_margin_and_what_few_large_rows_make_of_it():
    g = animal()
    camera = find_viewpoints([g], UP).cameras[0]
    off, depth = places_in(camera, g.means)
    assert (depth > 0).all() and np.mean(off < 1) > 0.98 and 0.64 < np.quantile(off, 0.98) < 0.808
    assert camera.world_to_camera[1] @ [*UP, 0] < -0.9
    centres = np.linspace([-3.0, 0, 0], [3.0, 0, 0], 60)
    wide = joined(g, discs(centres, np.tile([0.0, 0, 1], (60, 1)), 0.5))
    off, depth = places_in(find_viewpoints([wide], UP).cameras[0], centres)
    assert (depth > 0).all() and (off < 1).all()


def wall(z, *, side=3.0):
    """Opaque blobs in a square of the plane at `z`, where cameras at z = 0 look."""
    x, y = np.meshgrid(np.linspace(-side, side, 40), np.linspace(-side, side, 40))
    means = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1).astype(np.float32)
    return faces.from_points(means, np.zeros_like(means), 0, 0.9975, side / 20)


def eye(place, focus, size=32):
    return faces.look_at(np.array(place, float), np.array(focus, float), -UP, size=size, fov_y=0.6, name="c")


def row(*xs):
    return [eye((x, 0, 0), (x, 0, 1)) for x in xs]


def around(degrees, rise=0.0):
    """Places in a circle of radius 4 about FOCUS, from -z on."""
    turns = np.radians(degrees)
    return [FOCUS + 4 * np.array([np.sin(turn), -rise, -np.cos(turn)]) for turn in turns]


def reaches(region):
    return [place.reach for place in region.places]


def test_places_stand_at_the_cameras_and_look_at_the_content():
    cameras = [replace(c, near=0.2) for c in row(-0.2, 0.2)]
    found = region_around(cameras, wall(4.0))
    assert (found.source, found.width, found.height, found.near) == ("cameras", 32, 32, 0.2)
    assert found.fov_y == pytest.approx(np.degrees(0.6))
    for place, camera in zip(found.places, cameras, strict=True):
        assert place.focus == pytest.approx([*camera.position[:2], 4.0], abs=0.1)
        view = faces.place_view(found, place)
        np.testing.assert_allclose(view.world_to_camera, camera.world_to_camera, atol=1e-5)
        assert view.fy == pytest.approx(camera.fy)


@pytest.mark.parametrize(("half", "margin"), [(0.1, 0.4), (1.2, 0.6), (2.4, 1.0)])
def test_the_default_margin(half, margin):
    """A tenth of the distance of 4, a quarter of the rig of 2.4, and of the distance where the rig is 4.8."""
    found = region_around(row(-half, half), wall(4.0, side=6.0))
    assert reaches(found) == pytest.approx([margin] * 2, rel=0.03) and found.turn == 5
    found = region_around(row(-half, half), wall(4.0), margin=0.0)
    assert reaches(found) == [0, 0] and found.turn == 0


@pytest.mark.parametrize("count", [9, 97])
def test_viewers_begin_in_the_middle_of_the_cameras(count):
    places = around(np.linspace(-35, 35, count))
    found = region_around([eye(place, FOCUS) for place in places], wall(4.0))
    xs = [place.position[0] for place in found.places]
    assert xs[0] == pytest.approx(0, abs=0.3) and xs[1:] == sorted(xs[1:]) and len(xs) == min(count, faces.MAX_PLACES)
    turning = [eye(FOCUS, place) for place in places[:: count // 9]]
    assert abs(region_around(turning, wall(0.0)).places[0].focus[0]) < 0.6, "in one place they look aside"


def test_a_ring_of_cameras_has_no_middle():
    """The one above it, which is nearest to all, shows what nobody would look at first."""
    places = around(range(0, 360, 30), rise=0.4)
    found = region_around([eye(place, FOCUS) for place in [*places, (0.1, -4, 4)]], wall(4.0)).places
    assert np.allclose(found[0].position, places[0], atol=0.01) and len(found) == 13


def test_many_cameras_leave_as_many_places_as_are_allowed():
    cameras = ring(150)
    found = region_around(cameras, wall(0.0, side=0.5))
    assert len(found.places) == faces.MAX_PLACES
    positions = np.array([place.position for place in found.places])
    for camera in cameras:  # whoever was left out has a neighbour
        assert np.linalg.norm(positions - camera.position, axis=1).min() < 0.7
    turning = [eye((0, 0, 0), (np.sin(a), 0, np.cos(a)), size=16) for a in np.linspace(0, 1, 80)]
    found = region_around(turning, wall(4.0, side=6.0))
    assert len({tuple(place.focus) for place in found.places}) == faces.MAX_PLACES


def test_a_camera_that_sees_nothing_and_a_scene_far_from_the_origin_give_directions():
    behind = region_around(row(0.0), wall(-4.0))
    assert behind.places[0].focus[2] > 0 and np.isfinite(reaches(behind)).all()
    g = wall(4.0)
    far = replace(g, means=np.add(g.means, [1e6, 0, 0]).astype(np.float32))
    (place,) = region_around([eye((1e6, 0, 0), (1e6, 0, 1))], far).places
    assert place.position == pytest.approx([1e6, 0, 0], abs=1e-4) and place.focus[2] == pytest.approx(4, abs=0.2)


@pytest.mark.parametrize(("pole", "margin", "reach"), [(True, 1.5, 0.5), (False, 1.5, 1.5), (False, 9.0, 2.0)])
def test_nobody_walks_into_what_he_sees_and_a_margin_is_a_length(pole, margin, reach):
    scene = joined(wall(4.0), wall(1.0, side=0.15)) if pole else wall(4.0)
    assert reaches(region_around(row(0.0), scene, margin=margin)) == pytest.approx([reach], rel=0.05)
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(faces.ConfigError, match="margin: expected 0 or more world units"):
            region_around(row(0.0), scene, margin=wrong)
