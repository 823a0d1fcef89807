"""Opening scenes: the format is recognised, frames are cut out, what is broken or promises too much is refused."""

import json
import os
import resource
import shutil
import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from tests import faces
from tests.faces import Pictures, SceneError, is_multiview, load_usage, open_scene, with_held_out, write_png
from tests.support.camera_files import write_colmap_binary, write_colmap_text, write_llff, write_panoptic
from tests.support.multiview_files import matrix_of, plain, same_camera, write_video
from tests.support.paths import FOX, FOX_VIEWS
from tests.support.views import ring

UNIT = np.eye(4).tolist()
CAMERA = {"w": 8, "h": 8, "fl_x": 8, "fl_y": 8, "cx": 4, "cy": 4}
RIG = 11  # cameras of HiFi4G, numbered without leading zeros: 10 comes after 9, whatever COLMAP's order of names
FRAMES = (30, 31, 100)


def changed(path, **fields):
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))
    return path.parent


def write_colmap(folder, names, camera="PINHOLE 32 24 60 62 16 12", binary=False):
    """A reconstruction in COLMAP's own words; gives pycolmap's view of it."""
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    (sparse / "cameras.txt").write_text(f"1 {camera}\n")
    poses = (f"{i + 1} {np.cos(i / 10)} 0 {np.sin(i / 10)} 0 {i / 10} 0.2 4 1" for i in range(len(names)))
    (sparse / "images.txt").write_text("".join(f"{p} {n}\n10 10 1\n" for p, n in zip(poses, names, strict=True)))
    tracks = " ".join(f"{i + 1} 0" for i in range(len(names)))
    (sparse / "points3D.txt").write_text(f"1 0.1 0.2 0.3 255 128 0 0.5 {tracks}\n")
    model = pycolmap.Reconstruction(str(sparse))
    if binary:
        model.write_binary(str(sparse))
        for file in sparse.glob("*.txt"):
            file.unlink()
    return model


def write_pictures(folder, pictures):
    for name, picture in pictures.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_png(folder / name, picture)


def write_hifi4g(folder, write=write_colmap_binary, moved=False):
    """`moved`: the reconstruction lies beside the frames, where some tools put it, instead of among them."""
    pictures = folder / "image_white_undistortion"
    rig = [replace(camera, name=str(i)) for i, camera in enumerate(ring(RIG))]
    write(folder / "colmap" if moved else pictures / "colmap", rig)
    for t, frame in enumerate(FRAMES):
        write_pictures(pictures / str(frame), {f"{i}.png": plain(100 + 10 * i + t, (48, 48)) for i in range(RIG)})
    (folder / "image_white").mkdir()
    return folder


def hifi4g_without(folder, *names):
    write_hifi4g(folder)
    for path in (folder / "image_white_undistortion" / name for name in names):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return folder


def write_n3dv(folder, *names, rows):
    """A scene as N3DV is downloaded: its matrices are of videos twice the size of these."""
    write_llff(folder, ring(rows, size=96))
    for i, name in enumerate(names):
        write_video(folder / name, [plain(40 + 10 * i + t, (48, 48)) for t in range(3)])
    return folder


def write_ns_process_data(folder, **shared):
    """What `ns-process-data images` leaves: pictures in several sizes, a lens, points of another name."""
    entries = []
    for i, c in enumerate(ring(9), start=1):
        for place, size in (("images", 48), ("images_2", 24), ("images_4", 12)):
            write_pictures(folder / place, {f"frame_{i:05d}.png": plain(90, (size, size))})
        name = f"images/frame_{i:05d}.png"
        entries.append({"file_path": name, "transform_matrix": matrix_of(c), "colmap_im_id": i})
    data = {
        "w": 48, "h": 48, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy,
        "camera_model": "OPENCV", "k1": 0.05, "k2": -0.01, "p1": 0.001, "p2": 0.002, "frames": entries,
        "applied_transform": [[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0]], "ply_file_path": "sparse_pc.ply",
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(data | shared))
    kinds = ("float x", "float y", "float z", "uint8 red", "uint8 green", "uint8 blue")
    header = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(f"property {kind}\n" for kind in kinds)
    (folder / "sparse_pc.ply").write_text(f"{header}end_header\n0.5 1 1.5 255 0 51\n0 0 0 0 0 0\n")
    return folder


