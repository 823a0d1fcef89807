"""What is measured of every rung, and with how many pictures."""

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder import measure
from airgs_codec.encoder.measure import (
    LOWER,
    OFF_LADDER,
    ROUNDS,
    QualityQuery,
    Rounds,
    measure_groups,
    measure_round,
    pictures_of,
)
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.survey import ViewPlan
from airgs_codec.media.metrics import psnr
from airgs_codec.package.manifest import Groups, on_ladder, pooled_quality
from airgs_codec.package.package import Package, open_package
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


def measured(small, monkeypatch, unsure, lower):
    """For every rung (segment, level, key quality) squared errors of it and of the top rung; and the tables.

    24 pictures a round, until doubts are as small as `unsure` and `lower`.
    """
    package, sequence = small
    errors, tops = defaultdict(list), {}

    def ask(asked):
        pictures = pictures_of(views, package.manifest, 0, asked, len(package.manifest.segments))
        found = measure_round(package, sequence, views.renderer, 0, pictures)
        for segment, of_segment in enumerate(found):
            by_rung = dict(zip(asked.strides, of_segment, strict=True))
            if (0, 0) in by_rung:
                tops[segment, asked.number] = by_rung[0, 0].squared
            for (level, key), of_rung in by_rung.items():
                assert len(of_rung.alike) == (len(of_rung.squared) if asked.number == 0 else 0)
                top = tops[segment, asked.number][:: asked.strides[level, key]]
                errors[segment, level, key] += zip(of_rung.squared, top, strict=True)
        return [found]

    monkeypatch.setattr(measure, "UNSURE", unsure)
    monkeypatch.setattr(measure, "UNSURE_LOWER", lower)
    views = ViewPlan.of(sequence, 24)  # small pictures: twice as many
    found = measure_groups(QualityQuery(package.manifest, [0], views, Rounds(12), ask))
    assert len(package.manifest.groups) == 1 and len(errors) == len(package.manifest.segments) * 4
    return errors, found.whole(package.manifest)


def test_every_rung_is_measured_once_with_fewer_pictures_than_the_top_one(small, monkeypatch):
    """What is measured in few pictures is scaled by what the top rung shows in others."""
    errors, m = measured(small, monkeypatch, unsure=100.0, lower=100.0)
    few = -(-24 // OFF_LADDER)
    check_scaled(errors, m, {(0, 0): 24, (1, 1): 24 // LOWER, (0, 1): few, (1, 0): few})


def test_more_pictures_of_the_top_rung_are_measured_until_its_error_is_sure(small, monkeypatch):
    errors, m = measured(small, monkeypatch, unsure=0.0, lower=100.0)
    few = -(-24 // OFF_LADDER)
    check_scaled(errors, m, {(0, 0): 24 * ROUNDS, (1, 1): 24 // LOWER, (0, 1): few, (1, 0): few})


def test_more_pictures_are_measured_of_unsure_rungs_that_no_mixture_beats(small, monkeypatch):
    """Here finest keys with coarse states are such a mixture."""
    more = 24 * (ROUNDS - 1)
    errors, m = measured(small, monkeypatch, unsure=100.0, lower=0.0)
    rungs = [(j, q) for j in range(2) for q in range(2)]
    ladder = on_ladder([(m.bytes_of(m.rung_files(q, j)), pooled_quality(m, j, q).psnr) for j, q in rungs])
    assert [rung for rung, there in zip(rungs, ladder, strict=True) if there] == [(0, 0), (0, 1), (1, 1)]
    few = -(-24 // OFF_LADDER)
    check_scaled(errors, m, {(0, 0): 24 + more, (1, 1): 24 // LOWER + more, (0, 1): few + more, (1, 0): few})


@pytest.mark.parametrize(("rounds", "known"), [(1, False), (2, True)])
def test_one_picture_does_not_tell_its_doubt(small, rounds, known):
    package, sequence = small
    m, views = package.manifest, replace(ViewPlan.of(sequence, 24), small=False)
    m = replace(m, groups=Groups.of([replace(m.groups[0], segments=m.groups[0].segments[:1])]))

    def ask(asked):
        pictures = pictures_of(views, m, 0, asked, len(m.segments))
        return [measure_round(Package(package.files, m, 0), sequence, views.renderer, 0, pictures)]

    found = measure_groups(QualityQuery(m, [0], views, Rounds(1).again(rounds), ask))
    assert found.pictures == rounds and math.isfinite(found.unsure) is known


def check_scaled(errors, m, counts):
    """Two levels in two key qualities, with so many pictures each; the first one of all has most."""
    assert m.views.measured == counts[0, 0]
    for (segment, level, key), of in errors.items():
        assert len(of) == counts[level, key]
        own, top = np.transpose(of)
        scale = np.mean(errors[segment, 0, 0]) / top.mean()
        table = m.segments[segment].levels[level]
        assert table.psnr[key] == round(psnr(scale * own.mean()), 2)
        assert table.worst[key] == round(psnr(scale * own.max()), 1)
