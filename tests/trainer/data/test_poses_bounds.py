"""LLFF's poses_bounds.npy."""

import pytest

from tests.faces import Pictures, SceneError, open_scene, with_held_out, with_pixels
from tests.support.camera_files import write_llff
from tests.support.multiview_files import plain, same_camera, write_video
from tests.support.views import ring


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
    assert all(same_camera(a, with_pixels(b, 48, 48)) for a, b in zip(scene.cameras, rig, strict=True))
    levels = [view.target.rgb.mean() * 255 for view in Pictures(scene, max_size=24).train(2)]
    assert levels == pytest.approx([42 + 10 * i for i in range(1, 6)], abs=3)


def test_videos_and_rows_must_fit(tmp_path):
    write_n3dv(tmp_path / "n3dv", ["cam00.mp4", "cam01.mp4", "cam01.MOV"])
    with pytest.raises(SceneError, match="one video for each camera, got several of cam01"):
        open_scene(tmp_path / "n3dv")
    (tmp_path / "n3dv" / "cam01.MOV").unlink()
    with pytest.raises(SceneError, match="a row for each of 2 videos, got 3"):
        open_scene(tmp_path / "n3dv")