def test_the_embedded_views_open_with_their_cameras_and_points_which_stay_with_the_first_frame(tmp_path):
    assert is_multiview(FOX_VIEWS) and not is_multiview(tmp_path)
    assert not is_multiview(FOX)  # .ply frames beside its transforms.json
    scene = open_scene(FOX_VIEWS)
    assert len(scene) == 6 and len(scene.frames[0]) == 20 and scene.fps == 24
    assert len(scene.points.positions) == 2500
    cut = open_scene(FOX_VIEWS, frames=(5, None))
    assert len(cut) == 1 and cut.points is None
    with pytest.raises(SceneError, match="frames inside 0:6, got 1:9"):
        open_scene(FOX_VIEWS, frames=(1, 9))
    views = Pictures(scene).train(5)
    assert len(views) == 16 and views[0].target.rgb.shape == (128, 128, 3)


def test_transforms_gives_back_the_cameras_that_were_written(moving):
    """Unnamed ones have the name of the folder of their pictures: what is held out or exposed alike is told by it."""
    scene = open_scene(moving)
    assert is_multiview(moving) and [len(f) for f in scene.frames] == [6, 6]
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(6), strict=True))
    assert [c.split for c in scene.cameras] == ["train"] * 5 + ["test"]
    entries = json.loads((moving / "transforms.json").read_text())["frames"]
    changed(moving / "transforms.json", frames=[{n: v for n, v in e.items() if n != "camera"} for e in entries])
    names = [[shot.camera.name for shot in frame] for frame in open_scene(moving).frames]
    assert names == [[c.name for c in ring(6)]] * 2


def test_cameras_are_held_out_by_name_or_one_in_eight(tmp_path, moving):
    scene = open_scene(moving)
    assert with_held_out(scene, None) is scene  # it names its own
    names = with_held_out(scene, ["cam00", "cam02"])
    assert [c.name for c in names.cameras if c.split == "test"] == ["cam00", "cam02"]
    for chosen, message in ((["camX"], "no camera camX"), ([c.name for c in scene.cameras], "all 6 are held out")):
        with pytest.raises(SceneError, match=message):
            with_held_out(scene, chosen)
    spared = with_held_out(with_held_out(scene, []), None)
    assert all(c.split == "train" for c in spared.cameras)  # too few to spare one
    many = with_held_out(open_scene(write_panoptic(tmp_path / "many", ring(17))), None)
    assert [i for i, c in enumerate(many.cameras) if c.split == "test"] == [4, 12]


def test_ns_process_data_is_a_scene_of_one_frame(tmp_path):
    folder = write_ns_process_data(tmp_path)
    assert is_multiview(folder)  # though there is a .ply
    scene = open_scene(folder)
    assert len(scene) == 1 and [c.name for c in scene.cameras][:2] == ["frame_00001", "frame_00002"]
    assert scene.points.positions[0].tolist() == [0.5, 1, 1.5]  # in the axes of the cameras, as nerfstudio has both
    assert scene.points.colours[0] == pytest.approx([1, 0, 0.2])
    assert all(np.allclose(a.position, b.position, atol=1e-6) for a, b in zip(scene.cameras, ring(9), strict=True))
    shown = Pictures(scene).train(0)[0].target.rgb
    assert shown.shape == (48, 48, 3) and shown.min() > 0.34  # undistorted, no black borders
    assert sum(c.held_out for c in with_held_out(scene, None).cameras) == 1
    fisheye = {"camera_model": "OPENCV_FISHEYE", "k1": 0.02, "k2": 0.0, "k3": 0.0, "k4": 0.001}
    scene = open_scene(write_ns_process_data(tmp_path, **fisheye))
    assert scene.frames[0][0].lens.fisheye and Pictures(scene).train(0)[0].target.rgb.min() > 0.3


