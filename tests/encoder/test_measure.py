"""What is measured of every rung, with how many pictures, and how sure that is."""

import math

import numpy as np
import pytest

from airgs_codec.encoder import measure
from tests.faces import Difference, EncodeSettings, GaussianSequence, ViewPlan, encode, open_package, orbit_views, psnr
from tests.support.packages import TWO_LEVELS
from tests.support.scenes import moving_frames

COUNT = 12  # pictures of a segment


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A package of two segments of three frames, L0 with Q0 and L1 with Q1, not measured, and its sequence."""
    folder, frames = tmp_path_factory.mktemp("quality") / "out", moving_frames(80, 6)
    sequence = GaussianSequence.from_arrays(frames, cameras=orbit_views(frames[0], count=4, size=64))
    quick = {"calibrate": "none", "measure_pictures": 0, "preset": "ultrafast"}
    encode(sequence, folder, EncodeSettings(levels=TWO_LEVELS, segment_s=0.1, **quick))
    return open_package(folder), sequence


def test_every_rung_is_measured_once_with_fewer_pictures_than_the_top_one(package):
    """What is measured in few pictures is scaled by what the top rung shows in others."""
    opened, sequence = package
    m, views = opened.manifest, ViewPlan.of(sequence, 24)
    assert measure.strides_of(m) == {(0, 0): 1, (0, 1): 6, (1, 0): 6, (1, 1): 2}
    pictures = measure.pictures_of(views, m, 0, COUNT)
    errors = measure.measure_group(opened, sequence, views.renderer, 0, pictures)
    measured = measure.with_quality(m, [errors], COUNT).manifest
    assert measured.views.measured == COUNT and len(errors) == len(m.segments) == 2
    for segment, of_segment in zip(measured.segments, errors, strict=True):
        top = np.array([one.mse for one in of_segment[0]])
        for ((level, key), stride), found in zip(measure.strides_of(m).items(), of_segment, strict=True):
            own, table = np.array([one.mse for one in found]), segment.levels[level]
            assert len(own) == -(-COUNT // stride)
            scale = top.mean() / top[::stride].mean()
            assert table.psnr[key] == round(psnr(scale * own.mean()), 2)
            assert table.worst[key] == round(psnr(scale * own.max()), 1)
            assert table.ssim[key] == round(np.mean([one.ssim for one in found]), 4)
            assert table.delta_e[key] == round(np.mean([one.delta_e for one in found]), 2)


@pytest.mark.parametrize(("name", "segments", "of_segment"), [("fox", 2, 4), ("paper", 1, 1)])
def test_an_encode_has_as_many_pictures_as_were_asked_for_and_each_segment_one(package_of, name, segments, of_segment):
    m = open_package(package_of(name)).manifest
    assert (len(m.segments), m.views.measured) == (segments, of_segment)
    assert [measure.pictures_a_segment(64, number) for number in (1, 3, 64, 1000)] == [64, 22, 1, 1]


def test_a_claim_is_as_sure_as_its_pictures_agree(package):
    """Two standard errors hold for most draws of pictures, whose errors are heavy-tailed: here, log-normal."""
    m, rng, inside = package[0].manifest, np.random.default_rng(0), 0

    def uncertainty(*of_segments):
        """What `with_quality` says of squared errors of the top rung of two segments."""
        errors = [[[Difference(value, 1.0, 0.0) for value in of]] * len(measure.strides_of(m)) for of in of_segments]
        return measure.with_quality(m, [errors], len(of_segments[0])).uncertainty

    assert uncertainty([2.0, 2.0], [2.0, 2.0]) == uncertainty([0.0], [0.0]) == 0.0
    spread = 4 * 0.25**2 * 1.0 * 4 / 3  # four pictures, each for a quarter of the frames, 1 off their mean of 2
    assert uncertainty([1.0, 3.0], [1.0, 3.0]) == pytest.approx(spread**0.5 / 2)
    decibels = [measure.uncertainty_db(share) for share in (0.0, 0.5)]
    assert decibels == [0.0, pytest.approx(10 * math.log10(2))]
    for _ in range(400):
        errors = rng.lognormal(sigma=0.7, size=(2, 16))
        inside += abs(errors.mean() / math.exp(0.7**2 / 2) - 1) <= 2 * uncertainty(*errors.tolist()) + 1e-12
    assert 0.88 <= inside / 400 <= 0.98
