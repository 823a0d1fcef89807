"""Names of pictures change with what they show, and with nothing else."""

from dataclasses import replace

import pytest

from airgs_codec.errors import SceneError
from airgs_codec.jobs.digest import digest
from airgs_codec.jobs.store import WorkFolder
from airgs_codec.jobs.work import Work
from airgs_codec.train.data.contents import content_of, read_contents, with_frames, without_masks
from airgs_codec.train.data.multiview import MultiviewScene, Shot
from airgs_codec.train.data.videos import CameraFilm, scene_from_films
from tests.support.multiview_files import plain, write_video
from tests.support.views import ring


def names(scene: MultiviewScene, tmp_path) -> list[str]:
    """The name of each frame by itself."""
    contents = read_contents(scene, Work(WorkFolder(tmp_path / "work")))
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
