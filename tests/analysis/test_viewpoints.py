"""Where scenes without cameras are seen from: objects from all sides, places from where they were filmed."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.viewpoints import AROUND, find_viewpoints
from airgs_codec.errors import SceneError
from airgs_codec.render import render
from airgs_codec.scene.formats.ply import read_ply
from tests.support.paths import FOX
from tests.support.places import ball, filmed_room, floor, needles
from tests.support.scenes import random_gaussians
from tests.support.views import joined


def places_of(found):
    return np.stack([camera.position for camera in found.cameras])


def directions_of(found):
    return np.stack([camera.world_to_camera[2, :3] for camera in found.cameras])


def test_an_object_is_seen_from_all_around_and_neither_from_straight_above_nor_from_below():
    found = find_viewpoints([ball()], np.array([0.0, 1.0, 0.0]))
    assert found.confident and "-30° to 60° above the horizon" in found.story
    sides = -directions_of(found)
    low, high = np.sin(AROUND)
    assert low <= sides[:, 1].min() < 0 and 0.5 < sides[:, 1].max() <= high
    anywhere = np.random.default_rng(0).normal(size=(200, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    there = anywhere[(anywhere[:, 1] > low) & (anywhere[:, 1] < high)]
    assert (there @ sides.T).max(axis=1).min() > np.cos(np.radians(40))


@pytest.mark.parametrize("up", [1, -1])
def test_an_object_on_a_floor_is_seen_from_above_it(up):
    found = find_viewpoints([joined(ball(), floor(-0.55 * up))])
    assert found.confident and "over its floor" in found.story
    assert found.guess == f"up is guessed to be (0, {up}, 0); --up says otherwise"
    assert (places_of(found)[:, 1] * up > -0.55).all()
    assert all(camera.world_to_camera[1, 1] * up <= 0 for camera in found.cameras), "up is up in the pictures"


def test_an_object_stands_as_it_is_told():
    up = np.array([0.0, 0.0, 1.0])
    found = find_viewpoints([joined(ball(), floor(-0.55))], up)
    assert all(camera.world_to_camera[1] @ [*up, 0] <= 1e-9 for camera in found.cameras), "up is up in the pictures"
    assert (places_of(found)[:, 1] < -0.55).any(), "what lies across is no floor: from below, too"
    tilted = find_viewpoints([joined(ball(), floor(-0.55))], np.array([0.1, 2.0, 0.0]))
    assert (places_of(tilted)[:, 1] > -0.7).all() and "over its floor" in tilted.story
    assert not found.guess and not tilted.guess


def test_the_fox_is_seen_as_it_was_trained():
    found = find_viewpoints([read_ply(path) for path in sorted(FOX.glob("*.ply"))[:2]])
    assert found.confident and (places_of(found)[:, 1] > 0).all()


@pytest.fixture(scope="module")
def room():
    return find_viewpoints([filmed_room()])


def test_a_place_is_seen_from_where_it_was_filmed(room):
    first = slice(8)  # of the best ones, from which viewers begin; the others are from all over it
    assert room.confident and len(room.cameras) > 16
    assert (places_of(room)[first, 2] < 4).all() and (directions_of(room)[first, 2] > 0.5).all()
    assert all(render(filmed_room(), camera).transmittance.mean() < 0.1 for camera in room.cameras[first])
    assert np.ptp(places_of(room), axis=0).min() > 1.5 * np.ptp(places_of(room)[first], axis=0).min()


def test_where_nothing_is_clear_it_says_so_and_looks_from_everywhere():
    found, again = (find_viewpoints([needles(800)]) for _ in range(2))
    assert not found.confident and "unclear" in found.story
    np.testing.assert_array_equal(places_of(again), places_of(found))


def test_an_object_in_a_haze_is_not_taken_for_a_place():
    haze = needles(100, length=0.6)
    thin = replace(haze, means=(0.7 * haze.means).astype(np.float32), opacity_logits=np.full(100, -2, np.float32))
    found = find_viewpoints([joined(ball(), thin)])
    assert not found.confident and "haze" in found.story
    assert found.cameras[0].name == "front"


def test_broken_rows_and_huge_numbers_are_passed_over():
    g = ball()
    means, quaternions, scales = g.means.copy(), g.quaternions.copy(), g.log_scales.copy()
    means[:20], quaternions[20:40], means[40], scales[41] = np.nan, 0, 1e30, 60
    found = find_viewpoints([replace(g, means=means, quaternions=quaternions, log_scales=scales)])
    assert all(np.isfinite(camera.world_to_camera).all() for camera in found.cameras)


def test_a_scene_that_cannot_be_seen_has_views_all_the_same():
    g = random_gaussians(10)
    assert not find_viewpoints([replace(g, opacity_logits=np.full(10, -20, np.float32))]).confident


def test_a_frame_without_finite_rows_is_refused():
    g = random_gaussians(4)
    with pytest.raises(SceneError, match="finite"):
        find_viewpoints([replace(g, means=np.full((4, 3), np.nan, np.float32))])
