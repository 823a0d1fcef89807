"""LLFF's poses_bounds.npy."""

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.trainer.data.multiview import with_held_out
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from tests.support.camera_files import write_llff
from tests.support.multiview_files import plain, same_camera, write_video
from tests.support.views import ring


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


def write_n3dv(folder, names):
    """A scene as N3DV is downloaded: its matrices are of videos twice the size of these."""
    folder.mkdir()
    rig = ring(len(names), size=96)
    write_llff(folder, rig)
    for i, name in enumerate(names):
        write_video(folder / name, [plain(40 + 10 * i + t, (48, 48)) for t in range(3)])
    return rig


def test_n3dv_as_downloaded(tmp_path):
    """Rows are of the cameras in sorted order, some of which are not there; cam00 is held out."""
    names = [f"cam{i:02d}.mp4" for i in (0, 1, 2, 4, 10, 20)]
    rig = write_n3dv(tmp_path / "n3dv", names)
    scene = with_held_out(open_scene(tmp_path / "n3dv"), None)
    assert [(c.name, c.held_out) for c in scene.cameras] == [(n[:5], n == "cam00.mp4") for n in names]
    assert (scene.cameras[4].position == pytest.approx(rig[4].position, abs=1e-5)) and len(scene) == 3
    assert (scene.cameras[0].width, scene.cameras[0].fx) == (48, pytest.approx(rig[0].fx / 2))
    levels = [view.target.rgb.mean() * 255 for view in Pictures(scene, max_size=24).train(2)]
    assert levels == pytest.approx([42 + 10 * i for i in range(1, 6)], abs=3)


def test_videos_and_rows_must_fit(tmp_path):
    write_n3dv(tmp_path / "n3dv", ["cam00.mp4", "cam01.mp4", "cam01.MOV"])
    with pytest.raises(SceneError, match="one video for each camera, got several of cam01"):
        open_scene(tmp_path / "n3dv")
    (tmp_path / "n3dv" / "cam01.MOV").unlink()
    with pytest.raises(SceneError, match="a row for each of 2 videos, got 3"):
        open_scene(tmp_path / "n3dv")
