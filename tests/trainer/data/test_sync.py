"""Cameras that are not in step are found and matched."""

import json
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from airgs_codec.scene.camera import BLACK
from airgs_codec.trainer.data.multiview import Source
from airgs_codec.trainer.data.sync import FEWEST, find_offsets, in_step, read_offsets
from tests.faces import (
    Capture,
    MultiviewScene,
    Pictures,
    SceneError,
    Shot,
    TrainSettings,
    Work,
    content_of,
    open_store,
    read_contents,
    rested,
    write_png,
)
from tests.support.multiview_files import plain
from tests.support.views import ring

FRAMES = 20
SIZE = 96


@dataclass(frozen=True, slots=True)
class Shown:
    """A picture in memory, in place of a `Source`."""

    rgb: np.ndarray
    files = ()
    content = None

    def read(self, size):
        return self.rgb

    def check(self, size):
        pass


def drawn(camera, time, still=False):
    """What a camera sees of three balls that hurry about, each in its own way, at a time in frames."""
    picture = np.full((SIZE, SIZE, 3), 40, np.uint8)
    for ball in range(0 if still else 3):
        phase = 0.55 * time / (1 + 0.4 * ball) + 2 * ball
        place = np.array([np.sin(phase), 0.7 * np.sin(1.7 * phase + ball), np.cos(0.8 * phase)]) * 0.9
        x, y, depth = camera.world_to_camera[:3, :3] @ place + camera.world_to_camera[:3, 3]
        at = (camera.fx * x / depth + camera.cx - 0.5, camera.fy * y / depth + camera.cy - 0.5)
        radius = 0.2 * camera.fx / depth
        cv2.circle(picture, [round(16 * v) for v in at], round(16 * radius), (220, 200, 90), -1, cv2.LINE_AA, shift=4)
    return picture


def filmed(late, frames=FRAMES, still=False):
    """Six cameras all around, each late by so many frames, and a little noise."""
    rng = np.random.default_rng(0)

    def shown(camera, time):
        noisy = drawn(camera, time, still) + rng.normal(0, 1.5, (SIZE, SIZE, 3))
        return Shot(camera, Shown(np.clip(noisy, 0, 255).astype(np.uint8)))

    cameras = ring(6, SIZE)
    shots = (tuple(shown(c, t - late.get(c.name, 0.0)) for c in cameras) for t in range(frames))
    return MultiviewScene(Path("balls"), Fraction(30), tuple(shots))


def test_offsets_are_found_to_a_quarter_of_a_frame():
    late = {"cam01": 2.0, "cam02": -1.25, "cam04": 3.5}
    found = find_offsets(filmed(late))
    assert found.keys() == late.keys()
    assert all(abs(found[name] - late[name]) <= 0.25 for name in late)


@pytest.mark.parametrize("scene", [filmed({}), filmed({}, still=True), filmed({"cam01": 2.0}, frames=FEWEST - 1)])
def test_nothing_is_said_of_a_rig_in_step_or_where_nothing_moves_or_too_little_is_seen(scene):
    assert find_offsets(scene) == {}


def test_cameras_that_move_are_not_looked_at():
    scene = filmed({"cam01": 2.0})
    turned = replace(scene.cameras[0], world_to_camera=scene.cameras[1].world_to_camera)
    frames = list(scene.frames)
    frames[3] = (replace(frames[3][0], camera=turned), *frames[3][1:])
    moving = replace(scene, frames=tuple(frames))
    assert find_offsets(moving) == {}
    with pytest.raises(SceneError, match="stand still"):
        in_step(moving, {"cam01": 2.0})


def test_a_scene_in_step_shows_each_camera_at_its_own_time():
    late = {"cam01": 2.0, "cam02": -1.0}
    scene = filmed(late)
    matched = in_step(scene, late)
    assert len(matched) == FRAMES - 3 and matched.offsets == late
    few = in_step(scene, late, (0, 4))
    assert few.frames == matched.frames[:4]  # as many as are wanted, from the first that all cameras have
    assert len(in_step(scene, late, (FRAMES - 6, None))) == 4 and in_step(scene, {}, (2, 5)).frames == scene.frames[2:5]
    with pytest.raises(SceneError, match="frames inside"):
        in_step(scene, late, (3, FRAMES + 1))
    assert matched.frames[0][0] is scene.frames[1][0]  # frame 0 of the first camera would be frame -1 of cam02
    assert matched.frames[0][1] is scene.frames[3][1] and matched.frames[0][2] is scene.frames[0][2]
    assert matched.frames[-1][1] is scene.frames[-1][1]
    assert find_offsets(matched) == {}
    assert in_step(scene, {"cam01": 0.0}).frames == scene.frames


