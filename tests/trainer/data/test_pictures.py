"""Pictures at training size: rays, memory, exposure; and plates: what rests, and what is never flattened."""

from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from airgs_codec.trainer.data.pictures import plate_of, settle, stands_still
from airgs_codec.trainer.fit.losses import moments
from tests import faces
from tests.faces import PICTURE_BYTES, TARGET_BYTES, Capture, Pictures, Target, TrainSettings, open_scene, rested
from tests.support.camera_files import write_panoptic
from tests.support.multiview_files import write_views
from tests.support.paths import FOX_VIEWS
from tests.support.views import coloured_cloud, ring


def test_smaller_pictures_keep_their_rays_and_are_within_half_a_level(moving):
    scene = open_scene(moving)
    small, full = Pictures(scene, TrainSettings(max_size=24)).cameras()[0], scene.cameras[0]
    assert (small.width, small.height) == (24, 24)
    assert (small.cx / small.fx, small.width / small.fx) == pytest.approx((full.cx / full.fx, full.width / full.fx))
    shown, whole = (Pictures(scene, TrainSettings(max_size=size)).train(0)[0].target.rgb for size in (24, None))
    assert shown.shape == (24, 24, 3) and 0 < np.abs(shown - faces.resize(whole, 24, 24)).max() <= 0.5 / 255 + 1e-6


def noise(cameras, width, height):
    """A frame of many cameras whose pictures are noise of one seed each, and the seeds that were read so far."""
    reads: list[int] = []

    def read(seed, size):
        reads.append(seed)
        return np.random.default_rng(seed).integers(0, 256, (*size[::-1], 3), np.uint8)

    rig = (replace(camera, width=width, height=height) for camera in ring(cameras, size=16))
    shots = tuple(faces.Shot(camera, SimpleNamespace(read=partial(read, i))) for i, camera in enumerate(rig))
    return faces.MultiviewScene(Path("noise"), Fraction(30), (shots,)), reads


