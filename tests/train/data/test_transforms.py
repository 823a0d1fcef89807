"""nerfstudio's transforms.json."""

import json

from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import open_scene
from tests.support.multiview_files import matrix_of, plain, same_camera, write_video
from tests.support.paths import FOX_VIEWS
from tests.support.views import ring


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


def test_unnamed_cameras_have_one_name_at_all_times(moving):
    """That of the folder of their pictures: what is held out or exposed alike is told by it."""
    path = moving / "transforms.json"
    data = json.loads(path.read_text())
    for entry in data["frames"]:
        del entry["camera"]
    path.write_text(json.dumps(data))
    names = [[shot.camera.name for shot in frame] for frame in open_scene(moving).frames]
    assert names == [[c.name for c in ring(6)]] * 2


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
