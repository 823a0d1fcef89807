"""Callers make cameras, draw what they decode, and look at packages in notebooks."""

import base64
import re
from dataclasses import replace

import numpy as np
import pytest

import airgs_codec as airgs
from tests.faces import read_picture, to_bytes
from tests.support.paths import FOX, GOLDEN
from tests.support.regions import is_inside
from tests.support.scenes import moving_frames
from tests.support.servers import plainly_serving, serving

PACKAGE = GOLDEN / "fox"


def test_a_frame_is_a_png_in_four_lines(tmp_path):
    package = airgs.open_package(PACKAGE)
    picture = airgs.draw(airgs.decode(package, 0), package.cameras[0])
    picture.save(tmp_path / "frame.png")
    assert (read_picture(tmp_path / "frame.png") == to_bytes(picture.rgb)).all()
    assert picture.rgb.std() > 0.05


def test_a_notebook_shows_the_poster_and_escaped_words(tmp_path):
    settings = airgs.EncodeSettings(calibrate="none", measure_pictures=0, preset="ultrafast")
    camera = airgs.Camera.look_at((0, 0, -4), (0, 0, 0), size=(64, 48))
    sequence = airgs.Sequence.from_arrays(moving_frames(60, 2), cameras=[camera])
    where = tmp_path / "<i>.airgs"
    airgs.encode(replace(sequence, credit="points by <nobody>"), where, settings)
    page = airgs.open_package(where)._repr_html_()
    (data,) = re.findall('<img src="data:image/jpeg;base64,([^"]*)"', page)
    assert base64.b64decode(data) == (where / "poster.jpg").read_bytes()
    assert "&lt;i&gt;.airgs: 2 frames at 30 a second" in page and "points by &lt;nobody&gt;" in page
    assert "<i>" not in page
    (where / "poster.jpg").unlink()
    assert "<img" not in airgs.open_package(where)._repr_html_()


def test_cameras_of_a_package_are_inside_its_region():
    package = airgs.open_package(PACKAGE)
    region = package.manifest.region
    assert len(package.cameras) == len(region.places)
    assert all(is_inside(region, camera) for camera in package.cameras)


def test_a_camera_sees_its_target_in_the_middle_and_up_is_up():
    camera = airgs.Camera.look_at((3, 1, -2), (0, 1, 4), (0, 1, 0), size=(200, 100), fov_y=60)
    inside = camera.world_to_camera @ [[0, 3], [1, 1.5], [4, -2], [1, 1]]
    x, y, z = inside[:3, 0]
    assert (camera.width, camera.height, camera.cx, camera.cy) == (200, 100, 100, 50)
    assert abs(x) < 1e-9 and abs(y) < 1e-9 and z > 0
    assert inside[1, 1] < 0, "y is down in OpenCV's axes"
    assert np.isclose(2 * np.degrees(np.arctan(50 / camera.fy)), 60) and camera.fx == camera.fy
    assert np.allclose(camera.position, (3, 1, -2))


def test_a_camera_is_made_of_either_matrix_and_of_either_lens():
    seen = airgs.Camera.look_at((3, 1, -2), (0, 1, 4), size=(200, 100), fov_y=60)
    pose = np.linalg.inv(seen.world_to_camera)
    lens = [[seen.fx, 0, 100], [0, seen.fy, 50], [0, 0, 1]]
    for matrix in ({"camera_to_world": pose}, {"world_to_camera": seen.world_to_camera[:3].tolist()}):
        for kind in ({"fov_y": 60}, {"intrinsics": lens}):
            made = airgs.Camera.from_matrix(**matrix, **kind, size=(200, 100), name=seen.name)
            assert np.allclose(made.world_to_camera, seen.world_to_camera)
            assert (made.width, made.height) == (200, 100)
            assert np.allclose((made.fx, made.fy, made.cx, made.cy), (seen.fx, seen.fy, 100, 50))


EYE = np.eye(4)


@pytest.mark.parametrize(
    ("more", "line"),
    [
        ({}, "expected camera_to_world or world_to_camera"),
        ({"camera_to_world": EYE, "world_to_camera": EYE, "fov_y": 50}, "got both or none"),
        ({"camera_to_world": EYE}, "fov_y or intrinsics"),
        ({"camera_to_world": 2 * EYE, "fov_y": 50}, "not a rotation"),
        ({"camera_to_world": 0 * EYE, "fov_y": 50}, "camera_to_world"),
        ({"world_to_camera": np.eye(3), "fov_y": 50}, "world_to_camera: expected finite numbers of shape"),
        ({"world_to_camera": EYE * np.nan, "fov_y": 50}, "world_to_camera: expected finite"),
        ({"world_to_camera": EYE, "fov_y": 180}, "focal lengths"),
        ({"world_to_camera": EYE, "fov_y": "wide"}, "fov_y: expected finite numbers"),
        ({"world_to_camera": EYE, "fov_y": 50, "size": (0, 10)}, "has size 0x10"),
        ({"world_to_camera": EYE, "fov_y": 50, "size": 64}, "size: expected finite numbers of shape"),
    ],
)
def test_a_camera_that_is_none_is_refused(more, line):
    with pytest.raises(airgs.AirgsError, match=line) as caught:
        airgs.Camera.from_matrix(**{"size": (64, 64)} | more)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "more", [{"target": (1, 1, 1)}, {"up": (0, 0, 0)}, {"target": (1, 2)}, {"target": (0, 0, np.inf)}, {"fov_y": 0}]
)
def test_a_camera_that_looks_nowhere_is_refused(more):
    with pytest.raises(airgs.AirgsError):
        airgs.Camera.look_at(**{"position": (1, 1, 1), "target": (0, 0, 0), "size": (64, 64)} | more)


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ((airgs.read(FOX / "000000.ply"), "front"), "camera: expected a Camera, got str 'front'"),
        (
            (FOX, airgs.Camera.look_at((0, 0, 1), (0, 0, 0), size=(8, 8))),
            "gaussians: expected Gaussians or a mapping",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(given, line):
    with pytest.raises(airgs.AirgsError, match=line):
        airgs.draw(*given)


@pytest.mark.parametrize("name", ["frame.jpg", "none/frame.png"])
def test_a_picture_that_cannot_be_written_is_refused(name, tmp_path):
    camera = airgs.Camera.look_at((0, 0, -3), (0, 0, 0), size=(16, 16))
    picture = airgs.draw(airgs.read(FOX / "000000.ply"), camera)
    with pytest.raises(airgs.AirgsError, match=re.escape(name)):
        picture.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_notebook_shows_the_player_of_a_package_that_is_served_with_one(tmp_path):
    with serving(PACKAGE) as port:
        served = airgs.open_package(f"http://127.0.0.1:{port}/{PACKAGE.name}")._repr_html_()
    assert f'<iframe src="http://127.0.0.1:{port}/{PACKAGE.name}/"' in served and "<img" not in served
    with plainly_serving(PACKAGE) as port:
        plain = airgs.open_package(f"http://127.0.0.1:{port}")._repr_html_()
    assert "<iframe" not in plain
