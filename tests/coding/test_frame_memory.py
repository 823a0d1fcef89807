"""Memory of frames: used again once nobody has it, and never while somebody has."""

import numpy as np

from airgs_codec.coding.kernels import FrameMemory
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.package.package import open_package
from tests.support.paths import GOLDEN

LIKE = np.zeros((1000, 3), np.float32)


def test_what_is_let_go_of_is_given_out_again():
    memory = FrameMemory()
    first = memory.empty_like(LIKE)
    place = first.ctypes.data
    del first
    assert memory.empty_like(LIKE[:500]).shape == (500, 3)
    assert memory.empty_like(LIKE).ctypes.data == place


def test_what_somebody_has_is_not_given_out_and_views_count():
    memory = FrameMemory()
    whole, other = memory.empty_like(LIKE), memory.empty_like(LIKE)
    assert not np.shares_memory(whole, other)
    view = whole.reshape(-1, 3, 1)[10:]
    del whole
    assert not any(np.shares_memory(view, memory.empty_like(LIKE)) for _ in range(3))


def test_frames_that_are_kept_stay_as_they_were():
    package = open_package(GOLDEN / "fox")
    kept = [(frame.gaussians, frame.gaussians.means.copy()) for frame in decode_frames(package, 0, 4)]
    assert all(np.array_equal(g.means, means) for g, means in kept)
    assert not np.shares_memory(kept[0][0].means, kept[1][0].means)
