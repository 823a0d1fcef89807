"""A folder that is still being written: frames are taken once they are whole, in order."""

import json

import pytest

from airgs_codec.scene.formats.ply import is_whole
from tests.faces import GrowingFolder, SceneError, write_ply
from tests.support.scenes import moving_frames


def test_a_frame_is_taken_once_it_is_whole(tmp_path):
    first, second = moving_frames(20, 2)
    folder = GrowingFolder(tmp_path / "scene", fps=24)
    assert folder.look() is None
    (tmp_path / "scene").mkdir()
    path = tmp_path / "scene" / "frame1.ply"
    write_ply(path, first)
    data = path.read_bytes()
    for size in (0, 10, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size])
        assert not is_whole(path) and folder.look() is None
    path.write_bytes(data)
    assert len(folder.look()) == 1
    write_ply(tmp_path / "scene" / "frame2.ply", second)
    sequence = folder.look()
    assert [p.name for p in sequence.paths] == ["frame1.ply", "frame2.ply"] and sequence.fps == 24
    assert folder.look() is sequence
    folder.check_finished()


def test_a_later_frame_waits_for_the_one_before(tmp_path):
    frames = moving_frames(20, 3)
    folder = GrowingFolder(tmp_path)
    write_ply(tmp_path / "1.ply", frames[0])
    (tmp_path / "2.ply").write_bytes(b"ply\n")
    write_ply(tmp_path / "3.ply", frames[2])
    assert len(folder.look()) == 1
    with pytest.raises(SceneError, match=r"2\.ply"):
        folder.check_finished()
    write_ply(tmp_path / "2.ply", frames[1])
    assert len(folder.look()) == 3


def test_keyframes_that_are_named_later_are_seen(tmp_path):
    folder = GrowingFolder(tmp_path)
    for number, frame in enumerate(moving_frames(20, 3)):
        write_ply(tmp_path / f"{number}.ply", frame)
    assert folder.look().keyframes is None
    (tmp_path / "sequence.json").write_text(json.dumps({"fps": 25, "keyframes": [0, 2]}))
    assert folder.look().keyframes == (0, 2)


def test_frames_out_of_order_and_none_at_all_are_refused(tmp_path):
    folder = GrowingFolder(tmp_path)
    with pytest.raises(SceneError, match="at least one"):
        folder.check_finished()
    first, second = moving_frames(20, 2)
    write_ply(tmp_path / "7.ply", first)
    folder.look()
    write_ply(tmp_path / "6.ply", second)
    with pytest.raises(SceneError, match=r"6\.ply: expected frames to come in the order of their names"):
        folder.look()
