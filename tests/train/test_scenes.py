"""Readers of multi-view scenes, cameras, lenses, held-out cameras, pictures."""

import json
from dataclasses import replace

import av
import cv2
import numpy as np
import pycolmap
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.media.image import fit_lens, undistort, write_png
from airgs_codec.media.movie import VideoReader
from airgs_codec.scene.camera import Camera
from airgs_codec.train.data.multiview import Pictures, with_held_out, with_near
from airgs_codec.train.data.readers import is_multiview, open_scene
from tests.support.paths import FOX, FOX_VIEWS
from tests.support.views import coloured_cloud, matrix_of, moved, ring, write_views


def plain(value: int, size=(32, 24)) -> np.ndarray:
    return np.full((size[1], size[0], 3), value, np.uint8)


def write_video(path, pictures, rate=25):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options={"qp": "1", "bf": "2"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


def same_camera(a: Camera, b: Camera) -> bool:
    close = np.allclose(a.world_to_camera, b.world_to_camera, atol=1e-5)
    numbers = [(getattr(c, n)) for c in (a, b) for n in ("fx", "fy", "cx", "cy")]
    return close and np.allclose(numbers[:4], numbers[4:], atol=1e-4)


@pytest.fixture
def moving(tmp_path):
    g = coloured_cloud()
    frames = [g, moved(g, slice(0, 30), (0.1, 0, 0))]
    return write_views(tmp_path / "scene", frames, ring(6, held_out=1), g.means[:60])


def test_the_embedded_views_open_with_their_cameras_and_points():
    scene = open_scene(FOX_VIEWS)
    assert len(scene) == 6 and len(scene.frames[0]) == 20 and scene.fps == 24
    assert len(scene.points.positions) == 2500
    views = Pictures(scene, None, False).train(5)
    assert len(views) == 16 and views[0].target.rgb.shape == (128, 128, 3)


def test_transforms_gives_back_the_cameras_that_were_written(moving):
    scene = open_scene(moving)
    assert [len(f) for f in scene.frames] == [6, 6]
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(6), strict=True))
    assert [c.split for c in scene.cameras] == ["train"] * 5 + ["test"]


def test_frames_are_cut_out_and_points_stay_with_the_first(moving):
    assert len(open_scene(moving, frames=(1, None))) == 1
    assert open_scene(moving, frames=(1, None)).points is None
    with pytest.raises(SceneError, match="frames inside 0:2, got 1:5"):
        open_scene(moving, frames=(1, 5))


def panoptic(folder, cameras):
    meta = {"w": 48, "h": 48, "fn": [], "k": [], "w2c": [], "cam_id": []}
    for t in range(2):
        meta["fn"].append([f"{i}/{t:06d}.png" for i in range(len(cameras))])
        meta["k"].append([[[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]] for c in cameras])
        meta["w2c"].append([c.world_to_camera.tolist() for c in cameras])
        meta["cam_id"].append(list(range(len(cameras))))
    for place in ("ims", "seg"):
        for name in (n for names in meta["fn"] for n in names):
            (folder / place / name).parent.mkdir(parents=True, exist_ok=True)
            picture = plain(200, (48, 48))
            if place == "seg":
                picture[:, :24] = 0
            write_png(folder / place / name, picture)
    (folder / "train_meta.json").write_text(json.dumps(meta))
    return folder


def test_panoptic_reads_cameras_and_masks(tmp_path):
    scene = open_scene(panoptic(tmp_path, ring(9)))
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(9), strict=True))
    whole = Pictures(scene, None, False).train(0)[0].target.rgb
    cut = Pictures(scene, None, True).train(0)[0].target.rgb
    assert whole[:, :24].min() > 0.7
    assert cut[:, :24].max() == 0 and cut[:, 24:].min() > 0.7


COLMAP_CAMERA = {"PINHOLE": [60.0, 62.0, 16.0, 12.0], "OPENCV": [60.0, 62.0, 16.0, 12.0, 0.05, -0.01, 0.001, 0.002]}


def write_colmap(folder, names, model="PINHOLE", binary=False):
    """A reconstruction in COLMAP's own words; gives pycolmap's view of it."""
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    words = " ".join(map(str, COLMAP_CAMERA[model]))
    (sparse / "cameras.txt").write_text(f"1 {model} 32 24 {words}\n")
    lines = []
    for i, name in enumerate(names):
        turn = 0.2 * i
        lines += [f"{i + 1} {np.cos(turn / 2)} 0 {np.sin(turn / 2)} 0 {0.1 * i} 0.2 4 1 {name}", "10 10 1"]
    (sparse / "images.txt").write_text("\n".join(lines) + "\n")
    tracks = " ".join(f"{i + 1} 0" for i in range(len(names)))
    (sparse / "points3D.txt").write_text(f"1 0.1 0.2 0.3 255 128 0 0.5 {tracks}\n")
    model_read = pycolmap.Reconstruction(str(sparse))
    if binary:
        model_read.write_binary(str(sparse))
        for file in sparse.glob("*.txt"):
            file.unlink()
    return model_read


