"""Camera paths: read, and what lies between keyframes; web/test/unit/keyframes.test.ts is the same in TypeScript."""

import json

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.scene.keyframes import read_camera_path
from tests.support.paths import REPOSITORY

CASES = json.loads((REPOSITORY / "tests" / "data" / "camera_paths.json").read_text())["cases"]
FIRST = {"t": 0, "position": [0, 0, -4], "focus": [0, 0, 0]}
LAST = {"t": 2, "position": [2, 0, -4], "focus": [2, 0, 0]}
PICTURE = {"camera_to_world": np.eye(4).ravel().tolist(), "fov": 50}


def read(tmp_path, data, *otherwise):
    file = tmp_path / "path.json"
    file.write_text(data if isinstance(data, str) else json.dumps(data))
    return read_camera_path(file, *otherwise)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_the_views_are_those_of_the_vectors(tmp_path, case):
    path = read(tmp_path, case["path"], np.array(case["up"]), case["fov_y"])
    table = np.array(case["views"])
    assert path.duration == case["duration"]
    assert path.at(table[:, 0]) == pytest.approx(table[:, 1:], abs=1e-9)


def test_it_comes_by_its_keyframes_and_goes_straight_between_two(tmp_path):
    path = read(tmp_path, {"keyframes": [FIRST, LAST]})
    seen = path.at(np.array([0.0, 0.5, 1.0, 2.0, 9.0]))
    assert seen[:, 0] == pytest.approx([0, 0.5, 1, 2, 2])
    assert seen[:, 3] == pytest.approx([0, 0.5, 1, 2, 2])


def test_a_loop_that_closes_is_smooth_where_it_does(tmp_path):
    path = read(tmp_path, next(case["path"] for case in CASES if case["name"] == "round"))
    before, at, after = path.at(np.array([3.999, 4.0, 4.001]))
    assert at - before == pytest.approx(after - at, abs=1e-4)


def test_nerfstudio_looks_along_minus_z_with_y_up(tmp_path):
    path = read(tmp_path, {"camera_path": [PICTURE], "fps": 24, "keyframes": []})
    assert path.at(np.zeros(1))[0].tolist() == [0, 0, 0, 0, 0, -1, 0, 1, 0, 50]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("{", "expected JSON"),
        ("[]", "expected a JSON object"),
        ({}, "no 'keyframes'"),
        ({"keyframes": []}, "no keyframe"),
        ({"keyframes": [FIRST, FIRST]}, "begin at 0 and ascend"),
        ({"keyframes": [LAST]}, "begin at 0 and ascend"),
        ({"keyframes": [FIRST], "loop": 1}, "loop is true or false"),
        ({"keyframes": [{**FIRST, "focus": [0, 0, -4]}]}, "keyframe 0 looks nowhere"),
        ({"keyframes": [{**FIRST, "up": [0, 0, 1]}]}, "keyframe 0 looks nowhere"),
        ({"keyframes": [{**FIRST, "focus": [0, 0]}]}, "not three numbers"),
        ({"keyframes": [{**FIRST, "position": [0, 0, "4"]}]}, "no finite number"),
        ('{"keyframes": [{"t": NaN, "position": [0, 0, 1], "focus": [0, 0, 0]}]}', "no finite number"),
        ({"keyframes": [{**FIRST, "fov_y": 180}]}, "fov_y of 180"),
        ({"keyframes": [{**FIRST, "fov": 40}]}, "fov, which means nothing"),
        ({"keyframes": [FIRST, {"t": 1, "position": [0, 0, 1]}]}, "no 'focus'"),
        ({"camera_path": [PICTURE, PICTURE], "fps": 0}, "division by zero"),
        ({"camera_path": [{**PICTURE, "camera_to_world": [1] * 15}], "fps": 1}, "cannot reshape"),
    ],
)
def test_what_is_no_path_is_refused_in_one_line(tmp_path, data, words):
    with pytest.raises(SceneError, match=words) as error:
        read(tmp_path, data)
    assert "path.json: expected" in str(error.value) and "\n" not in str(error.value)
