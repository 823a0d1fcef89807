"""Sequences whose rows lost their order: matched, split where they cannot be, and said."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.rows import plan_groups, restore_rows
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, random_gaussians, write_sequence


def shuffled(frames, which):
    """Frames, those whose numbers are in `which` each in an order of its own."""
    return [g.take(np.random.default_rng(t).permutation(len(g))) if t in which else g for t, g in enumerate(frames)]


def means(sequence):
    return [sequence.read(frame).means for frame in range(len(sequence))]


def test_shuffled_frames_come_back_in_the_order_of_the_first(tmp_path):
    frames = moving_frames(300, 5)
    sequence = open_sequence(write_sequence(tmp_path, shuffled(frames, {1, 2, 4})))
    restored = restore_rows(sequence)
    np.testing.assert_array_equal(means(restored.sequence), [g.means for g in frames])
    assert restored.matched == (1, 2, 3, 4) and restored.unmatched == () and restored.sure == 1.0
    assert restored.notes == ["frames 1-4: rows were out of order; matched again, 100.0% of them with confidence"]
    assert plan_groups(restored.sequence).spans == [(0, 5)]


def test_frames_that_keep_a_new_order_are_matched_once(tmp_path):
    frames = moving_frames(300, 6)
    order = np.random.default_rng(0).permutation(300)
    sequence = open_sequence(write_sequence(tmp_path, [*frames[:3], *(g.take(order) for g in frames[3:])]))
    restored = restore_rows(sequence)
    assert restored.matched == (3,) and sorted(restored.sequence.orders) == [3, 4, 5]
    np.testing.assert_array_equal(means(restored.sequence), [g.means for g in frames])


def test_tracked_sequences_stay_as_they_are(tmp_path):
    for folder in (FOX, write_sequence(tmp_path, moving_frames(200, 4))):
        restored = restore_rows(open_sequence(folder))
        assert not restored.sequence.orders and restored.sequence.breaks == () and restored.notes == []


def test_frames_that_nothing_joins_start_groups(tmp_path):
    frames = [*moving_frames(300, 2), *(random_gaussians(300, seed=s) for s in (7, 8)), random_gaussians(300, seed=8)]
    restored = restore_rows(open_sequence(write_sequence(tmp_path, frames)))
    assert restored.unmatched == (2, 3) and plan_groups(restored.sequence).spans == [(0, 2), (2, 3), (3, 5)]
    [note] = restored.notes
    assert note.startswith("frames 2-3: rows are not those of the frame before") and "times the bytes" in note


def test_other_counts_every_frame_are_said_and_not_matched(tmp_path):
    frames = [random_gaussians(300 + i, seed=i) for i in range(3)]
    restored = restore_rows(open_sequence(write_sequence(tmp_path / "a", frames)))
    assert restored.alone == (0, 1, 2) and "another number of Gaussians" in restored.notes[0]
    grown = moving_frames(90, 2) + moving_frames(120, 2)
    assert restore_rows(open_sequence(write_sequence(tmp_path / "b", grown))).notes == []


def test_nothing_is_matched_across_a_keyframe(tmp_path):
    frames = moving_frames(300, 2) + moving_frames(300, 2, seed=1)
    restored = restore_rows(open_sequence(write_sequence(tmp_path, frames, keyframes=[0, 2])))
    assert restored.notes == [] and restored.sequence.breaks == ()


def test_rows_are_kept_or_matched_on_demand(tmp_path):
    frames = moving_frames(300, 3)
    lost = open_sequence(write_sequence(tmp_path / "a", shuffled(frames, {1})))
    assert restore_rows(lost, "keep").sequence is lost


def test_only_the_frames_that_are_asked_for_are_looked_at(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, shuffled(moving_frames(300, 6), {1, 4})))
    assert restore_rows(sequence, frames=range(3, 6)).matched == (4, 5)


def test_usage_of_rows_in_another_order_is_not_taken(tmp_path, monkeypatch):
    monkeypatch.setattr("airgs_codec.scene.sequence.load_usage", lambda path, start, stop: "known")
    sequence = open_sequence(write_sequence(tmp_path, shuffled(moving_frames(300, 4), {1})))
    (tmp_path / "usage.npz").touch()
    assert sequence.usage(0, 2) == "known"
    assert restore_rows(sequence).sequence.usage(0, 2) is None


@pytest.mark.parametrize("frames", [1, 2])
def test_short_sequences_have_nothing_to_restore(tmp_path, frames):
    assert restore_rows(open_sequence(write_sequence(tmp_path, moving_frames(50, frames)))).notes == []


def test_rows_that_all_are_matched_are_out_of_order_only_where_they_were(tmp_path):
    """`match` finds the order that files have: nothing was put into another, and what the trainer measured counts."""
    frames = moving_frames(300, 4)
    restored = restore_rows(open_sequence(write_sequence(tmp_path, shuffled(frames, {2}))), "match")
    assert restored.matched == (2, 3) and sorted(restored.sequence.orders) == [2]
    np.testing.assert_array_equal(means(restored.sequence), [g.means for g in frames])
    ordered = restore_rows(open_sequence(write_sequence(tmp_path / "ordered", frames)), "match")
    assert ordered.notes == [] and not ordered.sequence.orders


def test_rows_are_looked_for_where_they_would_go_on_to(tmp_path):
    """A lattice of equal rows that moves faster and faster, in the end by more than the rows are apart."""
    lattice = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), axis=-1).reshape(-1, 3)
    one = random_gaussians(1)
    looks = [getattr(one, name).repeat(len(lattice), 0) for name in one.__slots__[1:]]
    places = np.cumsum([0, *(0.3 * 1.3**t for t in range(6))])
    frames = [Gaussians(np.add(lattice, [place, 0, 0]).astype(np.float32), *looks) for place in places]
    restored = restore_rows(open_sequence(write_sequence(tmp_path, shuffled(frames, {2, 5, 6}))), "match")
    np.testing.assert_array_equal(means(restored.sequence), [g.means for g in frames])


def test_frames_of_a_growing_sequence_that_are_alone_are_said_one_by_one(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, [random_gaussians(300 + i, seed=i) for i in range(3)]))
    [note] = restore_rows(sequence, frames=range(1, 2)).notes
    assert note.startswith("frame 1: each has another number of Gaussians than the frames beside it")


def test_frames_that_a_file_says_are_unlike_those_before_have_no_other_number(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, [random_gaussians(300, seed=i) for i in range(3)]))
    assert restore_rows(replace(sequence, breaks=(1, 2))).alone == ()
