"""The comparison itself: BD-rate on curves whose answer is known."""

import pytest

from tools.lab.rd.subject import RdPoint, bd_rate, kb_at


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
