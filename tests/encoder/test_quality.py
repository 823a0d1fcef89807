"""What is measured of every rung, and with how many pictures."""

import numpy as np
import pytest

from airgs_codec.encoder import quality
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.quality import OFF_LADDER, ROUNDS, QualitySums, Rounds, measure_package
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.views import ViewPlan
from airgs_codec.media.metrics import Reference, psnr
from airgs_codec.package.store import open_package
from airgs_codec.scene.sequence import open_sequence
from tests.support.scenes import moving_frames, write_sequence

LEVELS = (LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A package of two segments, L0 with Q0 and L1 with Q1, not measured."""
    folder = tmp_path_factory.mktemp("quality")
    sequence = open_sequence(write_sequence(folder / "scene", moving_frames(80, 6)))
    settings = EncodeSettings(calibrate="none", levels=LEVELS, measure_pictures=0, preset="ultrafast", segment_s=0.1)
    encode(sequence, folder / "out", settings)
    return open_package(folder / "out"), sequence


def test_the_worst_picture_is_that_with_the_largest_error():
    reference, sums = np.full((24, 24, 3), 0.5, np.float32), QualitySums()
    for error in (0.01, 0.1, 0.02):
        sums.add(reference + np.float32(error), Reference.of(reference))
    found = sums.quality()
    assert found.worst == pytest.approx(20, abs=1e-3)
    assert found.psnr == pytest.approx(psnr((0.0001 + 0.01 + 0.0004) / 3), abs=1e-3)


def test_no_rung_is_better_in_its_worst_picture_than_on_average(demo_package):
    for segment in open_package(demo_package).manifest.segments:
        for level in segment.levels:
            assert len(level.psnr) == len(level.worst) == 2
            assert all(worst <= mean for worst, mean in zip(level.worst, level.psnr, strict=True))
            assert any(worst < mean for worst, mean in zip(level.worst, level.psnr, strict=True))


def measured_sums(small, monkeypatch, unsure):
    """The sums of every segment, level and key quality of a package, 24 pictures at a time, and its tables."""
    package, sequence = small
    sums = []

    class Kept(QualitySums):
        def __init__(self):
            super().__init__()
            sums.append(self)

    monkeypatch.setattr(quality, "QualitySums", Kept)
    monkeypatch.setattr(quality, "UNSURE", unsure)
    views, groups = ViewPlan.of(sequence, 24), range(len(package.manifest.groups))  # small pictures: twice as many
    measured = measure_package(package, sequence, views, groups, Rounds(12))
    made = len(package.manifest.segments) * 4
    return sums[:made], measured.whole(package.manifest)


def test_rungs_of_the_ladder_are_measured_with_all_pictures_and_others_with_fewer(small, monkeypatch):
    sums, m = measured_sums(small, monkeypatch, unsure=100.0)
    few = -(-24 // OFF_LADDER)
    counts = [len(of_rung.squared) for of_rung in sums]
    assert counts == [24, few, few, 24] * len(m.segments)  # L0 with Q0 and Q1, L1 with Q0 and Q1
    assert all(len(level.psnr) == len(level.worst) == 2 for s in m.segments for level in s.levels)
    assert m.views.measured == 24


def test_more_pictures_are_measured_until_the_error_is_sure(small, monkeypatch):
    sums, m = measured_sums(small, monkeypatch, unsure=0.0)
    assert {len(of_rung.squared) for of_rung in sums} == {24 * ROUNDS, -(-24 // OFF_LADDER) * ROUNDS}
    assert m.views.measured == 24 * ROUNDS


def test_what_is_measured_in_few_pictures_is_scaled_by_what_the_others_say(small, monkeypatch):
    sums, m = measured_sums(small, monkeypatch, unsure=100.0)
    own, other = sums[0].squared, sums[1].squared  # L0 with its own key quality, and with the other
    expected = np.mean(own) * np.sum(other) / np.sum(own[::OFF_LADDER])
    assert m.segments[0].levels[0].psnr[1] == pytest.approx(psnr(expected), abs=0.01)
    assert m.segments[0].levels[0].psnr[0] == pytest.approx(psnr(np.mean(own)), abs=0.01)
