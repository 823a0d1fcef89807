"""Rows a few at a time cover all rows once, also in a process that was forked from one that did so."""

import itertools
import os

import numpy as np
import pytest

from airgs_codec.coding.kernels import CHUNK, LEAST, FrameMemory, for_chunks, row_chunks
from tests.faces import decode_frames, open_package
from tests.support.paths import GOLDEN


@pytest.mark.parametrize(("rows", "width"), [(0, 3), (1, 3), (10 * LEAST, CHUNK), (3 * CHUNK + 1, 1)])
def test_chunks_cover_all_rows_once(rows, width):
    parts = list(row_chunks(rows, width))
    assert sum(part.stop - part.start for part in parts) == rows
    assert all(a.stop == b.start for a, b in itertools.pairwise(parts))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_has_threads_of_its_own():
    seen = np.zeros(10 * LEAST, int)

    def work(part):
        seen[part] += 1

    for_chunks(work, len(seen), CHUNK)
    child = os.fork()
    if child == 0:
        for_chunks(work, len(seen), CHUNK)
        os._exit(0 if (seen == 2).all() else 1)
    assert os.waitpid(child, 0)[1] == 0 and (seen == 1).all()


SHAPE = 1000, 3


def test_what_is_let_go_of_is_given_out_again():
    memory = FrameMemory()
    first = memory.empty(SHAPE)
    place = first.ctypes.data
    del first
    assert memory.empty((500, 3)).shape == (500, 3)
    assert memory.empty(SHAPE, np.int32).dtype == np.int32
    assert memory.empty(SHAPE).ctypes.data == place


def test_what_somebody_has_is_not_given_out_and_views_count():
    memory = FrameMemory()
    whole, other = memory.empty(SHAPE), memory.empty(SHAPE)
    assert not np.shares_memory(whole, other)
    view = whole.reshape(-1, 3, 1)[10:]
    del whole
    assert not any(np.shares_memory(view, memory.empty(SHAPE)) for _ in range(3))


def test_frames_that_are_kept_stay_as_they_were():
    package = open_package(GOLDEN / "fox")
    kept = [(frame.gaussians, frame.gaussians.means.copy()) for frame in decode_frames(package, 0, 4)]
    assert all(np.array_equal(g.means, means) for g, means in kept)
    assert not np.shares_memory(kept[0][0].means, kept[1][0].means)