def test_panoptic_brings_cameras_masks_and_points(tmp_path):
    folder = write_panoptic(tmp_path, ring(9))
    table = np.random.default_rng(0).uniform(0, 1, (9, 7)).astype(np.float32)
    np.savez(folder / "init_pt_cld.npz", data=table)
    scene = open_scene(folder)
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(9), strict=True))
    assert [{c.near for c in s.cameras} for s in (scene, faces.with_near(scene, 2.0))] == [{0.8}, {2.0}]
    assert (scene.points.positions == table[:, :3]).all() and (scene.points.colours == table[:, 3:6]).all()
    whole, cut = (Pictures(scene, faces.TrainSettings(foreground=f)).train(0)[0].target.rgb for f in ("off", "given"))
    assert whole[:, :24].min() > 0.7 and cut[:, :24].max() == 0 and cut[:, 24:].min() > 0.7
    meta = json.loads((tmp_path / "train_meta.json").read_text())
    (tmp_path / "test_meta.json").write_text(json.dumps(meta | {"cam_id": [[*range(11, 20)]] * 2}))
    scene = with_held_out(open_scene(tmp_path), None)  # those of the test file are
    assert [(c.name, c.held_out) for c in scene.cameras][8:10] == [("cam08", False), ("cam11", True)]
    assert [len(frame) for frame in scene.frames] == [18, 18]


@pytest.mark.parametrize("binary", [False, True])
def test_colmap_projects_as_colmap_does(tmp_path, binary):
    names = ["a.png", "b.png", "c.png"]
    theirs = write_colmap(tmp_path, names, binary=binary)
    write_pictures(tmp_path / "images", dict.fromkeys(names, plain(50)))
    scene = open_scene(tmp_path)
    assert len(scene) == 1 and len(scene.cameras) == 3
    assert scene.points.positions.tolist() == [pytest.approx([0.1, 0.2, 0.3])]
    assert scene.points.colours[0] == pytest.approx([1.0, 128 / 255, 0.0])
    point = np.array([0.3, -0.1, 0.5])
    for camera, image in zip(scene.cameras, sorted(theirs.images.values(), key=lambda i: i.name), strict=True):
        x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
        ours = [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
        assert ours == pytest.approx(image.project_point(point), abs=1e-4)
    assert Pictures(scene).train(0)[0].target.rgb.shape == (24, 32, 3)


@pytest.mark.parametrize(("kind", "fps"), [("videos", 25), ("folders", 30)])
def test_colmap_cameras_with_pictures_over_time(tmp_path, kind, fps):
    write_colmap(tmp_path, ["cam1.png", "cam2.png"] if kind == "videos" else ["cam1/0.png", "cam2/0.png"])
    pictures = {f"{t}.png": plain(40 + 80 * t) for t in range(3)}
    (tmp_path / "videos").mkdir()
    for camera in ("cam1", "cam2"):
        if kind == "videos":
            write_video(tmp_path / "videos" / f"{camera}.mp4", [*pictures.values()])
        else:
            write_pictures(tmp_path / "images" / camera, pictures)
    scene = open_scene(tmp_path)
    assert len(scene) == 3 and [c.name for c in scene.cameras] == ["cam1", "cam2"] and scene.fps == fps
    levels = [Pictures(scene).train(t)[1].target.rgb.mean() * 255 for t in range(3)]
    assert levels == pytest.approx([40, 120, 200], abs=4)


@pytest.mark.parametrize(("write", "moved"), [(write_colmap_binary, False), (write_colmap_text, True)])
def test_frames_of_hifi4g_are_in_the_order_of_their_numbers(tmp_path, write, moved):
    folder = write_hifi4g(tmp_path / "actor", write, moved)
    assert is_multiview(folder)
    scene = open_scene(folder)
    assert len(scene) == 3 and [c.name for c in scene.cameras] == [str(i) for i in range(RIG)]
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(RIG), strict=True))
    levels = [[view.target.rgb.mean() * 255 for view in Pictures(scene).train(t)] for t in range(3)]
    assert np.allclose(levels, [[100 + 10 * i + t for i in range(RIG)] for t in range(3)])
    assert moved or len(open_scene(folder / "image_white_undistortion")) == 3  # itself is taken too


