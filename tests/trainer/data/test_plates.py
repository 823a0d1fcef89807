"""Plates: what rests, what does not, and what is never flattened."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from airgs_codec.media.image import box_mean
from airgs_codec.trainer.data import plates as data_plates
from airgs_codec.trainer.data.plates import WINDOW, Plate, plate_of, settle, stands_still
from tests.faces import Capture, Target, TrainSettings, View, open_scene, rested, with_held_out
from tests.support.paths import FOX_VIEWS
from tests.support.views import ring

SIZE = 48
NOISE = 1.5  # of 255


def background() -> np.ndarray:
    y, x = np.mgrid[:SIZE, :SIZE]
    wall = 120 + 40 * np.sin(x / 3) + 30 * np.cos(y / 5)
    return np.repeat(wall[..., None], 3, axis=2)


def filmed(frames: int, add=lambda t, picture: None) -> tuple[np.ndarray, list[np.ndarray]]:
    """Pictures without noise, and as a camera takes them, after `add` has drawn into frame t."""
    rng = np.random.default_rng(0)
    clean, noisy = [], []
    for t in range(frames):
        picture = background()
        add(t, picture)
        clean.append(picture)
        noisy.append(np.clip(np.rint(picture + rng.normal(0, NOISE, picture.shape)), 0, 255).astype(np.uint8))
    return np.stack(clean), noisy


def ball(t, picture):
    picture[20:28, 3 * t : 3 * t + 8] = 240


def seen(picture: np.ndarray, name="cam00") -> View:
    return View(replace(ring(1, SIZE)[0], name=name), Target(picture.astype(np.float32) / 255))


class SettledOne(NamedTuple):
    target: Target
    moving: np.ndarray


def settled_one(view: View, plate: Plate) -> SettledOne:
    [settled], moving = settle([view], {view.camera.name: plate}, {})
    return SettledOne(settled.target, moving[0])


def test_a_plate_shows_the_wall_behind_what_moves_with_less_noise_than_a_picture():
    _, noisy = filmed(12, ball)
    plate = plate_of(noisy)
    assert np.abs(plate.rgb - background()).mean() < 0.6 * np.abs(noisy[0] - background())[:16].mean()
    assert plate.tolerance < 4.5 / 255


def test_what_moves_is_kept_and_what_rests_is_the_plate():
    clean, noisy = filmed(12, ball)
    settled = settled_one(seen(noisy[5]), plate_of(noisy))
    there = np.abs(clean[5] - background()).max(axis=2) > 0
    assert settled.moving[there].all() and settled.moving.mean() < 0.3
    assert (settled.target.rgb[there] == noisy[5][there].astype(np.float32) / 255).all()
    assert np.abs(settled.target.rgb * 255 - clean[5])[~settled.moving].mean() < 0.7 * NOISE


def shadow(t, picture):
    """A soft shadow of 8 / 255 at its darkest."""
    x = np.arange(SIZE)
    picture -= 8 * np.exp(-(((x - 4 * t) / 6) ** 2))[None, :, None]


def checks(t, picture):
    """A pattern whose mean is that of the wall, in the last frame alone."""
    if t == 11:
        y, x = np.mgrid[:16, :16]
        picture[16:32, 16:32] += np.where((x + y) % 2, 25.0, -25.0)[..., None]


def test_texture_that_moves_is_not_taken_for_noise():
    _, noisy = filmed(12, checks)
    settled = settled_one(seen(noisy[11]), plate_of(noisy))
    assert settled.moving[16:32, 16:32].all() and settled.moving.mean() < 0.4


def test_a_soft_shadow_is_not_flattened():
    clean, noisy = filmed(12, shadow)
    plate = plate_of(noisy)
    for t in (3, 6, 9):
        settled = settled_one(seen(noisy[t]), plate)
        lost = (settled.target.rgb * 255 - clean[t]).mean(axis=(0, 2))  # down the columns: the shadow's profile
        assert np.abs(lost).max() < 4.0  # of 8
        assert settled.moving[:, 4 * t].all()


def test_what_drifts_slowly_does_not_rest_for_ever():
    """One level a frame is under the tolerance, twenty-three are not."""

    def brighter(t, picture):
        picture += t

    _, noisy = filmed(24, brighter)
    plate = plate_of(noisy)
    moving = [settled_one(seen(p), plate).moving.mean() for p in noisy]
    assert moving[0] > 0.9 and moving[-1] > 0.9 and min(moving) < 0.1


def test_plates_are_seen_through_the_exposure_of_their_camera():
    _, noisy = filmed(12, ball)
    exposure = {"cam00": [1.2, 1.2, 1.2, 0.02, 0.02, 0.02]}
    alike = View(seen(noisy[5]).camera, Target((noisy[5].astype(np.float32) / 255 - 0.02) / 1.2))
    assert settle([alike], {"cam00": plate_of(noisy)}, exposure)[1][0].mean() < 0.3


def test_real_pictures_are_nowhere_changed_by_more_than_the_tolerance():
    scene = with_held_out(open_scene(FOX_VIEWS), None)
    capture = rested(Capture.of(scene, TrainSettings(), "cpu"))
    pictures, plates = capture.pictures, capture.plates
    assert set(plates) == {camera.name for camera in scene.cameras if not camera.held_out}
    for view in pictures.train(3):
        settled = settled_one(view, plates[view.camera.name])
        change = np.abs(box_mean(settled.target.rgb - view.target.rgb, WINDOW))
        assert change.max() <= plates[view.camera.name].tolerance + 1e-6
        assert np.abs(settled.target.rgb - view.target.rgb).max() < 40 / 255
        assert 0.02 < settled.moving.mean() < 0.7


@pytest.mark.parametrize("what", ["turned", "zoomed", "cropped", "of another's name"])
def test_cameras_that_move_have_no_plates(what):
    scene = open_scene(FOX_VIEWS)
    assert stands_still(scene)
    shots = list(scene.frames[2])
    camera = shots[1].camera
    if what == "turned":
        changed = replace(camera, world_to_camera=np.roll(np.eye(4), 1, axis=0))
    elif what == "cropped":
        changed = replace(camera, height=100)
    elif what == "zoomed":
        changed = replace(camera, fx=camera.fx * 1.01)
    else:  # plates are found by name: one camera would be compared with what the other sees
        changed = replace(camera, name=shots[0].camera.name)
    shots[1] = replace(shots[1], camera=changed)
    scene = replace(scene, frames=(*scene.frames[:2], tuple(shots), *scene.frames[3:]))
    assert not stands_still(scene)
    assert rested(Capture.of(scene, TrainSettings(), "cpu")).plates == {}


def test_settled_targets_are_kept_within_their_bytes(monkeypatch):
    capture = rested(Capture.of(with_held_out(open_scene(FOX_VIEWS), None), TrainSettings(), "cpu"))
    wanted = [view.target.rgb for view in settle(capture.pictures.train(3), capture.plates, {})[0]]
    monkeypatch.setattr(data_plates, "TARGET_BYTES", 3 * 128 * 128 * 36)
    for view, rgb in zip(settle(capture.pictures.train(3), capture.plates, {})[0], wanted, strict=True):
        np.testing.assert_array_equal(view.target.rgb, rgb)
        assert view.picture.buffer.nbytes <= 3 * 128 * 128 * 36
