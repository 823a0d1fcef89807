"""How long groups should be: long where little changes, shorter where much does."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder.prepare import SHORTEST, LengthCost, compare_lengths
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import ViewPlan
from airgs_codec.scene.sequence import open_sequence
from tests.support.regions import place, region
from tests.support.scenes import frozen, random_gaussians, write_sequence

FRAMES = 40
FAST = EncodeSettings(preset="ultrafast", threads=1, segment_s=0.1)
CHANGING = ("means", "log_scales", "quaternions", "sh_dc")
SEEN = replace(region(place(0.0)), width=64, height=48)


def drifting(speed, frames=FRAMES, count=300):
    """Every row changes its place, size, turn and colour in a way of its own, by about `speed` a frame."""
    first, rng = random_gaussians(count), np.random.default_rng(1)
    ways = {name: rng.normal(size=getattr(first, name).shape) for name in CHANGING}

    def at(t):
        moved = {name: (getattr(first, name) + speed * t * way).astype(np.float32) for name, way in ways.items()}
        return frozen(replace(first, **moved))

    return [at(t) for t in range(frames)]


def compared(folder, frames, **more):
    sequence = open_sequence(write_sequence(folder / "scene", frames, **more))
    return compare_lengths(sequence, ViewPlan.of(sequence, 8, region=SEEN), FAST)


def test_a_scene_that_stands_still_prefers_the_longest_group(tmp_path):
    costs = compared(tmp_path, drifting(0.0))
    assert costs[0].frames == FRAMES and {cost.frames for cost in costs} == {14, 20, 40}
    assert [cost.score for cost in costs] == sorted(cost.score for cost in costs)


def test_a_scene_that_changes_fast_prefers_shorter_ones(tmp_path):
    costs = compared(tmp_path, drifting(0.03))
    assert costs[0].frames < FRAMES  # whose states need that many bytes more than shorter groups take for keys
    sizes = {cost.frames: cost.bytes for cost in costs}
    assert sizes[FRAMES] == max(sizes.values())


@pytest.mark.parametrize("more", [{"frames": 2 * SHORTEST - 1}, {"keyframes": [0, 20]}])
def test_there_is_nothing_to_choose_for_short_runs_and_named_keyframes(tmp_path, more):
    frames = drifting(0.0, more.pop("frames", FRAMES), count=20)
    assert compared(tmp_path, frames, **more) == []


def test_pictures_without_any_error_do_not_make_a_group_free():
    assert LengthCost(20, 100.0, 0.0).score > LengthCost(40, 50.0, 0.0).score > 0


def test_the_package_says_what_was_chosen_and_groups_follow(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path / "scene", drifting(0.0, count=60)))
    settings = replace(FAST, calibrate="none", measure_pictures=0, decide_pictures=8, region=SEEN)
    chosen = encode(sequence, tmp_path / "auto", settings).manifest
    assert [group.stop - group.start for group in chosen.groups] == [FRAMES]
    assert chosen.decisions[0].startswith(f"groups of {FRAMES} frames, the cheapest on a sample")
    asked = encode(sequence, tmp_path / "asked", replace(settings, group_frames=15)).manifest
    assert [group.stop - group.start for group in asked.groups] == [15, 15, 10]
    assert asked.decisions == ["2 of 3 groups are coded as what differs from an earlier one"]  # it stands still