def test_n3dv_as_downloaded(tmp_path):
    """Rows are of the cameras in sorted order, some of which are not there; cam00 is held out."""
    names = [f"cam{i:02d}.mp4" for i in (0, 1, 2, 4, 10, 20)]
    scene = with_held_out(open_scene(write_n3dv(tmp_path, *names, rows=6)), None)
    assert [(c.name, c.held_out) for c in scene.cameras] == [(n[:5], n == "cam00.mp4") for n in names]
    rig = [faces.with_pixels(c, 48, 48) for c in ring(6, size=96)]
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, rig, strict=True))
    levels = [view.target.rgb.mean() * 255 for view in Pictures(scene, faces.TrainSettings(max_size=24)).train(2)]
    assert levels == pytest.approx([42 + 10 * i for i in range(1, 6)], abs=3)


def test_pictures_may_lie_anywhere(tmp_path):
    """As nerfstudio has it: by absolute paths, and outside the folder."""
    write_pictures(tmp_path, {"elsewhere/a.png": plain(0, (8, 8))})
    for name in ("../elsewhere/a.png", str(tmp_path / "elsewhere" / "a.png")):
        data = CAMERA | {"frames": [{"transform_matrix": UNIT, "file_path": name}]}
        saved("scene/transforms.json", json.dumps(data).encode())(tmp_path)
        Pictures(open_scene(tmp_path / "scene")).check()