@pytest.mark.parametrize("binary", [False, True])
def test_colmap_projects_as_colmap_does(tmp_path, binary):
    theirs = write_colmap(tmp_path, ["a.png", "b.png", "c.png"], binary=binary)
    for name in ("a", "b", "c"):
        (tmp_path / "images").mkdir(exist_ok=True)
        write_png(tmp_path / "images" / f"{name}.png", plain(50))
    scene = open_scene(tmp_path)
    assert len(scene) == 1 and len(scene.cameras) == 3
    assert scene.points.positions.tolist() == [pytest.approx([0.1, 0.2, 0.3])]
    assert scene.points.colours[0] == pytest.approx([1.0, 128 / 255, 0.0])
    point = np.array([0.3, -0.1, 0.5])
    for camera, image in zip(scene.cameras, sorted(theirs.images.values(), key=lambda i: i.name), strict=True):
        x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
        ours = [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
        assert ours == pytest.approx(image.project_point(point), abs=1e-4)
    assert Pictures(scene, None, False).train(0)[0].target.rgb.shape == (24, 32, 3)


def test_colmap_with_a_lens_is_undistorted(tmp_path):
    write_colmap(tmp_path, ["a.png", "b.png"], model="OPENCV")
    (tmp_path / "images").mkdir()
    for name in ("a", "b"):
        write_png(tmp_path / "images" / f"{name}.png", plain(120))
    scene = open_scene(tmp_path)
    assert scene.frames[0][0].lens is not None
    picture = Pictures(scene, None, False).train(0)[0].target.rgb
    assert picture.min() > 0.46  # no black borders: every pixel was seen


@pytest.mark.parametrize("kind", ["videos", "folders"])
def test_colmap_cameras_with_pictures_over_time(tmp_path, kind):
    names = ["cam1.png", "cam2.png"] if kind == "videos" else ["cam1/0.png", "cam2/0.png"]
    write_colmap(tmp_path, names)
    pictures = [plain(40), plain(120), plain(200)]
    for camera in ("cam1", "cam2"):
        if kind == "videos":
            (tmp_path / "videos").mkdir(exist_ok=True)
            write_video(tmp_path / "videos" / f"{camera}.mp4", pictures)
        else:
            (tmp_path / "images" / camera).mkdir(parents=True)
            for t, picture in enumerate(pictures):
                write_png(tmp_path / "images" / camera / f"{t}.png", picture)
    scene = open_scene(tmp_path)
    assert len(scene) == 3 and [c.name for c in scene.cameras] == ["cam1", "cam2"]
    levels = [Pictures(scene, None, False).train(t)[1].target.rgb.mean() * 255 for t in range(3)]
    assert levels == pytest.approx([40, 120, 200], abs=4)
    assert scene.fps == (25 if kind == "videos" else 30)


def test_camera_videos_with_llff_poses(tmp_path):
    for i, camera in enumerate(ring(3)):
        c2w = np.linalg.inv(camera.world_to_camera)
        columns = [c2w[:3, 1], c2w[:3, 0], -c2w[:3, 2], c2w[:3, 3], np.array([48, 48, camera.fx])]
        row = np.concatenate([np.stack(columns, axis=1).ravel(), [0.1, 100]])
        np.save(tmp_path / f"row{i}.npy", row)
        write_video(tmp_path / f"cam{i:02d}.mp4", [plain(60 + 60 * t, (48, 48)) for t in range(2)])
    np.save(tmp_path / "poses_bounds.npy", np.stack([np.load(tmp_path / f"row{i}.npy") for i in range(3)]))
    scene = open_scene(tmp_path)
    assert len(scene) == 2
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(3), strict=True))


