"""The benchmark of tracking: what it disturbs, and what it says of its rows."""

import numpy as np
import pytest

from tests.support.scenes import random_gaussians
from tools.lab.bench.tracked import ALONE, GIVEN, TRACKED, disturb, verdict


def row(coded, kb, psnr):
    return {"coded": coded, "kb": kb, "psnr": psnr}


def test_it_says_what_tracking_saves_and_what_it_does_to_quality():
    better = [row(GIVEN, None, 35.0), row(ALONE, 30.0, 31.5), row(TRACKED, 4.5, 37.5)]
    assert verdict(better) == (
        "Tracked it takes 15 % of the bytes of coding frame by frame, 6.0 dB better than these and 2.5 dB above what "
        "was given."
    )
    worse = verdict([row(GIVEN, None, 35.0), row(ALONE, 30.0, 34.5), row(TRACKED, 60.0, 33.0)])
    assert "takes 200 % of the bytes" in worse and "1.5 dB worse" in worse and "2.0 dB below" in worse


def test_frames_lose_split_move_and_shuffle_rows():
    given = random_gaussians(4000, seed=1)
    moved = disturb(given, np.random.default_rng(1))
    assert len(moved) == pytest.approx(4000 * 0.95 * 1.05, rel=0.02)
    same = np.isclose(moved.sh_dc[:, None, 0], given.sh_dc[None, :, 0]).argmax(axis=1)
    assert not (np.diff(same) == 1).mean() > 0.05  # the order of rows tells nothing
    kept = np.isclose(moved.log_scales, given.log_scales[same]).all(axis=1)
    size = np.exp(given.log_scales[same].mean(axis=1))
    off = np.linalg.norm(moved.means - given.means[same], axis=1) / size
    assert 0.12 < np.median(off[kept]) < 0.2 and (~kept).mean() == pytest.approx(2 * 0.05 / 1.05, abs=0.02)
    assert (disturb(given, np.random.default_rng(1)).means == moved.means).all()
