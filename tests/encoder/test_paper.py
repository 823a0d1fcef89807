"""The ladder of the paper, and settings for a first look."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder.batch import encode_sequence
from airgs_codec.encoder.pipeline import KEY
from airgs_codec.encoder.plan import RowUsage, rank_updates
from airgs_codec.encoder.settings import as_in_paper
from airgs_codec.scene.beside import MEASURES
from tests.faces import (
    STATIC,
    USAGE_NAME,
    EncodeSettings,
    Usage,
    ViewPlan,
    as_preview,
    decode_canonical,
    decode_frames,
    encode,
    open_package,
    open_sequence,
    save_usage,
    temporary_work,
)
from tests.support.jobs import prepared_as_one_group
from tests.support.regions import place, region
from tests.support.scenes import moving_frames, write_sequence

SEEN = replace(region(place(0.0)), width=96, height=72)
PAPER = as_in_paper(
    EncodeSettings(preset="ultrafast", threads=1, measure_pictures=1, decide_pictures=4, region=SEEN, quality=2.0)
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return open_sequence(write_sequence(tmp_path_factory.mktemp("paper") / "scene", moving_frames(200, 4)))


def test_the_papers_ladder_withholds_from_none_to_all(scene, tmp_path):
    m = encode(scene, tmp_path / "out", PAPER).manifest
    assert [v.pruned for v in m.levels] == [i / 10 for i in range(11)]  # none is dropped, whatever was measured
    assert {v.factor for v in m.levels} == {1.0} and len(m.qualities) == 1 == len(m.groups[0].tiers)
    rows = [atlas.rows for atlas in m.groups[0].levels]
    assert rows[0] == 100 and rows == sorted(rows, reverse=True) and rows[-1] == 0
    package = open_package(tmp_path / "out")
    canonical = decode_canonical(package, 0, 0).to_gaussians()
    assert not m.state_files(0, 10)
    for frame in decode_frames(package, 0, 4, level=10):
        np.testing.assert_array_equal(frame.gaussians.means, canonical.means)
    moved = next(decode_frames(package, 3, 4, level=0)).gaussians
    assert np.abs(moved.means - canonical.means).max() > 0.05


def test_updates_are_withheld_in_the_order_of_hits(scene):
    layout, depths = encoded(scene, PAPER)
    hits, moving = layout.usage.hits, depths != STATIC
    for low, high in zip(range(9), range(1, 10), strict=True):
        first, second = hits[moving & (depths == low)], hits[moving & (depths == high)]
        assert first.max() <= second.min()
    assert moving.sum() == 100 and len(set(hits[moving].tolist())) > 20


def encoded(scene, settings):
    """Layout of the only group, and the depths of its rows."""
    views = ViewPlan.of(scene, settings.decide_pictures, region=SEEN)
    with temporary_work() as work:
        prepared = prepared_as_one_group(scene, views, work)
        depths = encode_sequence(prepared, settings, work).group(0).depths
        return work.result(prepared.job(KEY, 0, settings)).layout, depths


@pytest.fixture
def measured(scene, tmp_path):
    """The scene with usage as a trainer leaves it: hits rise with the row, every other measure falls."""
    shutil.copytree(scene.folder, tmp_path / "scene")
    rise = np.arange(1, 201)
    fall = rise[::-1].astype(float)
    save_usage(tmp_path / "scene" / USAGE_NAME, {(0, 4): Usage(fall, fall / 200, rise)})
    return open_sequence(tmp_path / "scene")


@pytest.mark.parametrize("usage", MEASURES)
def test_other_measures_of_the_trainer_do_not_rank_the_papers_levels(measured, usage):
    """Rows of level k have fewer hits than those of level k + 1, whatever usage ranks the key tiers."""
    settings = replace(PAPER, usage=usage)
    layout, depths = encoded(measured, settings)
    rows = layout.rows
    moving = depths != STATIC
    assert moving.sum() == 100
    order = rows[moving][np.argsort(rows[moving])]  # hits are the row + 1
    expected = np.arange(100) // 10  # ten rows a level, the one with the fewest hits first
    assert dict(zip(rows[moving].tolist(), depths[moving].tolist(), strict=True)) == dict(
        zip(order.tolist(), expected.tolist(), strict=True)
    )


def test_hits_rank_alone_whatever_changes():
    rng = np.random.default_rng(0)
    changes, hits = rng.normal(size=(3, 13, 20)) * 9, rng.permutation(20).astype(float)
    usage = RowUsage(rng.random(20), hits)
    score, moving = rank_updates(changes, np.ones((13, 20)), usage, "hits")
    assert score.tolist() == hits.tolist() and moving.all()
    by_usage, _ = rank_updates(changes, np.ones((13, 20)), usage, "usage")
    np.testing.assert_allclose(by_usage, usage.score * np.sqrt(np.square(changes).sum(axis=(0, 1)) / 3))


def test_a_first_look_calibrates_nothing_and_measures_little():
    quick = as_preview(EncodeSettings(quality=1.6))
    assert (quick.calibrate, quick.group_frames, quick.measure_pictures, quick.quality) == ("none", 30, 8, 1.6)
    assert quick.decide_pictures < EncodeSettings().decide_pictures
    asked = as_preview(EncodeSettings(group_frames=12, measure_pictures=0))
    assert (asked.group_frames, asked.measure_pictures) == (12, 0)
    assert as_preview(PAPER).levels == PAPER.levels
