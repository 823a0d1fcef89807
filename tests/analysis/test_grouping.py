"""Groups: given keyframes, changed counts, rows that go on nowhere."""

from dataclasses import replace

from airgs_codec.analysis.grouping import closed_groups, plan_groups
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence


def test_keyframes_of_the_embedded_scene_start_its_groups():
    assert plan_groups(open_sequence(FOX)).spans == [(0, 5), (5, 10)]


def test_groups_start_where_the_count_changes_and_long_runs_are_cut_evenly(tmp_path):
    frames = moving_frames(9, 33) + moving_frames(12, 4)
    assert plan_groups(open_sequence(write_sequence(tmp_path, frames))).spans == [(0, 16), (16, 33), (33, 37)]


def test_a_count_that_changes_inside_a_given_group_is_noted(tmp_path):
    frames = moving_frames(9, 2) + moving_frames(12, 2)
    grouping = plan_groups(open_sequence(write_sequence(tmp_path, frames, keyframes=[0])))
    assert grouping.spans == [(0, 2), (2, 4)]
    assert "frame 2" in grouping.notes[0]


def test_groups_start_where_rows_are_not_those_of_the_frame_before(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, moving_frames(9, 7)))
    assert plan_groups(replace(sequence, breaks=(2,)), 3).spans == [(0, 2), (2, 4), (4, 7)]
    assert plan_groups(replace(sequence, breaks=(2,), keyframes=(0, 4))).spans == [(0, 2), (2, 4), (4, 7)]


def test_groups_of_a_growing_sequence_close_when_no_frame_can_join_them(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path / "a", moving_frames(9, 8) + moving_frames(12, 2)))
    assert plan_groups(sequence, 3).spans == [(0, 2), (2, 5), (5, 8), (8, 10)]
    assert closed_groups(sequence, 0, 3, done=False) == [(0, 3), (3, 6), (6, 9)]  # whether rows match is seen later
    assert closed_groups(sequence, 6, 3, done=True) == [(6, 9), (9, 10)]
    named = open_sequence(write_sequence(tmp_path / "b", moving_frames(9, 8), keyframes=[0, 5]))
    assert closed_groups(named, 0, 3, done=False) == [(0, 5)]
    assert closed_groups(named, 5, 3, done=True) == [(5, 8)]