def test_transforms_may_name_videos(tmp_path):
    cameras = ring(2)
    entries = [{"file_path": f"{c.name}.mp4", "camera": c.name, "transform_matrix": matrix_of(c)} for c in cameras]
    c = cameras[0]
    shared = {"w": 48, "h": 48, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
    (tmp_path / "transforms.json").write_text(json.dumps({**shared, "frames": entries}))
    for c in cameras:
        write_video(tmp_path / f"{c.name}.mp4", [plain(60, (48, 48)), plain(90, (48, 48))], rate=12)
    scene = open_scene(tmp_path)
    assert len(scene) == 2 and scene.fps == 12


def test_videos_are_read_by_number_in_any_order(tmp_path):
    write_video(tmp_path / "v.mp4", [plain(20 * t) for t in range(8)])
    reader = VideoReader(tmp_path / "v.mp4")
    levels = [reader.read(t).mean() / 20 for t in (0, 3, 7, 2, 2, 6)]
    assert np.rint(levels).tolist() == [0, 3, 7, 2, 2, 6]
    assert (reader.frames, reader.size, reader.fps) == (8, (32, 24), 25)
    with pytest.raises(SceneError, match="the video ends after 8"):
        reader.read(8)
    reader.close()


def test_a_lens_maps_straight_rays_to_where_opencv_bends_them():
    """A dot drawn where the distorting camera sees a point is found where the pinhole camera sees it."""
    matrix = np.array([[70.0, 0, 50.3], [0, 72.0, 40.1], [0, 0, 1]])
    coefficients = np.array([-0.2, 0.05, 0.002, -0.001])
    lens = fit_lens((100, 80), matrix, coefficients)
    point = np.array([[0.25, -0.18, 1.0]])
    shift = np.array([0.5, 0.5])
    centred = matrix.copy()
    centred[:2, 2] -= 0.5
    bent = cv2.projectPoints(point, np.zeros(3), np.zeros(3), centred, coefficients)[0].reshape(2) + shift
    rows, columns = np.mgrid[:80, :100] + 0.5
    dot = np.exp(-((columns - bent[0]) ** 2 + (rows - bent[1]) ** 2) / 8).astype(np.float32)
    seen = undistort(np.repeat(dot[..., None], 3, axis=2), lens)[..., 0]
    found = np.array([(seen * columns).sum(), (seen * rows).sum()]) / seen.sum()
    straight = lens.pinhole @ point[0]
    assert found == pytest.approx(straight[:2], abs=0.15)


def test_smaller_pictures_keep_their_rays(moving):
    scene = open_scene(moving)
    small, full = Pictures(scene, 24, False).cameras()[0], scene.cameras[0]
    assert (small.width, small.height) == (24, 24)
    assert (small.cx / small.fx, small.width / small.fx) == pytest.approx((full.cx / full.fx, full.width / full.fx))
    assert Pictures(scene, 24, False).train(0)[0].target.rgb.shape == (24, 24, 3)


def test_held_out_cameras(moving):
    scene = open_scene(moving)
    assert with_held_out(scene, None) is scene  # it names its own
    names = with_held_out(scene, ["cam00", "cam02"])
    assert [c.name for c in names.cameras if c.split == "test"] == ["cam00", "cam02"]
    with pytest.raises(SceneError, match="no camera camX"):
        with_held_out(scene, ["camX"])
    with pytest.raises(SceneError, match="all 6 are held out"):
        with_held_out(scene, [c.name for c in scene.cameras])
    unmarked = replace(
        scene, frames=tuple(tuple(replace(s, camera=replace(s.camera, split="train")) for s in f) for f in scene.frames)
    )
    assert all(c.split == "train" for c in with_held_out(unmarked, None).cameras)  # too few to spare one


def test_one_camera_in_eight_is_held_out(tmp_path):
    scene = with_held_out(open_scene(panoptic(tmp_path, ring(17))), None)
    assert [i for i, c in enumerate(scene.cameras) if c.split == "test"] == [4, 12]


def test_near_planes_come_with_the_scene(tmp_path):
    scene = open_scene(panoptic(tmp_path, ring(2)))
    assert {c.near for c in scene.cameras} == {0.8}
    assert {c.near for c in with_near(scene, 2.0).cameras} == {2.0}


def test_the_cache_is_bounded(moving):
    scene = open_scene(moving)
    pictures = Pictures(scene, None, False, cache_bytes=3 * 3 * 48 * 48 * 3 * 4)
    pictures.train(0)
    pictures.train(1)
    assert len(pictures._kept) <= 3


def test_pictures_are_exposed_alike(moving):
    pictures = Pictures(open_scene(moving), None, False)
    before = pictures.train(0)[0].target.rgb
    pictures.expose_alike({"cam00": [2.0, 2.0, 2.0, 0.1, 0.1, 0.1]})
    np.testing.assert_allclose(pictures.train(0)[0].target.rgb, (before - 0.1) / 2, atol=1e-6)
    assert (pictures.train(0)[1].target.rgb == Pictures(open_scene(moving), None, False).train(0)[1].target.rgb).all()


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
        np.save(folder / "poses_bounds.npy", np.zeros((2, 17)))
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
            (folder / "points3d.npy").write_bytes(b"x")
    return folder


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("nothing", "expected multi-view pictures with transforms.json"),
        ("poses", "a row for each of 0 videos, got 2"),
        ("colmap", "expected a COLMAP reconstruction"),
        ("json", "expected JSON"),
        ("no frames", "at least one picture"),
        ("matrix", "expected a nerfstudio transforms.json"),
        ("missing picture", "0000.png: expected a picture, got nothing"),
        ("size", "expected a picture of 48x48, got 32x24"),
        ("text", "expected a picture, got something else"),
        ("points", "expected rows of x, y, z"),
    ],
)
def test_broken_scenes_are_refused_in_one_line(tmp_path, what, message):
    with pytest.raises(SceneError, match=message) as caught:
        Pictures(open_scene(broken(tmp_path, what)), None, False).train(0)
    assert "\n" not in str(caught.value)
