"""Cameras of every form: the same rig comes back from each, what is broken is refused, what lies beside is found."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.scene.cameras.read import find_cameras
from tests.faces import SceneError, read_cameras
from tests.support.camera_files import FORMS, MARK_HELD_OUT, as_inria, write_colmap_text, write_inria, write_transforms
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence
from tests.support.views import ring


@pytest.fixture(scope="module")
def rig():
    """Of the embedded scene: 20 cameras, 4 held out."""
    return read_cameras(FOX / "transforms.json")


def assert_same(back, rig):
    assert len(back) == len(rig)
    for a, b in zip(back, rig, strict=True):
        assert (a.width, a.height) == (b.width, b.height)
        np.testing.assert_allclose(a.position, b.position, atol=1e-6)
        np.testing.assert_allclose(a.world_to_camera[:3, :3], b.world_to_camera[:3, :3], atol=1e-6)
        np.testing.assert_allclose([a.fx, a.fy, a.cx, a.cy], [b.fx, b.fy, b.cx, b.cy], atol=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_one_rig_is_the_same_from_every_form(tmp_path, rig, form):
    path = FORMS[form](tmp_path, rig)
    in_order = sorted(rig, key=lambda c: c.held_out) if form == "panoptic" else rig
    for given in (path, tmp_path):  # the file or COLMAP's model, and a folder with it
        back = read_cameras(given)
        assert_same(back, in_order)
        held_out = [c.held_out for c in in_order] if form in MARK_HELD_OUT else [False] * len(rig)
        assert [c.held_out for c in back] == held_out


@pytest.mark.parametrize("form", [form for form in FORMS if "colmap" not in form])
def test_a_file_is_known_by_what_it_holds(tmp_path, form):
    path = FORMS[form](tmp_path / "a" if form != "llff" else tmp_path, ring(3))
    other = tmp_path / "b" / "some.json"
    other.parent.mkdir()
    shutil.copy(path, other)
    assert_same(read_cameras(other), ring(3))
    if form != "llff":
        assert len(read_cameras(other.parent)) == 3


@pytest.mark.parametrize("form", FORMS)
def test_pictures_that_are_wider_than_high_are_so_in_every_form(tmp_path, form):
    wide = [replace(c, width=2 * c.width, cx=c.width) for c in ring(3)]
    assert_same(read_cameras(FORMS[form](tmp_path, wide)), wide)


def test_a_mark_before_the_text_is_no_part_of_it(tmp_path):
    path = write_inria(tmp_path, ring(2))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_cameras(path.rename(tmp_path / "rig.txt"))) == 2


def test_a_file_of_a_reconstruction_stands_for_all_of_it(tmp_path):
    model = write_colmap_text(tmp_path, ring(3))
    assert len(read_cameras(model / "images.txt")) == len(read_cameras(model / "cameras.txt")) == 3


def test_a_folder_of_several_is_not_guessed_at(tmp_path):
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(json.dumps(as_inria(ring(2))))
    with pytest.raises(SceneError, match=r"got several: a\.json, b\.json"):
        read_cameras(tmp_path)


@pytest.mark.parametrize("content", ["{}", "[]", "[1]", '{"frames": 3}', '{"k": [], "w2c": [], "cam_id": []}', "{", ""])
def test_what_is_no_cameras_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "cameras.json").write_text(content)
    with pytest.raises(SceneError, match=r"cameras\.json: expected") as caught:
        read_cameras(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_header_of_numpy_that_is_broken_is_refused_in_one_line(tmp_path):
    path = FORMS["llff"](tmp_path, ring(3))
    path.write_bytes(path.read_bytes().replace(b"}", b"("))
    with pytest.raises(SceneError, match=r"poses_bounds\.npy: expected rows of 17 numbers: its header is broken"):
        read_cameras(path)


def test_an_array_of_more_bytes_than_any_machine_has_is_refused_in_one_line(tmp_path):
    path = FORMS["llff"](tmp_path, ring(3))
    path.write_bytes(path.read_bytes().replace(b"(3, 17), }" + b" " * 12, b"(3" + b"0" * 12 + b", 17), }"))
    with pytest.raises(SceneError, match=r"poses_bounds\.npy: expected rows of 17 numbers: Unable to allocate"):
        read_cameras(path)


def test_nothing_an_empty_folder_and_another_file_are_refused(tmp_path):
    with pytest.raises(SceneError, match=r"none: expected cameras .* No such file"):
        read_cameras(tmp_path / "none")
    with pytest.raises(SceneError, match="got none of them"):
        read_cameras(tmp_path)
    (tmp_path / "text.md").write_text("# words")
    with pytest.raises(SceneError, match=r"text\.md: expected cameras"):
        read_cameras(tmp_path / "text.md")


@pytest.mark.parametrize("form", FORMS)
def test_every_file_cut_short_is_refused_in_one_line(tmp_path, form):
    path = FORMS[form](tmp_path, ring(3))
    broken = 0
    for file in [path] if path.is_file() else sorted(path.glob("[ci]*.*")):
        whole = file.read_bytes()
        for length in {0, 7, 12, 40, len(whole) // 2, int(len(whole) * 0.9)}:
            file.write_bytes(whole[:length])
            try:
                assert len(read_cameras(path)) <= 3  # a text may end after a whole line
            except SceneError as error:
                assert "expected" in str(error) and "\n" not in str(error)
                broken += 1
        file.write_bytes(whole)
    assert broken >= 4


def changed(rig, **fields):
    return [replace(rig[0], **fields), *rig[1:]]


STRETCHED = np.diag([1.0, 2.0, 1.0, 1.0])
MIRRORED = np.diag([1.0, -1.0, 1.0, 1.0])
WRONG = [
    ({"fx": float("nan"), "fy": float("nan")}, "not finite", ()),
    ({"fx": -5.0, "fy": -5.0}, "above 0", ()),
    ({"width": 10**6}, "pixels", ("inria", "splatv")),  # which show wide pictures at another width
    ({"world_to_camera": STRETCHED}, "rotation", ("colmap text", "colmap binary")),  # quaternions of any norm
    ({"world_to_camera": MIRRORED}, "rotation", ("colmap text", "colmap binary")),
]


@pytest.mark.parametrize(
    ("form", "fields", "says"),
    [(form, fields, says) for fields, says, but in WRONG for form in FORMS if form not in (*but, "nerfstudio")],
)
def test_a_camera_that_is_none_is_refused_in_every_form(tmp_path, form, fields, says):
    path = FORMS[form](tmp_path, changed(ring(3), **fields))
    with pytest.raises(SceneError, match=says) as caught:
        read_cameras(path)
    assert str(path.parent) in str(caught.value)


@pytest.mark.parametrize(
    ("frames", "cameras"),
    [
        ("scene", "scene"),
        ("model/point_cloud/iteration_30000", "model"),  # as INRIA's code leaves its models
        ("model/gaussian_pertimestamp", "model"),  # as 4DGaussians adds frames to one
    ],
)
def test_cameras_beside_a_scene_are_found(tmp_path, frames, cameras):
    scene = write_sequence(tmp_path / frames, moving_frames(4, 1), cameras=False)
    (tmp_path / "model" / "point_cloud").mkdir(parents=True, exist_ok=True)
    assert find_cameras(scene) is None
    path = write_inria(tmp_path / cameras, ring(3))
    assert find_cameras(scene).resolve() == path.resolve()


def test_cameras_of_another_scene_are_not_taken(tmp_path):
    scene = write_sequence(tmp_path / "many" / "scene", moving_frames(4, 1), cameras=False)
    write_inria(tmp_path / "many", ring(3))
    (scene / "notes.json").write_text(json.dumps(as_inria(ring(2))))
    assert find_cameras(scene) is None


def test_the_first_form_beside_a_scene_is_taken(tmp_path):
    model = write_colmap_text(tmp_path, ring(3))
    assert find_cameras(tmp_path) == model
    for write in (write_inria, write_transforms):
        path = write(tmp_path, ring(3))
        assert find_cameras(tmp_path) == path
