"""What is particular to one form of cameras."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.scene.cameras.forms import INRIA_NEAR, PANOPTIC_NEAR, PLACEHOLDER
from airgs_codec.scene.cameras.read import read_posed
from tests.faces import SceneError, look_at, read_cameras
from tests.support.camera_files import (
    FORMS,
    as_inria,
    intrinsics_of,
    saved,
    write_panoptic_meta,
    write_splatv,
)
from tests.support.multiview_files import matrix_of
from tests.support.views import ring


@pytest.mark.parametrize("form", FORMS)
def test_near_planes_are_those_that_a_form_implies(tmp_path, form):
    near = {"inria": INRIA_NEAR, "splatv": INRIA_NEAR, "panoptic": PANOPTIC_NEAR}.get(form, 0)
    assert {c.near for c in read_cameras(FORMS[form](tmp_path, ring(2)))} == {near}


@pytest.mark.parametrize("form", FORMS)
def test_files_that_windows_wrote_are_read_alike(tmp_path, form):
    """With a byte-order mark, lines that end in CR LF, and backslashes in paths."""
    for name in "ab":
        (tmp_path / name).mkdir()
    plain = read_posed(FORMS[form](tmp_path / "a", ring(4, held_out=1)))
    place = FORMS[form](tmp_path / "b", ring(4, held_out=1))
    for path in place.parent.rglob("*"):
        if path.suffix in (".json", ".txt"):
            text = path.read_text().replace("images/", "images\\\\").replace("\n", "\r\n")
            path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    for a, b in zip(plain, read_posed(place), strict=True):
        assert (a.picture, a.camera.name, a.camera.split) == (b.picture, b.camera.name, b.camera.split)
        np.testing.assert_array_equal(a.camera.world_to_camera, b.camera.world_to_camera)


def entries_of(cameras, **fields):
    return [{"transform_matrix": matrix_of(c), **intrinsics_of(c), **fields} for c in cameras]


def read_entries(folder, entries, **shared):
    return read_cameras(saved(folder / "transforms.json", {**shared, "frames": entries}))


def test_a_lens_leaves_the_pinhole_camera_of_undistorted_pictures(tmp_path):
    plain = read_entries(tmp_path, entries_of(ring(1)))[0]
    bent = read_entries(tmp_path, entries_of(ring(1), k1=0.1, k2=0.01, camera_model="OPENCV"))[0]
    fisheye = read_entries(tmp_path, entries_of(ring(1), camera_model="OPENCV_FISHEYE"))[0]
    assert plain.fx == ring(1)[0].fx and abs(bent.fx - plain.fx) > 0.5 and abs(fisheye.fx - plain.fx) > 0.5
    np.testing.assert_array_equal(bent.world_to_camera, plain.world_to_camera)
    for wrong in ({"camera_model": "EQUIRECTANGULAR"}, {"k1": float("nan")}, {"k1": 0.1, "w": 10**20}):
        with pytest.raises(SceneError, match=r"json: expected a nerfstudio transforms\.json: camera"):
            read_entries(tmp_path, [entry | wrong for entry in entries_of(ring(1))])


def test_unnamed_cameras_count_once_for_each_place(tmp_path):
    """A rig that stands still is seen once, a camera that moves as often as it moved; names are those of pictures."""
    over_time = [
        {**e, "time": t, "file_path": f"cam{i}/{t}.png"} for t in range(3) for i, e in enumerate(entries_of(ring(2)))
    ]
    assert [c.name for c in read_entries(tmp_path, over_time)] == ["cam0", "cam1"]
    moving = [{**e, "time": t, "file_path": f"images/r_{t}"} for t, e in enumerate(entries_of(ring(5)))]
    assert [c.name for c in read_entries(tmp_path, moving)] == [f"r_{t}" for t in range(5)]
    assert [c.name for c in read_entries(tmp_path, entries_of(ring(2)))] == ["view000", "view001"]


def test_what_entries_share_may_stand_beside_them(tmp_path):
    shared = intrinsics_of(ring(1)[0]) | {"near": 0.3}
    entries = [{"transform_matrix": matrix_of(c)} for c in ring(3)]
    assert [(c.fx, c.near) for c in read_entries(tmp_path, entries, **shared)] == [(ring(1)[0].fx, 0.3)] * 3


def test_a_named_camera_that_trembles_has_its_first_pose(tmp_path):
    a, b = ring(2)
    entries = [{**e, "camera": "a", "time_index": t} for t, e in enumerate(entries_of([a, b]))]
    np.testing.assert_allclose([c.position for c in read_entries(tmp_path, entries)], [a.position])


def test_wide_pictures_of_inria_are_shown_as_it_shows_them(tmp_path):
    """Its file has their full size, its models were trained and are looked at in at most 1,600 pixels' width."""
    wide = replace(ring(1)[0], width=4946, height=3286, fx=4600.0, fy=4610.0)
    back = read_cameras(saved(tmp_path / "cameras.json", as_inria([wide])))[0]
    assert (back.width, back.height, back.cx, back.cy) == (1600, 1063, 800, 531.5)
    assert back.fx / back.width == pytest.approx(wide.fx / wide.width)  # the same field of view
    assert back.fy / back.height == pytest.approx(wide.fy / wide.height)


