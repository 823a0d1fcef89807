"""Videos read by the number of a frame."""

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.media.movie import VideoReader
from tests.support.multiview_files import plain, write_video


def test_videos_are_read_by_number_in_any_order(tmp_path):
    write_video(tmp_path / "v.mp4", [plain(20 * t) for t in range(8)])
    reader = VideoReader(tmp_path / "v.mp4")
    levels = [reader.read(t).mean() / 20 for t in (0, 3, 7, 2, 2, 6)]
    assert np.rint(levels).tolist() == [0, 3, 7, 2, 2, 6]
    assert (reader.frames, reader.size, reader.fps) == (8, (32, 24), 25)
    with pytest.raises(SceneError, match="the video ends after 8"):
        reader.read(8)
    reader.close()
