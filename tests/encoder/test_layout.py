"""Tiers and levels are nested, and hold what is used most; the ladder of the paper; settings for a first look."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding import motion, sidecar
from airgs_codec.encoder import layout as module
from airgs_codec.encoder import sample
from airgs_codec.media.h264 import delta_codec
from tests import faces
from tests.faces import STATIC, EncodeSettings, LevelSettings, as_fast, decode_canonical, decode_frames, open_package
from tests.support.packages import PACKAGES, PAPER, laid_out
from tests.support.scenes import write_sequence


def test_tiers_hold_the_most_used_first_and_depths_keep_to_tiers():
    usage = np.array([0.1, 0.9, 0.5, 0.7, 0.3])
    assert module.assign_tiers(usage, (0.4, 0.6)).tolist() == [1, 0, 1, 0, 1]
    assert module.assign_tiers(np.ones(1), (0.8, 0.2)).tolist() == [0]
    assert module.assign_tiers(np.array([1.0, 2.0]), (0.1, 0.9)).tolist() == [1, 0]  # the first is never empty
    score, moving, tiers = np.array([5.0, 4.0, 3.0, 2.0]), np.ones(4, bool), np.array([0, 1, 0, 1], np.uint8)
    assert module.assign_depths(score, moving, [0.0, 0.25, 0.5], tiers, [2, 2, 1]).tolist() == [2, 1, 1, 0]
    assert module.assign_depths(score, moving, [0.0, 0.25], tiers, [2, 1]).tolist() == [1, 0, 1, 0]


SCORES = npst.arrays(np.float64, 30, elements=st.floats(0, 10))
SHARES = st.lists(st.floats(0, 0.99), min_size=1, max_size=6).map(sorted)


@given(SCORES, npst.arrays(np.bool_, 30), SHARES)
def test_levels_are_nested_and_withhold_their_share_of_the_lowest_scores(score, moving, shares):
    depths = module.assign_depths(score, moving, shares)
    assert (depths[~moving] == STATIC).all()
    for level, share in enumerate(shares):
        kept = (depths >= level) & (depths != STATIC)
        assert kept.sum() == round((1 - share) * moving.sum())
        if kept.any() and (moving & ~kept).any():
            assert score[kept].min() >= score[moving & ~kept].max()


@pytest.mark.parametrize("together", [True, False])
def test_rows_share_a_motion_class_where_that_takes_fewer_bytes_at_equal_error(together):
    """They do where they turn as one body; where each moves on its own, the fine ones pay for the others."""
    rng = np.random.default_rng(3)
    sensitivity = 4.0 ** rng.integers(-4, 5, 4096)
    classes = motion.motion_classes(sensitivity, 1e-9)
    means, still = rng.normal(size=(4096, 3)).astype(np.float32), np.zeros_like(classes)
    means = means[np.argsort(sidecar.grid_codes(means, still, sidecar.fit_grid(means, still, 1e-3))[0])]
    turn = np.cross([0.1, 0.2, 1.0], means + np.array([3, 0, 0])) if together else rng.normal(size=means.shape)
    moved = np.array([3 * np.sin(0.2 + 0.3 * t) * turn.T for t in range(8)])
    chosen = motion.share_class(classes, sensitivity, moved, 1.0)
    assert len(np.unique(chosen)) == (1 if together else len(np.unique(classes)))

    units = motion.motion_units(classes).astype(np.float64)
    shared = np.sqrt(np.mean(sensitivity * units**2) / np.mean(sensitivity))
    assert not together or abs(chosen[0] - np.log2(shared)) <= 0.5
    codec, scores = delta_codec("veryfast"), []
    for unit in (units, shared):
        coded, decoded = sample.encode_and_decode(moved / unit, np.ones(3), codec)
        error = float(np.mean(sensitivity * np.square((decoded - moved / unit) * unit)))
        scores.append(sum(coded) * error**sample.RATE_OF_ERROR)
    assert scores[together] < 0.9 * scores[not together]


def test_levels_of_one_tier_do_with_the_first_tier(package_of):
    package = open_package(package_of("drift"))
    m = package.manifest
    assert faces.validate(package.files.path) == []
    assert {group.base for group in m.groups} == {None}  # each is coded by itself, as was asked for
    assert not any("differs" in line for line in m.decisions)
    assert [level.tiers for level in m.levels] == [2, 2, 1, 1]
    second = [any(path.startswith("keyframe/T1") for path in m.rung_files(0, level)) for level in (1, 3)]
    assert second == [True, False]
    core, both = m.groups[0].tiers[0].count, decode_canonical(package, 0, 0)
    assert len(next(decode_frames(package, 0, 1, level=3)).gaussians) == core
    assert (both.depths[core:][both.depths[core:] != STATIC] < 2).all()
    # of a viewer that has the first tier alone, and of one that has the second as well
    shown = (faces.decode_segment(package, 0, base, 3, range(4)) for base in (decode_canonical(package, 0, 0, 1), both))
    for a, b in zip(*shown, strict=True):
        np.testing.assert_array_equal(a.means, b.means[:core])
        np.testing.assert_array_equal(a.opacity_logits, b.opacity_logits[:core])


def test_the_share_withheld_follows_the_steps_without_a_jump():
    levels, shares = (LevelSettings(0.0), LevelSettings(0.0, 2.0)), ((0.5, 0.2), (2.0, 0.6))
    settings = EncodeSettings(calibrate="none", levels=levels, shares=shares)
    for quality, pruned in ((1.0, [0.4, 0.6]), (0.25, [0.2, 0.2])):
        assert [level.pruned for level in settings.at(quality).levels] == pytest.approx(pruned)
    assert settings.at(1.001).levels[0].pruned == pytest.approx(0.4, abs=0.001)


def test_bands_that_do_not_show_are_left_out(package_of):
    package = open_package(package_of("calibrated"))
    assert faces.validate(package.files.path) == []
    assert package.manifest.sh_degree == 1
    assert any(line.startswith("2 SH bands left out: ") for line in package.manifest.decisions)
    assert next(decode_frames(package, 0, 1)).gaussians.sh_rest.shape[1] == 3


def test_the_papers_ladder_withholds_from_none_to_all_in_the_order_of_hits(package_of):
    package = open_package(package_of("paper"))
    m, base = package.manifest, decode_canonical(package, 0, 0)
    assert [v.pruned for v in m.levels] == [i / 10 for i in range(11)]  # none is dropped, whatever was measured
    assert {v.factor for v in m.levels} == {1.0} and len(m.qualities) == 1 == len(m.groups[0].tiers)
    rows = [atlas.rows for atlas in m.groups[0].levels]
    assert rows[0] == 100 and rows == sorted(rows, reverse=True) and rows[-1] == 0
    assert not m.delta_files(0, 10)
    still = base.to_gaussians().means
    for frame in decode_frames(package, 0, 4, level=10):
        np.testing.assert_array_equal(frame.gaussians.means, still)
    assert np.abs(faces.decode(package, 3).means - still).max() > 0.05
    hits, moving = laid_out(PACKAGES["paper"].scene(), PAPER).hits, base.depths != STATIC
    for low, high in pairwise(range(10)):
        assert hits[moving & (base.depths == low)].max() <= hits[moving & (base.depths == high)].min()
    assert moving.sum() == 100 and len(set(hits[moving].tolist())) > 20


@pytest.mark.parametrize("measure", faces.MEASURES)
def test_other_measures_of_the_trainer_do_not_rank_the_papers_levels(tmp_path, measure):
    """Its hits rise with the row, every other measure falls: they rank updates, whatever ranks the keyframe tiers."""
    rise = np.arange(1, 201)
    fall = rise[::-1].astype(float)
    scene = write_sequence(tmp_path / "scene", PACKAGES["paper"].groups()[0])
    faces.save_usage(scene / faces.USAGE_NAME, {(0, 4): faces.Usage(fall, fall / 200, rise)})
    layout = laid_out(faces.open_sequence(scene), replace(PAPER, usage=measure))
    np.testing.assert_array_equal(layout.hits, layout.rows + 1)
    falls = np.diff(layout.score[np.argsort(layout.rows)])
    assert (falls > 0).all() if measure == "hits" else measure == "importance" or (falls < 0).all()


@pytest.mark.parametrize("rank", ["hits", "usage"])
def test_hits_rank_alone_whatever_changes_and_usage_with_the_size_of_changes(rank):
    layout = laid_out(PACKAGES["paper"].scene(), PAPER)
    changes = np.random.default_rng(0).normal(size=(3, 13, len(layout.rows))) * 9
    score, moving = module.rank_updates(layout, slice(None), changes, rank)
    size = np.sqrt(np.square(changes).sum(axis=(0, 1)) / 3)
    np.testing.assert_allclose(score, layout.hits if rank == "hits" else layout.score * size)
    assert moving.all()


def test_a_first_look_keeps_what_was_asked_for():
    """The command tells what else it is (tests/cli/test_encode.py)."""
    asked = {"quality": 1.6, "group_frames": 12, "measure_pictures": 0}
    made = as_fast(EncodeSettings(**asked))
    assert {name: getattr(made, name) for name in asked} == asked and as_fast(PAPER).levels == PAPER.levels
