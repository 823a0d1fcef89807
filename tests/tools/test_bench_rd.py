"""The comparison itself: BD-rate on curves whose answer is known, and layouts that decode to what they were given."""

import numpy as np
import pytest

from airgs_codec.scene.repair import repair
from tests.support.scenes import moving_frames
from tools.baselines import mpeg_anchor_layout, v3_layout
from tools.bench_rd import MPEG_QPS, RdPoint, bd_rate


def curve(*pairs):
    return [RdPoint("c", str(i), kb, psnr, None, 0.0, 0.0) for i, (kb, psnr) in enumerate(pairs)]


WIDE = curve((10, 38), (14, 41), (20, 44), (28, 47), (40, 50))


def test_bd_rate_of_known_curves():
    assert bd_rate(WIDE, WIDE) == pytest.approx(0)
    half = curve(*((p.kb_per_frame / 2, p.psnr) for p in WIDE))
    assert bd_rate(half, WIDE) == pytest.approx(-0.5)
    assert bd_rate(WIDE, half, 41, 46) == pytest.approx(1.0)


def test_bd_rate_never_extrapolates_and_needs_four_points():
    assert bd_rate(WIDE, curve((10, 60), (20, 62), (30, 64), (40, 66))) is None
    assert bd_rate(WIDE, WIDE[:3]) is None
    assert bd_rate(WIDE, WIDE, 60, 70) is None


def test_points_beaten_at_fewer_bytes_do_not_count():
    assert bd_rate(WIDE, [*WIDE, *curve((30, 40))]) == pytest.approx(0)


def test_both_layouts_decode_to_what_they_were_given():
    frames = repair(moving_frames(300, 3, degree=1), "scene").frames
    rows = slice(None)
    for coded in (v3_layout(frames, 6), mpeg_anchor_layout(frames, MPEG_QPS[0])):
        assert len(coded.frames) == 3 and coded.bytes > 1000
        for shown, given in zip(coded.frames, frames, strict=True):
            assert shown.sh_rest.shape == given.sh_rest.shape
            extent = np.ptp(given.means, axis=0).max()
            assert np.abs(shown.means[rows] - given.means).max() <= 0.02 * extent
            assert np.abs(shown.opacities() - given.opacities()).max() <= 0.05
            assert np.abs(shown.sh_dc - given.sh_dc).max() <= 0.15


def test_finer_settings_cost_more():
    frames = repair(moving_frames(300, 3), "scene").frames
    assert v3_layout(frames, 6).bytes > v3_layout(frames, 26).bytes
    assert mpeg_anchor_layout(frames, MPEG_QPS[0]).bytes > mpeg_anchor_layout(frames, MPEG_QPS[-1]).bytes
