"""Rows a few at a time cover all rows once, also in a process that was forked from one that did so."""

import itertools
import os

import numpy as np
import pytest

from airgs_codec.coding.kernels import CHUNK, LEAST, for_chunks, row_chunks


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
