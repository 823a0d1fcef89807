"""Cameras that are held out, and names of what pictures show."""

from dataclasses import replace

import pytest

from airgs_codec.jobs.job import digest
from airgs_codec.trainer.data.multiview import with_frames, without_masks
from airgs_codec.trainer.data.readers import CameraFilm, scene_from_films
from tests.faces import (
    MultiviewScene,
    SceneError,
    Shot,
    Work,
    content_of,
    open_scene,
    open_store,
    read_contents,
    with_held_out,
)
from tests.support.multiview_files import plain, write_panoptic, write_video
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


def names(scene: MultiviewScene, tmp_path) -> list[str]:
    contents = read_contents(scene, Work(open_store(tmp_path / "work")))
    return [digest(content_of(with_frames(scene, [frame]), contents)) for frame in range(len(scene))]


def filmed(folder, shades):
    folder.mkdir(parents=True)
    write_video(folder / "a.mp4", [plain(shade) for shade in shades])
    shot = Shot(replace(ring(1)[0], width=32, height=24), source=None)
    return scene_from_films(folder, [CameraFilm(shot, folder / "a.mp4")])


def test_frames_of_a_video_have_names_of_their_own_wherever_it_lies(tmp_path):
    scene = filmed(tmp_path / "one", [10, 10, 90])
    assert len(set(names(scene, tmp_path))) == 3  # by their number, though two show the same
    assert names(filmed(tmp_path / "two", [10, 10, 90]), tmp_path) == names(scene, tmp_path)
    assert not set(names(filmed(tmp_path / "three", [10, 10, 200]), tmp_path)) & set(names(scene, tmp_path))


def test_a_mask_counts_where_it_is_read(tmp_path):
    scene, mask = filmed(tmp_path / "one", [10, 20]), tmp_path / "mask.png"
    masked = replace(scene, frames=tuple((replace(shot, mask=mask),) for (shot,) in scene.frames))
    assert names(without_masks(masked), tmp_path) == names(scene, tmp_path)
    with pytest.raises(SceneError, match=r"mask\.png: expected a picture or a video: No such file"):
        names(masked, tmp_path)
    mask.write_bytes(b"1")
    before = names(masked, tmp_path)
    mask.write_bytes(b"2")
    assert not set(before) & {*names(masked, tmp_path), *names(scene, tmp_path)}
