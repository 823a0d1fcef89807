"""CMU Panoptic."""

from airgs_codec.train.data.multiview import with_near
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


def test_near_planes_come_with_the_scene(tmp_path):
    scene = open_scene(write_panoptic(tmp_path, ring(2)))
    assert {c.near for c in scene.cameras} == {0.8}
    assert {c.near for c in with_near(scene, 2.0).cameras} == {2.0}
