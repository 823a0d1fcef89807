"""Tiers and levels are nested, and hold what is used most."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.decoder.decode import decode_canonical, decode_frames, decode_segment
from airgs_codec.encoder.plan import assign_depths, assign_tiers
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.inspect.validate import validate
from airgs_codec.package.package import open_package
from airgs_codec.package.tables import STATIC
from airgs_codec.scene.sequence import open_sequence
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
    core = m.groups[0].units[0].count
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