def test_the_camera_that_splatv_has_for_every_scene_is_refused(tmp_path):
    camera = look_at(np.array(PLACEHOLDER), np.zeros(3), np.array([0, -1.0, 0]), size=64, fov_y=1, name="00001")
    entry = as_inria([camera])[0] | {"position": PLACEHOLDER}
    header = json.dumps([{"type": "splat", "cameras": [entry]}]).encode()
    path = saved(tmp_path / "a.splatv", b"\x4b\x67\0\0" + len(header).to_bytes(4, "little") + header)
    with pytest.raises(SceneError, match="the one that splaTV writes into every file"):
        read_cameras(path)
    assert len(read_cameras(write_splatv(tmp_path, ring(3)))) == 3


def test_panoptic_has_one_camera_for_each_number_and_those_of_its_test_file_are_held_out(tmp_path):
    path = write_panoptic_meta(tmp_path, ring(9, held_out=2))
    assert [c.name for c in read_cameras(path)] == [f"cam{i:02d}" for i in range(9)]
    assert [c.name for c in read_cameras(path.with_name("test_meta.json"))] == ["cam07", "cam08"]
    assert all(c.held_out for c in read_cameras(path.with_name("test_meta.json")))


def test_frames_of_panoptic_without_pictures_are_refused(tmp_path):
    path = write_panoptic_meta(tmp_path, ring(2))
    data = json.loads(path.read_text())
    saved(path, data | {key: [data[key][0], []] for key in ("fn", "k", "w2c", "cam_id")})
    with pytest.raises(SceneError, match="a frame has no pictures"):
        read_cameras(path)


def colmap_model(folder, line):
    """One image taken by the camera of a line of cameras.txt."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(line + "\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 4 1 with spaces.png\n\n")
    return folder


def test_single_focal_lengths_and_names_with_spaces(tmp_path):
    (camera,) = read_cameras(colmap_model(tmp_path, "1 SIMPLE_PINHOLE 32 24 60 16 12"))
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.name) == (60, 60, 16, 12, "with spaces")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("1 FOV 32 24 60 62 16 12 0.1", "perspective or fisheye camera model, got FOV"),
        ("1 PINHOLE 32 24 60", "a camera model and its parameters, got PINHOLE with 1"),
        ("2 PINHOLE 32 24 60 62 16 12", "no 1"),  # the image's camera is not there
        ("1 PINHOLE wide 24 60 62 16 12", "invalid literal"),
    ],
)
def test_reconstructions_that_make_no_camera_are_refused(tmp_path, line, says):
    with pytest.raises(SceneError, match=rf"txt: expected a COLMAP reconstruction: .*{says}"):
        read_cameras(colmap_model(tmp_path, line))
