"""The comparison itself: BD-rate on curves whose answer is known, and layouts that decode to what they were given."""

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.scene.frames import repair
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.scenes import moving_frames
from tools.lab.page import Picture, write_picture
from tools.lab.rd.coders import MPEG_QPS
from tools.lab.rd.experiment import draw, ends
from tools.lab.rd.layouts import mpeg_anchor_layout, v3_layout
from tools.lab.rd.points import RdPoint, bd_rate
from tools.lab.rd.programs import fourdgs_trials
from tools.lab.rd.subject import Subject

PRESET = "medium"


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
    for coded in (v3_layout(frames, 6, PRESET), mpeg_anchor_layout(frames, MPEG_QPS[0], PRESET)):
        assert len(coded.frames) == 3 and coded.bytes > 1000
        for shown, given in zip(coded.frames, frames, strict=True):
            assert shown.sh_rest.shape == given.sh_rest.shape
            extent = np.ptp(given.means, axis=0).max()
            assert np.abs(shown.means[rows] - given.means).max() <= 0.02 * extent
            assert np.abs(shown.opacities() - given.opacities()).max() <= 0.05
            assert np.abs(shown.sh_dc - given.sh_dc).max() <= 0.15


def test_frames_pay_for_their_packets_and_an_equal_part_of_the_rest():
    frames = repair(moving_frames(300, 5), "scene").frames
    for coded in (v3_layout(frames, 10, PRESET), mpeg_anchor_layout(frames, MPEG_QPS[0], PRESET)):
        assert len(coded.frame_bytes) == 5 and coded.bytes == sum(coded.frame_bytes)
        assert coded.frame_bytes[0] > 2 * max(coded.frame_bytes[1:])  # the picture that needs no other
    one = v3_layout(frames[:1], 10, PRESET)
    assert one.frame_bytes == [one.bytes]


def test_finer_settings_cost_more():
    frames = repair(moving_frames(300, 3), "scene").frames
    assert v3_layout(frames, 6, PRESET).bytes > v3_layout(frames, 26, PRESET).bytes
    finest, coarsest = (mpeg_anchor_layout(frames, qps, PRESET) for qps in (MPEG_QPS[0], MPEG_QPS[-1]))
    assert finest.bytes > coarsest.bytes


@pytest.mark.parametrize("program", ["false", "/nowhere/splat4d"])
def test_an_outside_program_that_fails_is_one_line(program):
    sequence = open_sequence(FOX)
    subject = Subject(sequence, [(i, [sequence.read(i)]) for i in range(10)], [], [0], {}, {})
    with pytest.raises(ConfigError, match=program):
        next(fourdgs_trials(program)).code(subject)


def test_the_report_has_a_row_for_every_coder(tmp_path):
    points = [*WIDE, RdPoint("airgs", "only", 9.0, 40.0, 31.0, 1.0, 1.0)]
    first, last = ends(points, 41, 46)
    assert first["coder"] == "c" and (last["small_kb"], last["large_psnr"]) == (9.0, 40.0)
    write_picture(Picture("rd", "", lambda figure: draw(points, "all", figure)), tmp_path / "rd.png")
    assert (tmp_path / "rd.png").stat().st_size > 5000