def files(folder, masks=False):
    """A scene of pictures in files: two cameras, five frames, brighter with time."""
    cameras = ring(2, 32)
    frames = []
    for t in range(5):
        shots = []
        for camera in cameras:
            path, mask = folder / f"{camera.name}-{t}.png", folder / f"mask-{camera.name}-{t}.png"
            write_png(path, plain(20 * t + 10, (32, 32)))
            write_png(mask, plain(255, (32, 32)))
            shots.append(Shot(camera, Source(path), None, mask))
        frames.append(tuple(shots))
    return MultiviewScene(folder, Fraction(30), tuple(frames), None, BLACK)


def test_a_fraction_of_a_frame_takes_the_nearest_picture_and_says_when_it_was_taken(tmp_path):
    scene = files(tmp_path)
    for offset, nearest, after in ((0.75, 2, 0.25), (0.25, 1, -0.25), (0.5, 1, -0.5), (-0.5, 0, -0.5), (-1.0, 0, 0.0)):
        matched = in_step(scene, {"cam01": offset}, (0, 5))
        first = math.ceil(max(0.0, -offset))
        shot = matched.frames[1 - first][1]
        assert (shot.source.path.name, shot.after) == (f"cam01-{nearest}.png", after)
        assert shot.mask == tmp_path / f"mask-cam01-{nearest}.png" and matched.frames[0][0].after == 0.0
        assert Pictures(matched).view(1 - first, 1).after == after
    other = in_step(scene, {"cam01": 0.625})  # the same files, and masks
    contents = read_contents(scene, Work(open_store(tmp_path / "work")))
    assert content_of(in_step(scene, {"cam01": 0.75}), contents)[2][1] != content_of(other, contents)[2][1]


def test_a_first_frame_is_fitted_to_both_pictures_of_a_camera_that_was_early(tmp_path):
    capture = Capture.of(in_step(files(tmp_path), {"cam01": 0.25}), TrainSettings(), "cpu")
    target = capture.first()
    assert [view.after for view in target.views] == [0.0, -0.25]
    assert [(view.camera.name, view.after) for view in target.later] == [("cam01", 0.75)]
    assert abs(float(target.later[0].target.rgb.mean()) - 30 / 255) < 1e-3  # that of frame 1
    assert not Capture.of(files(tmp_path), TrainSettings(), "cpu").first().later


def test_a_frame_that_begins_a_group_shows_nothing_from_before_it(tmp_path):
    matched = in_step(files(tmp_path), {"cam01": 0.25})
    capture = rested(Capture.of(matched, TrainSettings(), "cpu"))
    for frame, seen in ((1, [("cam00", 0.0), ("cam01", 0.75)]), (len(matched) - 1, [("cam00", 0.0)])):
        target = capture.key(capture.target(frame, frame - 1))
        assert [(view.camera.name, view.after) for view in target.views] == seen
        assert len(target.moving) == len(seen)
    still = Capture.of(files(tmp_path), TrainSettings(), "cpu").target(1, 0)
    assert capture.key(still) is still


@pytest.mark.parametrize(
    ("offsets", "message"), [({"cam09": 1}, "no camera cam09"), ({"cam01": 5}, "leave a frame of 5 to all cameras")]
)
def test_offsets_that_cannot_be(tmp_path, offsets, message):
    with pytest.raises(SceneError, match=message):
        in_step(files(tmp_path), offsets)


@pytest.mark.parametrize("text", ["[1]", '{"cam01": "2"}', '{"cam01": NaN}', '{"cam01": true}', "{"])
def test_a_file_of_offsets_that_is_none(tmp_path, text):
    path = tmp_path / "offsets.json"
    path.write_text(text)
    with pytest.raises(SceneError, match=r"offsets\.json"):
        read_offsets(path)
    path.write_text(json.dumps({"cam01": -2}))
    assert read_offsets(path) == {"cam01": -2.0}
