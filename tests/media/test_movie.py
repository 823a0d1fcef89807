"""Ordinary films: what is written can be read again, frame by frame."""

from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.faces import CodecError, SceneError, VideoReader, write_movie
from tests.support.multiview_files import plain, write_video


def test_a_film_of_odd_size_is_read_back_without_its_odd_row_and_column(tmp_path):
    path = tmp_path / "a.mp4"
    write_movie(path, (np.full((33, 47, 3), 40 * t, np.uint8) for t in range(5)), Fraction(24))
    film = VideoReader(path)
    assert (film.size, film.clock.fps, list(film.clock.pictures)) == ((46, 32), 24, [0, 1, 2, 3, 4])
    for number in (3, 1, 1, 4, 0):  # also again and backward
        assert np.abs(film.read(number).astype(int) - 40 * number).mean() < 4
    with pytest.raises(SceneError, match="ends after 5"):
        film.read(5)
    film.close()


def test_a_film_without_frames_is_refused(tmp_path):
    with pytest.raises(CodecError, match="at least one frame"):
        write_movie(tmp_path / "a.mp4", [], Fraction(24))


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"not a film")
    with pytest.raises(SceneError, match="expected a video"):
        VideoReader(tmp_path / "a.mp4")


def test_a_film_whose_frames_change_their_size_is_refused_where_they_do(tmp_path):
    path = tmp_path / "a.h264"
    write_video(tmp_path / "1.h264", [plain(20)] * 2)
    write_video(tmp_path / "2.h264", [plain(20, (64, 48))] * 2)
    path.write_bytes((tmp_path / "1.h264").read_bytes() + (tmp_path / "2.h264").read_bytes())
    film = VideoReader(path)
    assert film.read(1).shape[1::-1] == film.size == (32, 24)
    with pytest.raises(SceneError, match="expected frames of 32x24, got 64x48 at 2"):
        film.read(2)


def test_a_name_is_never_taken_for_a_protocol(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "v.mp4", [plain(20)] * 2)
    (tmp_path / "file:v.mp4").write_bytes(b"not a film")
    with pytest.raises(SceneError, match=r"file:v\.mp4: expected a video"):
        VideoReader(Path("file:v.mp4"))


def test_threads_read_one_video_together(tmp_path):
    write_video(tmp_path / "v.mp4", [plain(20 * t) for t in range(8)])
    reader, wanted = VideoReader(tmp_path / "v.mp4"), [0, 7, 3, 1, 6, 2, 5, 4] * 4
    with ThreadPoolExecutor(4) as pool:
        levels = list(pool.map(lambda t: reader.read(t).mean() / 20, wanted))
    assert np.rint(levels).tolist() == wanted
    reader.close()
