"""The ladder of the paper, and settings for a first look."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.decoder.decode import decode_canonical, decode_frames
from airgs_codec.encoder.encoder import EncodeJob, encode_sequence
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.rank import RowUsage, rank_updates
from airgs_codec.encoder.settings import EncodeSettings, as_in_paper, as_preview
from airgs_codec.encoder.survey import survey_groups
from airgs_codec.encoder.views import ViewPlan
from airgs_codec.package.store import open_package
from airgs_codec.package.tables import STATIC
from airgs_codec.scene.sequence import open_sequence
from tests.support.regions import place, region
from tests.support.scenes import moving_frames, write_sequence

SEEN = replace(region(place(0.0)), width=96, height=72)
PAPER = as_in_paper(
    EncodeSettings(preset="ultrafast", jobs=1, measure_pictures=1, decide_pictures=4, region=SEEN, quality=2.0)
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


def test_updates_are_withheld_in_the_order_of_hits(scene, tmp_path):
    views = ViewPlan.of(scene, PAPER.decide_pictures, region=SEEN)
    surveys = survey_groups(scene, [(0, 4)], views, lambda *_: None)
    encoded = encode_sequence(EncodeJob(scene, surveys, views), PAPER, tmp_path)
    layout, depths = encoded.layouts[0], encoded.depths[0]
    hits = surveys[0].usage.hits[layout.rows]
    assert hits.tolist() == layout.usage.hits.tolist()
    moving = depths != STATIC
    order = np.argsort(depths[moving], kind="stable")
    for low, high in zip(range(9), range(1, 10), strict=True):
        first, second = hits[moving & (depths == low)], hits[moving & (depths == high)]
        assert first.max() <= second.min()
    assert len(order) == 100


def test_hits_rank_alone_whatever_changes():
    rng = np.random.default_rng(0)
    changes, hits = rng.normal(size=(3, 13, 20)) * 9, rng.permutation(20).astype(float)
    usage = RowUsage(rng.random(20), hits, rng.random(20))
    score, moving = rank_updates(changes, changes, np.ones((13, 20)), usage, "hits", True)
    assert score.tolist() == hits.tolist() and moving.all()
    by_usage, _ = rank_updates(changes, changes, np.ones((13, 20)), usage, "usage", True)
    assert by_usage.tolist() == usage.moved.tolist()


def test_a_first_look_calibrates_nothing_and_measures_little():
    quick = as_preview(EncodeSettings(quality=1.6))
    assert (quick.calibrate, quick.group_frames, quick.measure_pictures, quick.quality) == ("none", 30, 2, 1.6)
    assert quick.decide_pictures < EncodeSettings().decide_pictures
    asked = as_preview(EncodeSettings(group_frames=12, measure_pictures=0))
    assert (asked.group_frames, asked.measure_pictures) == (12, 0)
    assert as_preview(PAPER).levels == PAPER.levels