@pytest.fixture
def little_memory(moving):
    """One GiB beyond what the tests have taken, so that a promise that is believed is a MemoryError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (1 << 30), hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def npy(shape: str, kind: str = "<f8") -> bytes:
    header = f"{{'descr':'{kind}','fortran_order':False,'shape':{shape},}}".ljust(117) + "\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header.encode() + bytes(100)


def saved(name, data):
    return lambda folder: (folder / name).parent.mkdir(parents=True, exist_ok=True) or (folder / name).write_bytes(data)


def transforms(**fields):
    return lambda folder: changed(folder / "transforms.json", **fields)


def entry(**fields):
    return transforms(frames=[{"transform_matrix": UNIT, "file_path": "a.png", **fields}])


def panoptic(**fields):
    return lambda folder: changed(write_panoptic(folder / "rig", ring(3)) / "train_meta.json", **fields)


def inner(write, *words, **fields):
    def make(folder):
        (folder / "inner").mkdir()
        return write(folder / "inner", *words, **fields) or folder / "inner"

    return make


def points_of_an_archive(folder):
    with (folder / "points3d.npy").open("wb") as file:
        np.savez_compressed(file, a=np.zeros(9))


def cloud_of_other_arrays(folder):
    np.savez(write_panoptic(folder / "rig", ring(3)) / "init_pt_cld.npz", other=np.zeros((9, 7)))
    return folder / "rig"


def many_entries(**shared):
    text = json.dumps(CAMERA | shared | {"frames": [{}] * 20_001}, separators=(",", ":"))
    return saved("transforms.json", text.encode())


SHOWN = "images/cam01/0000.png"
NAMES = [".", "/", "a\nb", "a\x1b[2J", "a\0", "a" * 256]


@pytest.mark.parametrize(("make", "message"), [
    (inner(lambda folder: None),
     "pictures with train_meta.json, transforms.json, image_white_undistortion/ .HiFi4G., COLMAP.s sparse/ or "),
    (saved("transforms.json", b"{"), "expected cameras"),
    (transforms(frames=[]), "at least one camera"),
    (entry(transform_matrix=[[1, 2]]), "expected a nerfstudio transforms.json"),
    *((transforms(fps=fps), r"transforms\.json: expected") for fps in ("1e30000000", "1/0", 0, -3, "fast")),
    (lambda folder: (folder / SHOWN).unlink(), "0000.png: expected a picture: No such file"),
    (lambda folder: write_png(folder / SHOWN, plain(3)), "expected a picture of 48x48, got 32x24"),
    (saved(SHOWN, b"no picture"), "expected a picture: cannot identify"),
    *((entry(file_path=name), r"transforms\.json: expected.*( name|'aaa)") for name in NAMES),
    *((panoptic(fn=[[name] * 3]), r"meta\.json: expected.*( name|'aaa)") for name in ("", *NAMES)),
    (saved("points3d.npy", b"\x93NUMPY\1\0\2\0(\n"), "expected rows of x, y, z"),  # which looks like Python to numpy
    (saved("points3d.npy", npy(f"({10**12},3)")), "expected rows of x, y, z"),
    (saved("points3d.npy", npy(f"({10**12},3)", "|V0")), "expected rows of x, y, z"),
    (points_of_an_archive, "expected rows of x, y, z"),
    (cloud_of_other_arrays, r"init_pt_cld\.npz: expected rows of x, y, z"),
    (transforms(ply_file_path="a" * 5000), "expected the points of ply_file_path"),
    (many_entries(transform_matrix=UNIT), "no 'transform_matrix'"),
    (many_entries(**{f"k{i}": 0 for i in range(3_000)}), "no 'transform_matrix'"),
    (saved("transforms.json", b'{"frames":' + b"[" * 500_000), "expected cameras .*: maximum recursion"),
    (lambda folder: os.mkfifo(folder / "a.png") or entry()(folder), "a.png: expected a picture: No such file"),
    (inner(write_ns_process_data, ply_file_path="cloud.ply"), "the points of ply_file_path: got no file cloud.ply"),
    (inner(write_ns_process_data, ply_file_path=3), "the points of ply_file_path: got no file 3"),
    (inner(write_ns_process_data, camera_model="EQUIRECTANGULAR"), "no perspective"),
    (inner(write_ns_process_data, camera_model="FISHEYE624"), "no perspective"),
    (inner(write_ns_process_data, k4=0.1), "k4 of 0.1"),
    (inner(lambda folder: saved("sparse/0/images.bin", b"12")(folder) and folder), "expected a COLMAP reconstruction"),
    (inner(hifi4g_without, "colmap"), "colmap/sparse in it or in image_white_undistortion/, got none"),
    (inner(hifi4g_without, "31/7.png"), "pictures of 11 cameras, got none of 7"),
    (inner(hifi4g_without, *map(str, FRAMES)), "numbered folders, one a frame, got none"),
    (inner(write_n3dv, rows=2), "a row for each of 0 videos, got 2"),
    (inner(write_n3dv, "cam00.mp4", "cam01.mp4", rows=3), "a row for each of 2 videos, got 3"),
    (inner(write_n3dv, "cam00.mp4", "cam01.mp4", "cam01.MOV", rows=3), "one video for each camera, got several of"),
])  # fmt: skip
def test_what_is_no_scene_or_promises_more_than_it_has_is_refused_in_one_line(moving, little_memory, make, message):
    """At the cost of the bytes there are."""
    made = make(moving)
    with pytest.raises(SceneError, match=message) as caught:
        Pictures(open_scene(made if isinstance(made, Path) else moving)).check()
    assert str(caught.value).isprintable()


def test_usage_of_more_rows_than_the_frames_have_is_not_unpacked(tmp_path, little_memory, monkeypatch):
    promised, path = tmp_path / "promised.npz", tmp_path / "usage.npz"
    with zipfile.ZipFile(promised, "w") as archive:
        for name in ("total", "peak", "hits"):
            archive.writestr(f"0:1/{name}.npy", npy(f"({10**12},)"))
    faces.save_usage(path, {(0, 1): faces.Usage(*np.zeros((3, 10_000)))})
    assert len(load_usage(path, 0, 1, 10_000).total) == 10_000
    with pytest.raises(SceneError, match="expected usage as the trainer writes it"):
        load_usage(promised, 0, 1, 10)
    monkeypatch.setattr(np.lib.format, "read_array", None)
    with pytest.raises(SceneError, match="expected usage as the trainer writes it: 10 rows of 8 bytes, got 80128"):
        load_usage(path, 0, 1, 10)
