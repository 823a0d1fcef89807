"""COLMAP reconstructions with one picture, a video or a folder for each camera."""

import shutil
from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from tests.faces import Pictures, SceneError, is_multiview, open_scene, write_png
from tests.support.camera_files import write_colmap_binary, write_colmap_text
from tests.support.multiview_files import plain, same_camera, write_video
from tests.support.views import ring

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
    assert Pictures(scene).train(0)[0].target.rgb.shape == (24, 32, 3)


def test_colmap_with_a_lens_is_undistorted(tmp_path):
    write_colmap(tmp_path, ["a.png", "b.png"], model="OPENCV")
    (tmp_path / "images").mkdir()
    for name in ("a", "b"):
        write_png(tmp_path / "images" / f"{name}.png", plain(120))
    scene = open_scene(tmp_path)
    assert scene.frames[0][0].lens is not None
    picture = Pictures(scene).train(0)[0].target.rgb
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
    levels = [Pictures(scene).train(t)[1].target.rgb.mean() * 255 for t in range(3)]
    assert levels == pytest.approx([40, 120, 200], abs=4)
    assert scene.fps == (25 if kind == "videos" else 30)


CAMERAS = 11  # numbered without leading zeros: 10 comes after 9, whatever COLMAP's order of names
FRAMES = (30, 31, 100)


def write_hifi4g(folder, write, moved):
    """`moved`: the reconstruction lies beside the frames, where some tools put it, instead of among them."""
    pictures = folder / "image_white_undistortion"
    rig = [replace(camera, name=str(i)) for i, camera in enumerate(ring(CAMERAS))]
    write(folder / "colmap" if moved else pictures / "colmap", rig)
    for t, frame in enumerate(FRAMES):
        (pictures / str(frame)).mkdir(parents=True)
        for i in range(CAMERAS):
            write_png(pictures / str(frame) / f"{i}.png", plain(100 + 10 * i + t, (48, 48)))
    (folder / "image_white").mkdir()
    return folder


@pytest.mark.parametrize(("write", "moved"), [(write_colmap_binary, False), (write_colmap_text, True)])
def test_frames_are_in_the_order_of_their_numbers(tmp_path, write, moved):
    folder = write_hifi4g(tmp_path / "actor", write, moved)
    assert is_multiview(folder)
    scene = open_scene(folder)
    assert len(scene) == 3 and [c.name for c in scene.cameras] == [str(i) for i in range(CAMERAS)]
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(CAMERAS), strict=True))
    levels = [[view.target.rgb.mean() * 255 for view in Pictures(scene).train(t)] for t in range(3)]
    assert np.allclose(levels, [[100 + 10 * i + t for i in range(CAMERAS)] for t in range(3)])


def test_the_folder_of_pictures_itself_is_taken_too(tmp_path):
    folder = write_hifi4g(tmp_path / "actor", write_colmap_binary, False)
    assert len(open_scene(folder / "image_white_undistortion")) == 3


@pytest.mark.parametrize(
    ("gone", "message"),
    [
        ("colmap", "colmap/sparse in it or in image_white_undistortion/, got none"),
        ("31/7.png", "pictures of 11 cameras, got none of 7"),
        ("*", "numbered folders, one a frame, got none"),
    ],
)
def test_what_is_missing_is_said_in_one_line(tmp_path, gone, message):
    folder = write_hifi4g(tmp_path / "actor", write_colmap_binary, False)
    pictures = folder / "image_white_undistortion"
    for path in [pictures / str(f) for f in FRAMES] if gone == "*" else [pictures / gone]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(SceneError, match=message) as caught:
        open_scene(folder)
    assert "\n" not in str(caught.value)
