"""Which pictures decide and which measure: others, over all frames, from all of the region."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder.survey import CHECKED, DECISION_PIXELS
from tests.faces import ConfigError, EncodeSettings, ViewPlan, World, open_sequence, up_of, world_from
from tests.support.paths import FOX
from tests.support.regions import is_inside, place, region
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.splat_files import glb_bytes


@pytest.fixture(scope="module")
def fox():
    sequence = open_sequence(FOX)
    return sequence, ViewPlan.of(sequence, 24)


def places(views):
    return {view.position.tobytes() for view in views}


def test_no_view_that_decides_measures(fox):
    sequence, plan = fox
    assert plan.trusted and plan.region.source == "cameras"
    assert not places(plan.deciding) & places(plan.measuring)
    for view in [*plan.deciding[:20], *plan.measuring[:20]]:
        assert is_inside(plan.region, view)
    assert max(view.width * view.height for view in plan.deciding) <= 1.01 * DECISION_PIXELS
    assert {(v.width, v.height) for v in plan.measuring} == {(plan.region.width, plan.region.height)}
    for a, b in zip(plan.measuring, ViewPlan.of(sequence, 24).measuring, strict=True):
        assert np.array_equal(a.world_to_camera, b.world_to_camera)


@pytest.mark.parametrize("frames", [1, 2, 5, 10, 23, 24])
def test_all_frames_of_a_group_decide(fox, frames):
    pictures = fox[1].decide(frames)
    assert len(pictures) == fox[1].decided and {frame for frame, _ in pictures} == set(range(frames))
    assert len(places(view for _, view in pictures)) == fox[1].decided


def test_a_long_group_is_looked_at_from_end_to_end(fox):
    frames = [frame for frame, _ in fox[1].decide(240)]
    assert len(set(frames)) == fox[1].decided and (min(frames), max(frames)) == (0, 239)


def test_leaving_out_is_checked_in_views_that_did_not_rank(fox):
    ranking, checking = fox[1].decide(24), fox[1].check(24)
    assert len(checking) == CHECKED and len({frame for frame, _ in checking}) == CHECKED
    assert not places(view for _, view in ranking) & places(view for _, view in checking)


def test_of_small_pictures_twice_as_many_decide(fox):
    given = [replace(region(place(0.0)), width=width, height=300) for width in (300, 400)]
    assert [ViewPlan.of(fox[0], 10, region=one).decided for one in given] == [20, 10]


@pytest.mark.parametrize("length", [1, 3, 5, 7, 12])
def test_all_frames_of_a_segment_are_measured(fox, length):
    pictures = fox[1].measure(2, 100, 100 + length, 12)
    assert len(pictures) == 12 and {frame for frame, _ in pictures} == set(range(100, 100 + length))
    assert [frame for frame, _ in pictures] == sorted(frame for frame, _ in pictures)


def test_segments_are_measured_from_views_of_their_own(fox):
    looks = [places(view for _, view in fox[1].measure(index, 0, 24, 12)) for index in range(5)]
    assert all(len(look) == 12 for look in looks) and len(set.union(*looks)) == 60


def test_without_a_margin_the_held_out_cameras_measure(fox):
    sequence, _ = fox
    plan = ViewPlan.of(sequence, 24, margin=0.0)
    held_out = [c for c in sequence.cameras if c.held_out]
    assert [c.name for c in plan.measuring] == [c.name for c in held_out]
    assert not places(plan.deciding) & places(held_out)
    training = replace(sequence, cameras=[c for c in sequence.cameras if not c.held_out])
    alone = ViewPlan.of(training, 24, margin=0.0)
    assert len(places(alone.measuring)) == len(alone.region.places)  # no others: the places themselves


def test_a_region_that_is_given_is_taken(fox):
    given = region(place(0.0), source="file")
    plan = ViewPlan.of(fox[0], 24, region=given)
    assert plan.region == given and plan.trusted
    assert all(is_inside(given, view) for view in plan.measuring)


def test_a_scene_without_cameras_is_not_trusted(tmp_path):
    plan = ViewPlan.of(open_sequence(write_sequence(tmp_path, moving_frames(60, 3), cameras=False)), 24)
    assert plan.region.source == "orbit" and not plan.trusted


def test_the_specification_of_a_format_tells_up_unless_somebody_does(tmp_path):
    (tmp_path / "a.glb").write_bytes(glb_bytes(random_gaussians(40)))
    sequence = open_sequence(tmp_path / "a.glb")
    plan, told = ViewPlan.of(sequence, 8), ViewPlan.of(sequence, 8, world=world_from((0, 0, -1)))
    assert plan.world == world_from((0, 1, 0), 1.0)
    assert plan.notes[-1] == "up: (0, 1, 0); units: one is 1 m; the specification of glTF says so"
    assert up_of(told.world).tolist() == [0, 0, -1] and not any("specification" in note for note in told.notes)
    for at in told.region.places:
        assert at.up[2] <= 0, "the views that were found are upright"


def test_where_nobody_tells_up_the_guess_is_said(tmp_path):
    plan = ViewPlan.of(open_sequence(write_sequence(tmp_path, moving_frames(60, 1), cameras=False)), 8)
    assert plan.world is None and plan.notes[1].startswith("up is guessed to be (")


def test_cameras_keep_their_own_up(fox):
    sequence, plan = fox
    told = ViewPlan.of(sequence, 24, world=world_from((1, 0, 0)))
    assert told.region == plan.region and plan.world is None


def test_a_world_that_no_reader_takes_is_refused_before_the_work():
    with pytest.raises(ConfigError, match="world: expected a right-handed turn, got one that mirrors"):
        EncodeSettings(world=World([1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0], metric=False))
