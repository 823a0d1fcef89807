"""What is measured of every rung, and with how many pictures."""

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder import measure
from airgs_codec.encoder.measure import LOWER, OFF_LADDER, ROUNDS, Rounds, measure_groups, measure_round, pictures_of
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.survey import ViewPlan
from airgs_codec.media.metrics import psnr
from airgs_codec.package.package import open_package
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


def measured(small, monkeypatch, unsure):
    """The squared errors of every rung (segment, level, key quality), 24 pictures at a time, and the tables."""
    package, sequence = small
    errors = defaultdict(list)

    def ask(asked):
        pictures = pictures_of(views, package.manifest, 0, asked, len(package.manifest.segments))
        found = measure_round(package, sequence, views.renderer, 0, pictures)
        for segment, of_segment in enumerate(found):
            for level, of_level in enumerate(of_segment):
                for key, of_rung in enumerate(of_level):
                    errors[segment, level, key] += [picture.mse for picture in of_rung]
        return [found]

    monkeypatch.setattr(measure, "UNSURE", unsure)
    views = ViewPlan.of(sequence, 24)  # small pictures: twice as many
    found = measure_groups(package.manifest, [0], views, Rounds(12), ask)
    assert len(package.manifest.groups) == 1 and len(errors) == len(package.manifest.segments) * 4
    return errors, found.whole(package.manifest)


def test_the_top_rung_is_measured_with_all_pictures_and_others_with_fewer(small, monkeypatch):
    """What is measured in few pictures is scaled by what the top rung, and the level's own quality, show in others."""
    errors, m = measured(small, monkeypatch, unsure=100.0)
    assert m.views.measured == 24
    check_scaled(errors, m, 24)


def test_more_pictures_of_the_top_rung_are_measured_until_its_error_is_sure(small, monkeypatch):
    errors, m = measured(small, monkeypatch, unsure=0.0)
    assert m.views.measured == 24 * ROUNDS
    check_scaled(errors, m, 24 * ROUNDS)


@pytest.mark.parametrize(("rounds", "known"), [(1, False), (2, True)])
def test_one_picture_of_each_segment_does_not_tell_its_doubt(small, rounds, known):
    package, sequence = small
    m, views = package.manifest, replace(ViewPlan.of(sequence, 24), small=False)

    def ask(asked):
        pictures = pictures_of(views, m, 0, asked, len(m.segments))
        return [measure_round(package, sequence, views.renderer, 0, pictures)]

    found = measure_groups(m, [0], views, Rounds(1).again(rounds), ask)
    assert found.pictures == rounds and math.isfinite(found.unsure) is known


def check_scaled(errors, m, pictures):
    """Two levels in two key qualities, the first with so many pictures, 24 a round."""
    few = -(-24 // OFF_LADDER)
    counts = {(0, 0): pictures, (1, 1): 24 // LOWER, (0, 1): few, (1, 0): few}
    for (segment, level, key), of in errors.items():
        assert len(of) == counts[level, key]
        top, own, table = errors[segment, 0, 0], errors[segment, level, level], m.segments[segment].levels[level]
        scale = np.mean(top) / np.mean(top[:24:LOWER]) if level else 1
        if key != level:
            scale *= np.mean(own) / np.mean(own[:24:OFF_LADDER] if level == 0 else own[:: OFF_LADDER // LOWER])
        assert table.psnr[key] == round(psnr(scale * np.mean(of)), 2)
        assert table.worst[key] == round(psnr(scale * np.max(of)), 2)
