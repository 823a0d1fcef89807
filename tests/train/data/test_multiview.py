"""Cameras that are held out."""

from dataclasses import replace

import pytest

from airgs_codec.errors import SceneError
from airgs_codec.train.data.multiview import with_held_out
from airgs_codec.train.data.readers import open_scene
from tests.support.multiview_files import write_panoptic
from tests.support.views import ring


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
    scene = with_held_out(open_scene(write_panoptic(tmp_path, ring(17))), None)
    assert [i for i, c in enumerate(scene.cameras) if c.split == "test"] == [4, 12]
