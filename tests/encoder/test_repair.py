"""What an encode leaves out is taken back where pictures miss it more than was expected."""

from dataclasses import replace

import pytest

from airgs_codec.analysis.importance import ExpectedError
from airgs_codec.encoder.batch import Calibrated, measure_encoded
from airgs_codec.encoder.repair import ATTEMPTS, SHORTFALL_DB, encode_repaired, take_back
from tests.faces import EncodeSettings, LevelSettings, ViewPlan, open_sequence, pooled_quality, temporary_work
from tests.support.jobs import prepared_as_one_group
from tests.support.regions import place, region
from tests.support.scenes import moving_frames, write_sequence

SETTINGS = EncodeSettings(
    calibrate="none",
    levels=(LevelSettings(0.0), LevelSettings(0.5, 4.0, quality=1)),
    tiers=(1.0,),
    key_factors=(1.0, 4.0),
    decide_pictures=6,
    preset="ultrafast",
    threads=1,
)
HALF = replace(SETTINGS, levels=tuple(replace(level, pruned=0.5) for level in SETTINGS.levels), shares=((1.0, 0.4),))
EXPECTED = ExpectedError(1e-5, 1e-5, 8e-5)  # half a decibel more than all of it is 1.22e-5


@pytest.mark.parametrize(
    ("settings", "rows", "held", "changes", "words"),
    [
        (SETTINGS, 2.2e-5, 2.2e-5, {}, ""),
        (SETTINGS, 2.25e-5, 2.2e-5, {"rows"}, "Gaussians left out cost 46.5 dB where 50.0 dB were expected: fewer are"),
        (SETTINGS, 1e-4, 5e-5, {"rows"}, "Gaussians left out cost 40.0 dB where 50.0 dB were expected: fewer are"),
        (SETTINGS, 2.2e-5, 1e-3, {}, ""),  # nothing was withheld
        (HALF, 2.2e-5, 2.25e-5, {"pruned"}, "updates withheld cost 46.5 dB where 50.0 dB were expected"),
        (HALF, 5e-5, 1e-4, {"pruned"}, "updates withheld cost 40.0 dB where 50.0 dB were expected"),
    ],
)
def test_what_costs_half_a_decibel_of_all_that_was_expected_is_taken_back(settings, rows, held, changes, words):
    repaired, story = take_back(settings, EXPECTED, rows, held) or (settings, "")
    assert story.startswith(words)
    assert repaired.steps.rows == settings.steps.rows / (2 if "rows" in changes else 1)
    halved = 0.5 if changes else 1.0
    if settings is HALF:
        assert repaired.levels == (replace(HALF.levels[0], pruned=0.5 * halved), HALF.levels[1])
        assert repaired.shares == ((1.0, 0.4 * halved),)
    else:
        assert repaired.levels == settings.levels


def test_few_updates_are_taken_back_altogether():
    few = replace(HALF, levels=tuple(replace(level, pruned=0.1) for level in HALF.levels))
    assert take_back(few, EXPECTED, 0.0, 1e-4)[0].levels[0].pruned == 0.0


def test_what_was_withheld_is_taken_back_until_a_promise_is_kept(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path / "scene", moving_frames(200, 4)))
    views = ViewPlan.of(sequence, 6, region=replace(region(place(0.0)), width=96, height=72))
    with temporary_work() as work:
        prepared = prepared_as_one_group(sequence, views, work)

        def encoded(settings, expected):
            calibrated = Calibrated(prepared, settings, expected, (), False)
            found, chosen, stories = encode_repaired(calibrated, settings, work)
            quality = pooled_quality(measure_encoded(found, prepared, 12).manifest, 0, 0)
            return quality.psnr, chosen, stories

        reached, chosen, stories = encoded(SETTINGS, None)
        assert chosen == SETTINGS and stories == []
        assert encoded(HALF, None)[0] < reached - SHORTFALL_DB
        quality, chosen, stories = encoded(HALF, ExpectedError(steps=10 ** (-reached / 10)))
        assert quality > reached - SHORTFALL_DB
        assert 1 <= len(stories) < ATTEMPTS and "updates withheld cost" in stories[0]
        assert chosen.levels[0].pruned < HALF.levels[0].pruned
