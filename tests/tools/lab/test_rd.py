"""The comparison itself: BD-rate on curves whose answer is known, and layouts that decode to what they were given."""

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.scene.frames import repair
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.scenes import moving_frames
from tools.lab.rd.coders import MPEG_QPS
from tools.lab.rd.fourdgs import fourdgs_trials
from tools.lab.rd.layouts import PUBLISHED, V3_FORMS, mpeg_anchor_layout, v3_layout
from tools.lab.rd.subject import RdPoint, Subject, bd_rate, kb_at
from tools.lab.rd.written import written_trials

PRESET = "medium"
ACTIVATED, STORED = V3_FORMS


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


def test_bytes_at_a_quality_are_between_points_and_never_beyond_them():
    assert kb_at(WIDE, 44) == pytest.approx(20)
    assert kb_at(WIDE, 42.5) == pytest.approx((14 * 20) ** 0.5)
    assert kb_at(WIDE, 37) is None is kb_at(WIDE[:1], 38)


@pytest.mark.parametrize("preset", [PRESET, PUBLISHED])
def test_all_layouts_decode_to_what_they_were_given(preset):
    frames = repair(moving_frames(300, 3, degree=1), "scene").frames
    forms = [v3_layout(frames, 6, preset, form) for form in V3_FORMS]
    for coded in (*forms, mpeg_anchor_layout(frames, MPEG_QPS[0], preset)):
        assert len(coded.frames) == 3 and coded.bytes > 1000
        for shown, given in zip(coded.frames, frames, strict=True):
            assert shown.sh_rest.shape == given.sh_rest.shape
            extent = np.ptp(given.means, axis=0).max()
            assert np.abs(shown.means - given.means).max() <= 0.02 * extent
            assert np.abs(shown.opacities() - given.opacities()).max() <= 0.05
            assert np.abs(shown.sh_dc - given.sh_dc).max() <= 0.15


def test_frames_pay_for_their_packets_and_an_equal_part_of_the_rest():
    frames = repair(moving_frames(300, 5), "scene").frames
    for coded in (v3_layout(frames, 10, PRESET, ACTIVATED), mpeg_anchor_layout(frames, MPEG_QPS[0], PRESET)):
        assert len(coded.frame_bytes) == 5 and coded.bytes == sum(coded.frame_bytes)
        assert coded.frame_bytes[0] > 2 * max(coded.frame_bytes[1:])  # the picture that needs no other
    one = v3_layout(frames[:1], 10, PRESET, STORED)
    assert one.frame_bytes == [one.bytes]


def test_formats_that_the_package_writes_show_what_they_hold():
    frames = repair(moving_frames(300, 4), "scene").frames
    subject = Subject(open_sequence(FOX), [(0, frames[:2]), (2, frames[2:])], [], [0, 3], {}, {})
    for trial in written_trials():
        if trial.coder == "SPZ":
            continue
        coded = trial.code(subject)
        assert set(coded.frames) == {0, 3} and coded.bytes_per_frame > 500
        for number, shown in coded.frames.items():
            assert len(shown) == 300
            assert np.abs(shown.means - frames[number].means).max() <= 0.02 * np.ptp(frames[number].means)


@pytest.mark.parametrize("program", ["false", "/nowhere/splat4d"])
def test_an_outside_program_that_fails_is_one_line(program):
    sequence = open_sequence(FOX)
    subject = Subject(sequence, [(i, [sequence.read(i)]) for i in range(10)], [], [0], {}, {})
    with pytest.raises(ConfigError, match=program):
        next(fourdgs_trials(program)).code(subject)