def test_eighty_cameras_are_never_all_in_memory():
    """A tenth of 4K each way, and a hundredth of the memory."""
    whole = 80 * 3840 * 2160 * 3
    assert whole > 1.8 * PICTURE_BYTES and 12 * whole > 11 * TARGET_BYTES
    scene, reads = noise(80, 384, 216)
    taken = Pictures(scene, memory=(PICTURE_BYTES // 100, TARGET_BYTES // 100))
    most = 0
    for view in taken.train(0) + taken.train(0)[::-1]:
        assert moments(view.target)[0].shape == (216, 3 * 384)
        most = max(most, taken.nbytes)
    assert 0.9 * (PICTURE_BYTES + TARGET_BYTES) < 100 * most <= PICTURE_BYTES + TARGET_BYTES
    assert 80 < len(reads) < 160  # those that were seen last were at hand on the way back


def test_pictures_that_fit_are_read_once_are_exact_and_exposed_alike():
    scene, reads = noise(5, 30, 20)
    taken = Pictures(scene)
    taken.check()
    assert reads == [0, 1, 2, 3, 4]
    whole, alike = (
        [view.target.rgb for view in pictures.train(0)]
        for pictures in (taken, taken.with_exposure({"cam00": [2.0] * 3 + [0.1] * 3}))
    )
    assert reads == [0, 1, 2, 3, 4] and taken.nbytes == 5 * 20 * 30 * (3 + 36)
    for rgb, other, shot in zip(whole, alike, scene.frames[0], strict=True):
        assert (rgb == shot.source.read((30, 20)).astype(np.float32) / np.float32(255)).all()
        assert np.abs(other - (rgb - 0.1) / 2).max() < 1e-6 if shot.camera.name == "cam00" else (other == rgb).all()


@pytest.mark.parametrize(("background", "left"), [
    (None, (0, 0, 0)), ("white", (1, 1, 1)), ("0.5,0,1", (0.5, 0, 1)), ("random", (0, 0, 0)),
])  # fmt: skip
def test_what_is_transparent_shows_the_background(tmp_path, background, left):
    write_views(tmp_path, [coloured_cloud(30)], ring(1), None)
    picture = np.full((48, 48, 4), (0, 0, 255, 255), np.uint8)  # blue, green, red
    picture[:, :24, 3] = 0
    cv2.imwrite(str(tmp_path / "images" / "cam00" / "0000.png"), picture)
    view = Pictures(open_scene(tmp_path), TrainSettings(background=background)).train(0)[0]
    for shown, behind, within in ((view, left, 2e-3), (view.before((0.2, 0.4, 0.6)), (0.2, 0.4, 0.6), 3e-3)):
        assert shown.camera.background == behind
        assert np.allclose(shown.target.rgb[:, :24], behind, atol=within)
        assert np.allclose(shown.target.rgb[:, 24:], (1, 0, 0))
    target = view.target
    assert target.nbytes == target.rgb.nbytes + target.clear.nbytes + sum(part.nbytes for part in moments(target))


def test_masks_leave_the_background_and_opaque_pictures_have_no_random_one(tmp_path):
    scene = open_scene(write_panoptic(tmp_path, ring(2)))
    given = TrainSettings(foreground="given", background="white")
    cut = Pictures(scene, given).train(0)[0].target.rgb
    assert cut[:, :24].min() == 1 and 0.7 < cut[:, 24:].min() < 0.9
    Pictures(scene, replace(given, background="random")).train(0)[0].before((0, 1, 0))
    with pytest.raises(faces.SceneError, match="expected alpha for random backgrounds, got an opaque picture"):
        Pictures(scene, TrainSettings(background="random")).check()


SIZE = 48
NOISE = 1.5  # of 255


Y, X = np.mgrid[:SIZE, :SIZE]
WALL = np.repeat((120 + 40 * np.sin(X / 3) + 30 * np.cos(Y / 5))[..., None], 3, axis=2)


def filmed(frames, add):
    """Pictures of the wall without noise and as a camera takes them, after `add` drew into frame t; their plate."""
    rng, clean, noisy = np.random.default_rng(0), np.stack([WALL] * frames), []
    for t, picture in enumerate(clean):
        add(t, picture)
        noisy.append(np.clip(np.rint(picture + rng.normal(0, NOISE, picture.shape)), 0, 255).astype(np.uint8))
    return clean, noisy, plate_of(noisy)


def settled_one(picture, plate, exposure=None):
    view = faces.View(ring(1, SIZE)[0], Target(picture.astype(np.float32) / 255))
    [settled], [moving] = settle([view], {"cam00": plate}, exposure or {})
    return settled.target.rgb, moving


def test_what_moves_is_kept_and_what_rests_is_the_plate_with_less_noise_through_the_exposure_of_its_camera():
    def ball(t, picture):
        picture[20:28, 3 * t : 3 * t + 8] = 240

    clean, noisy, plate = filmed(12, ball)
    assert np.abs(plate.rgb - WALL).mean() < 0.6 * np.abs(noisy[0] - WALL)[:16].mean()
    assert plate.tolerance < 4.5 / 255
    shown, moving = settled_one(noisy[5], plate)
    there = np.abs(clean[5] - WALL).max(axis=2) > 0
    assert moving[there].all() and moving.mean() < 0.3
    assert (shown[there] == noisy[5][there].astype(np.float32) / 255).all()
    assert np.abs(shown * 255 - clean[5])[~moving].mean() < 0.7 * NOISE
    _, moving = settled_one((noisy[5] - 0.02 * 255) / 1.2, plate, {"cam00": [1.2, 1.2, 1.2, 0.02, 0.02, 0.02]})
    assert moving.mean() < 0.3


def test_texture_that_moves_is_not_taken_for_noise():
    """A pattern whose mean is that of the wall, in the last frame alone."""

    def checks(t, picture):
        picture[16:32, 16:32] += np.where((X + Y) % 2, 25.0, -25.0)[:16, :16, None] * (t == 11)

    _, noisy, plate = filmed(12, checks)
    _, moving = settled_one(noisy[11], plate)
    assert moving[16:32, 16:32].all() and moving.mean() < 0.4


def test_a_soft_shadow_of_8_levels_at_its_darkest_is_not_flattened():
    def shadow(t, picture):
        picture -= 8 * np.exp(-(((np.arange(SIZE) - 4 * t) / 6) ** 2))[None, :, None]

    clean, noisy, plate = filmed(12, shadow)
    for t in (3, 6, 9):
        shown, moving = settled_one(noisy[t], plate)
        lost = (shown * 255 - clean[t]).mean(axis=(0, 2))  # down the columns: the shadow's profile
        assert np.abs(lost).max() < 4.0  # of 8
        assert moving[:, 4 * t].all()


def test_what_drifts_slowly_does_not_rest_for_ever():
    """One level a frame is under the tolerance, twenty-three are not."""

    def brighter(t, picture):
        picture += t

    _, noisy, plate = filmed(24, brighter)
    moving = [settled_one(picture, plate)[1].mean() for picture in noisy]
    assert moving[0] > 0.9 and moving[-1] > 0.9 and min(moving) < 0.1


def test_real_pictures_are_nowhere_changed_by_more_than_the_tolerance_and_kept_within_their_bytes(monkeypatch):
    scene = faces.with_held_out(open_scene(FOX_VIEWS), None)
    capture = rested(Capture.of(scene, TrainSettings(), "cpu"))
    assert set(capture.pictures.plates) == {camera.name for camera in scene.cameras if not camera.held_out}
    views = capture.pictures.train(3)
    settled, where = settle(views, capture.pictures.plates, {})
    wanted = [view.target.rgb for view in settled]
    for view, shown, moving in zip(views, wanted, where, strict=True):
        tolerance = capture.pictures.plates[view.camera.name].tolerance
        assert np.abs(faces.box_mean(shown - view.target.rgb, 5)).max() <= tolerance + 1e-6
        assert np.abs(shown - view.target.rgb).max() < 40 / 255 and 0.02 < moving.mean() < 0.7
    monkeypatch.setattr("airgs_codec.trainer.data.pictures.TARGET_BYTES", 3 * 128 * 128 * 36)
    for view, rgb in zip(settle(views, capture.pictures.plates, {})[0], wanted, strict=True):
        np.testing.assert_array_equal(view.target.rgb, rgb)
        assert view.picture.func.__self__.nbytes <= 3 * 128 * 128 * 36


CHANGES = {
    "turned": lambda camera, other: {"world_to_camera": np.roll(np.eye(4), 1, axis=0)},
    "zoomed": lambda camera, other: {"fx": camera.fx * 1.01},
    "cropped": lambda camera, other: {"height": 100},
    "renamed": lambda camera, other: {"name": other.name},  # one camera would be compared with what the other sees
}


@pytest.mark.parametrize("change", CHANGES)
def test_cameras_that_move_have_no_plates(change):
    scene = open_scene(FOX_VIEWS)
    assert stands_still(scene)
    shots = list(scene.frames[2])
    other, camera = (shot.camera for shot in shots[:2])
    shots[1] = replace(shots[1], camera=replace(camera, **CHANGES[change](camera, other)))
    scene = replace(scene, frames=(*scene.frames[:2], tuple(shots), *scene.frames[3:]))
    assert not stands_still(scene)
    assert rested(Capture.of(scene, TrainSettings(), "cpu")).pictures.plates == {}
