"""Opening scenes: the format is recognised, frames are cut out, what is broken is refused."""

import json
import shutil

import numpy as np
import pytest

from tests.faces import Pictures, SceneError, is_multiview, open_scene, with_held_out, with_near, write_png
from tests.support.camera_files import write_llff
from tests.support.multiview_files import matrix_of, plain, same_camera, write_panoptic, write_views
from tests.support.paths import FOX, FOX_VIEWS
from tests.support.views import coloured_cloud, ring


def test_frames_are_cut_out_and_points_stay_with_the_first(moving):
    assert len(open_scene(moving, frames=(1, None))) == 1
    assert open_scene(moving, frames=(1, None)).points is None
    with pytest.raises(SceneError, match="frames inside 0:2, got 1:5"):
        open_scene(moving, frames=(1, 5))


def test_what_is_multiview_and_what_is_a_sequence(tmp_path, moving):
    assert is_multiview(FOX_VIEWS) and is_multiview(moving)
    assert not is_multiview(FOX)  # .ply frames beside its transforms.json
    assert not is_multiview(tmp_path)


def broken(tmp_path, what):
    folder = tmp_path / "broken"
    g = coloured_cloud(30)
    if what == "nothing":
        folder.mkdir()
    elif what == "poses":
        folder.mkdir()
        write_llff(folder, ring(2))
    elif what == "colmap":
        (folder / "sparse" / "0").mkdir(parents=True)
        (folder / "sparse" / "0" / "images.bin").write_bytes(b"12")
    else:
        write_views(folder, [g], ring(3), None)
        path = folder / "transforms.json"
        data = json.loads(path.read_text())
        if what == "json":
            path.write_text("{")
        elif what == "no frames":
            path.write_text(json.dumps({**data, "frames": []}))
        elif what == "matrix":
            data["frames"][0]["transform_matrix"] = [[1, 2]]
            path.write_text(json.dumps(data))
        elif what == "missing picture":
            (folder / "images" / "cam01" / "0000.png").unlink()
        elif what == "size":
            write_png(folder / "images" / "cam01" / "0000.png", plain(3))
        elif what == "text":
            (folder / "images" / "cam01" / "0000.png").write_text("no picture")
        elif what == "points":
            (folder / "points3d.npy").write_bytes(b"\x93NUMPY\1\0\2\0(\n")  # which looks like Python to numpy
    return folder


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (
            "nothing",
            "pictures with train_meta.json, transforms.json, image_white_undistortion/ .HiFi4G., COLMAP.s sparse/ or ",
        ),
        ("poses", "a row for each of 0 videos, got 2"),
        ("colmap", "expected a COLMAP reconstruction"),
        ("json", "expected JSON"),
        ("no frames", "at least one picture"),
        ("matrix", "expected a nerfstudio transforms.json"),
        ("missing picture", "0000.png: expected a picture: No such file"),
        ("size", "expected a picture of 48x48, got 32x24"),
        ("text", "expected a picture: cannot identify"),
        ("points", "expected rows of x, y, z"),
    ],
)
def test_broken_scenes_are_refused_in_one_line(tmp_path, what, message):
    with pytest.raises(SceneError, match=message) as caught:
        Pictures(open_scene(broken(tmp_path, what))).check()
    assert "\n" not in str(caught.value)


def test_the_embedded_views_open_with_their_cameras_and_points():
    scene = open_scene(FOX_VIEWS)
    assert len(scene) == 6 and len(scene.frames[0]) == 20 and scene.fps == 24
    assert len(scene.points.positions) == 2500
    views = Pictures(scene).train(5)
    assert len(views) == 16 and views[0].target.rgb.shape == (128, 128, 3)


def test_transforms_gives_back_the_cameras_that_were_written(moving):
    scene = open_scene(moving)
    assert [len(f) for f in scene.frames] == [6, 6]
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(6), strict=True))
    assert [c.split for c in scene.cameras] == ["train"] * 5 + ["test"]


@pytest.mark.parametrize("fps", ["1e30000000", "1/0", 0, -3, "fast"])
def test_what_is_no_frame_rate_is_refused_at_once(moving, fps):
    path = moving / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"fps": fps}))
    with pytest.raises(SceneError, match=r"transforms\.json: expected"):
        open_scene(moving)


def test_unnamed_cameras_have_one_name_at_all_times(moving):
    """That of the folder of their pictures: what is held out or exposed alike is told by it."""
    path = moving / "transforms.json"
    data = json.loads(path.read_text())
    for entry in data["frames"]:
        del entry["camera"]
    path.write_text(json.dumps(data))
    names = [[shot.camera.name for shot in frame] for frame in open_scene(moving).frames]
    assert names == [[c.name for c in ring(6)]] * 2


