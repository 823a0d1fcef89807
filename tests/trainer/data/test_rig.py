"""Rigs without poses: real runs of COLMAP on what a few cameras film of a corner."""

import pytest

from airgs_codec.cli.train import main as train_main
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.trainer.data.readers import is_multiview, is_unposed, open_scene
from airgs_codec.trainer.data.rig import find_poses
from tests.support.multiview_files import plain, write_video
from tests.support.rigs import SIZE, aligned_errors, film_rig, rig

pytest.importorskip("pycolmap")
CAMERAS = 4


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """Four cameras that see the same corner, and one that sees nothing."""
    folder = film_rig(tmp_path_factory.mktemp("rig") / "corner", rig(CAMERAS))
    write_video(folder / "cam99.MP4", [plain(90, (SIZE, SIZE))] * 2)
    return folder


def test_poses_are_found_written_beside_the_videos_and_taken_from_there(filmed, capsys):
    assert is_multiview(filmed) and is_unposed(filmed)
    with pytest.raises(SceneError, match="expected poses of 5 cameras, got videos alone"):
        open_scene(filmed)
    model = filmed.parent / "model"
    options = ["--iterations", "3,3,3", "--budget", "80", "--max-size", "48", "--frames", "0:1", "--device", "cpu"]
    words = [str(filmed), "-o", str(model), *options]
    assert train_main(words) == 0
    out, err = capsys.readouterr()
    assert "videos without poses; COLMAP finds them from frame 0" in out
    assert "4 of 5 cameras have poses" in out and "cam99: no pose, 0 features, 0 matches with 0 cameras" in out
    assert "warning: trained without cameras that have no pose: cam99" in err
    assert not is_unposed(filmed) and not list(filmed.glob(".poses-*"))
    scene = open_scene(filmed)
    assert [c.name for c in scene.cameras] == ["cam00", "cam01", "cam02", "cam03"] and len(scene) == 2
    degrees, distance = aligned_errors(scene.cameras, rig(CAMERAS))
    assert degrees < 1.5 and distance < 0.03
    assert len(scene.points.positions) > 100
    assert train_main([*words, "--resume"]) == 0
    assert "COLMAP" not in capsys.readouterr().out


@pytest.mark.parametrize("count", [2, 4])
def test_cameras_that_see_nothing_in_common_are_refused_and_leave_nothing(tmp_path, count):
    folder = tmp_path / "rig"
    folder.mkdir()
    for i in range(count):
        write_video(folder / f"cam{i}.mp4", [plain(60 + i, (64, 64))] * 2)
    expected = (
        "videos of at least 3 cameras, got 2" if count == 2 else "poses of at least 3 of 4 cameras .* got 0; none of"
    )
    with pytest.raises(SceneError, match=expected) as caught:
        find_poses(folder)
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in folder.iterdir()) == [f"cam{i}.mp4" for i in range(count)]


def test_what_cannot_be_a_rig_is_refused_in_one_line(tmp_path):
    folder = tmp_path / "rig"
    folder.mkdir()
    for name in ("a.mp4", "b.mp4", "c.mp4", "a.mov"):
        write_video(folder / name, [plain(60, (64, 64))] * 2)
    with pytest.raises(SceneError, match="one video for each camera, got several of a"):
        find_poses(folder)
    (folder / "a.mov").unlink()
    with pytest.raises(SceneError, match="expected frame 7"):
        find_poses(folder, frame=7)
    write_video(folder / "b.mp4", [plain(60, (64, 32))] * 2)
    with pytest.raises(SceneError, match="expected videos of one size for one lens"):
        find_poses(folder, shared_lens=True)
    (folder / "sparse").mkdir()
    with pytest.raises(ConfigError, match="expected no poses yet"):
        find_poses(folder)


def test_one_lens_may_be_shared(tmp_path):
    folder = film_rig(tmp_path / "corner", rig(CAMERAS), frames=1)
    report = find_poses(folder, shared_lens=True)
    assert not report.failed and len({c.fx for c in open_scene(folder).cameras}) == 1
