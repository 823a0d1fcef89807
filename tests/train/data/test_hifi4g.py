"""HiFi4G and DualGS: numbered folders of pictures and one reconstruction."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.media.image import write_png
from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import is_multiview, open_scene
from tests.support.camera_files import write_colmap_binary, write_colmap_text
from tests.support.multiview_files import plain, same_camera
from tests.support.views import ring

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