def write_ns_process_data(folder, camera, **shared):
    """What `ns-process-data images` leaves: pictures in several sizes, a lens, points of another name."""
    entries = []
    for i, c in enumerate(ring(9)):
        for place, shrink in (("images", 1), ("images_2", 2), ("images_4", 4)):
            (folder / place).mkdir(parents=True, exist_ok=True)
            write_png(folder / place / f"frame_{i + 1:05d}.png", plain(90, (48 // shrink, 48 // shrink)))
        name = f"images/frame_{i + 1:05d}.png"
        entries.append({"file_path": name, "transform_matrix": matrix_of(c), "colmap_im_id": i + 1})
    lens = {"camera_model": "OPENCV", "k1": 0.05, "k2": -0.01, "p1": 0.001, "p2": 0.002}
    size = {"w": 48, "h": 48, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
    turned = {"applied_transform": [[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0]]}
    data = {**size, **lens, "frames": entries, **turned, "ply_file_path": "sparse_pc.ply", **shared}
    (folder / "transforms.json").write_text(json.dumps(data))
    header = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(f"property float {c}\n" for c in "xyz")
    colours = "".join(f"property uint8 {c}\n" for c in ("red", "green", "blue"))
    (folder / "sparse_pc.ply").write_text(f"{header}{colours}end_header\n0.5 1 1.5 255 0 51\n0 0 0 0 0 0\n")
    return folder


def test_ns_process_data_is_a_scene_of_one_frame(tmp_path):
    folder = write_ns_process_data(tmp_path, ring(1)[0])
    assert is_multiview(folder)  # though there is a .ply
    scene = open_scene(folder)
    assert len(scene) == 1 and [c.name for c in scene.cameras][:2] == ["frame_00001", "frame_00002"]
    assert scene.points.positions[0].tolist() == [0.5, 1, 1.5]  # in the axes of the cameras, as nerfstudio has both
    assert scene.points.colours[0] == pytest.approx([1, 0, 0.2])
    assert all(np.allclose(a.position, b.position, atol=1e-6) for a, b in zip(scene.cameras, ring(9), strict=True))
    view = Pictures(scene).train(0)[0]
    assert view.target.rgb.shape == (48, 48, 3) and view.target.rgb.min() > 0.34  # undistorted, no black borders
    assert sum(c.held_out for c in with_held_out(scene, None).cameras) == 1


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"ply_file_path": "cloud.ply"}, "the points of ply_file_path: got no file cloud.ply"),
        ({"ply_file_path": 3}, "the points of ply_file_path: got no file 3"),
        ({"camera_model": "EQUIRECTANGULAR"}, "no perspective"),
        ({"camera_model": "FISHEYE624"}, "no perspective"),
        ({"k4": 0.1}, "k4 of 0.1"),
    ],
)
def test_what_ns_process_data_may_hold_and_we_do_not_take(tmp_path, fields, message):
    folder = write_ns_process_data(tmp_path, ring(1)[0], **fields)
    with pytest.raises(SceneError, match=message) as caught:
        open_scene(folder)
    assert "\n" not in str(caught.value)


def test_a_fisheye_of_ns_process_data_is_undistorted(tmp_path):
    fisheye = {"camera_model": "OPENCV_FISHEYE", "k1": 0.02, "k2": 0.0, "k3": 0.0, "k4": 0.001}
    scene = open_scene(write_ns_process_data(tmp_path, ring(1)[0], **fisheye))
    assert scene.frames[0][0].lens.fisheye
    assert Pictures(scene).train(0)[0].target.rgb.min() > 0.3


def test_panoptic_reads_cameras_and_masks(tmp_path):
    scene = open_scene(write_panoptic(tmp_path, ring(9)))
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(9), strict=True))
    whole = Pictures(scene).train(0)[0].target.rgb
    cut = Pictures(scene, foreground=True).train(0)[0].target.rgb
    assert whole[:, :24].min() > 0.7
    assert cut[:, :24].max() == 0 and cut[:, 24:].min() > 0.7


def test_panoptic_brings_its_points(tmp_path):
    folder = write_panoptic(tmp_path, ring(3))
    table = np.random.default_rng(0).uniform(0, 1, (9, 7)).astype(np.float32)
    np.savez(folder / "init_pt_cld.npz", data=table)
    points = open_scene(folder).points
    assert (points.positions == table[:, :3]).all() and (points.colours == table[:, 3:6]).all()
    np.savez(folder / "init_pt_cld.npz", other=table)
    with pytest.raises(SceneError, match=r"init_pt_cld\.npz: expected rows of x, y, z"):
        open_scene(folder)


@pytest.mark.parametrize("name", ["", ".", "/", "a\nb", "a\x1b[2J", "a\0", "a" * 256], ids=ascii)
def test_a_picture_without_a_name_is_refused_in_one_line(tmp_path, moving, name):
    path = write_panoptic(tmp_path, ring(3)) / "train_meta.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"fn": [[name] * 3]}))
    views = shutil.copytree(moving, tmp_path / "views") / "transforms.json"
    meta = json.loads(views.read_text())
    meta["frames"][0]["file_path"] = name
    views.write_text(json.dumps(meta))
    for folder in (tmp_path, tmp_path / "views") if name else (tmp_path,):
        with pytest.raises(SceneError, match=r"meta\.json: expected|transforms\.json: expected") as caught:
            open_scene(folder)
        assert "name" in str(caught.value) and str(caught.value).isprintable()


def test_cameras_of_the_test_file_are_held_out(tmp_path):
    write_panoptic(tmp_path, ring(3))
    meta = json.loads((tmp_path / "train_meta.json").read_text())
    meta["cam_id"] = [[7, 8, 9]] * 2
    (tmp_path / "test_meta.json").write_text(json.dumps(meta))
    scene = with_held_out(open_scene(tmp_path), None)
    assert [(c.name, c.held_out) for c in scene.cameras][2:4] == [("cam02", False), ("cam07", True)]
    assert [len(frame) for frame in scene.frames] == [6, 6]


def test_near_planes_come_with_the_scene(tmp_path):
    scene = open_scene(write_panoptic(tmp_path, ring(2)))
    assert {c.near for c in scene.cameras} == {0.8}
    assert {c.near for c in with_near(scene, 2.0).cameras} == {2.0}
