"""CMU Panoptic."""

import json

from airgs_codec.train.data.multiview import with_held_out, with_near
from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import open_scene
from tests.support.multiview_files import same_camera, write_panoptic
from tests.support.views import ring


def test_panoptic_reads_cameras_and_masks(tmp_path):
    scene = open_scene(write_panoptic(tmp_path, ring(9)))
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(9), strict=True))
    whole = Pictures(scene).train(0)[0].target.rgb
    cut = Pictures(scene, foreground=True).train(0)[0].target.rgb
    assert whole[:, :24].min() > 0.7
    assert cut[:, :24].max() == 0 and cut[:, 24:].min() > 0.7


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
