"""Tiers and levels are nested, and hold what is used most."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.grid import fit_grid, grid_codes
from airgs_codec.coding.motion import motion_classes, motion_units, share_class
from airgs_codec.encoder.plan import assign_depths, assign_tiers
from airgs_codec.encoder.sample import at_equal_error, encode_and_decode
from airgs_codec.media.h264 import state_codec
from tests.faces import (
    STATIC,
    EncodeSettings,
    LevelSettings,
    decode_canonical,
    decode_frames,
    decode_segment,
    encode,
    open_package,
    open_sequence,
    validate,
)
from tests.support.scenes import moving_frames, write_sequence


def test_tiers_hold_the_most_used_first():
    usage = np.array([0.1, 0.9, 0.5, 0.7, 0.3])
    assert assign_tiers(usage, (0.4, 0.6)).tolist() == [1, 0, 1, 0, 1]
    assert assign_tiers(np.ones(1), (0.8, 0.2)).tolist() == [0]
    assert assign_tiers(np.array([1.0, 2.0]), (0.1, 0.9)).tolist() == [1, 0]  # the first is never empty


@given(
    npst.arrays(np.float64, 30, elements=st.floats(0, 10)),
    npst.arrays(np.bool_, 30),
    st.lists(st.floats(0, 0.99), min_size=1, max_size=6).map(sorted),
)
def test_levels_are_nested_and_withhold_their_share_of_the_lowest_scores(score, moving, shares):
    depths = assign_depths(score, moving, shares)
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
    classes = motion_classes(sensitivity, 1e-9)
    means = rng.normal(size=(4096, 3)).astype(np.float32)
    means = means[
        np.argsort(grid_codes(means, np.zeros_like(classes), fit_grid(means, np.zeros_like(classes), 1e-3))[0])
    ]
    turn = np.cross([0.1, 0.2, 1.0], means + np.array([3, 0, 0])) if together else rng.normal(size=means.shape)
    moved = np.array([3 * np.sin(0.2 + 0.3 * t) * turn.T for t in range(8)])
    chosen = share_class(classes, sensitivity, moved, 1.0)
    assert len(np.unique(chosen)) == (1 if together else len(np.unique(classes)))

    units = motion_units(classes).astype(np.float64)
    shared = np.sqrt(np.mean(sensitivity * units**2) / np.mean(sensitivity))
    assert not together or abs(chosen[0] - np.log2(shared)) <= 0.5
    codec = state_codec("veryfast")
    scores = []
    for unit in (units, shared):
        coded, decoded = encode_and_decode(moved / unit, np.ones(3), codec)
        error = float(np.mean(sensitivity * np.square((decoded - moved / unit) * unit)))
        scores.append(at_equal_error(sum(coded), error))
    assert scores[together] < 0.9 * scores[not together]


def test_depths_keep_to_tiers():
    score, moving = np.array([5.0, 4.0, 3.0, 2.0]), np.ones(4, bool)
    tiers = np.array([0, 1, 0, 1], np.uint8)
    assert assign_depths(score, moving, [0.0, 0.25, 0.5], tiers, [2, 2, 1]).tolist() == [2, 1, 1, 0]
    assert assign_depths(score, moving, [0.0, 0.25], tiers, [2, 1]).tolist() == [1, 0, 1, 0]


def test_levels_of_one_tier_do_with_the_first_tier(tmp_path):
    frames = moving_frames(600, 4)
    sequence = open_sequence(write_sequence(tmp_path / "scene", frames))
    levels = (LevelSettings(0.0), LevelSettings(0.3, 1.5), LevelSettings(0.5, 2.0, 1, 1), LevelSettings(0.6, 3.0, 1, 1))
    settings = EncodeSettings(calibrate="none", levels=levels, tiers=(0.6, 0.4), preset="veryfast", threads=2)
    encode(sequence, tmp_path / "out", settings)
    package = open_package(tmp_path / "out")
    m = package.manifest
    assert validate(tmp_path / "out") == []
    assert [level.tiers for level in m.levels] == [2, 2, 1, 1]
    assert not any(path.startswith("key/T1") for path in m.rung_files(0, 3))
    assert any(path.startswith("key/T1") for path in m.rung_files(0, 1))
    core = m.groups[0].tiers[0].count
    assert len(next(decode_frames(package, 0, 1, level=3)).gaussians) == core
    both = decode_canonical(package, 0, 0)
    assert (both.depths[core:][both.depths[core:] != STATIC] < 2).all()
    alone = list(decode_segment(package, 0, decode_canonical(package, 0, 0, 1), 3, range(4)))
    beside = list(decode_segment(package, 0, both, 3, range(4)))  # a viewer that has the second tier as well
    for a, b in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(a.means, b.means[:core])
        np.testing.assert_array_equal(a.opacity_logits, b.opacity_logits[:core])


def test_the_share_withheld_follows_the_steps_without_a_jump():
    settings = EncodeSettings(
        calibrate="none", levels=(LevelSettings(0.0), LevelSettings(0.0, 2.0)), shares=((0.5, 0.2), (2.0, 0.6))
    )
    assert [level.pruned for level in settings.at(1.0).levels] == pytest.approx([0.4, 0.6])
    assert [level.pruned for level in settings.at(0.25).levels] == pytest.approx([0.2, 0.2])
    assert settings.at(1.001).levels[0].pruned == pytest.approx(0.4, abs=0.001)
