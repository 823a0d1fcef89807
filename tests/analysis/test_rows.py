"""Sequences whose rows lost their order: matched, split where they cannot be, and said."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.grouping import closed_groups, plan_groups
from airgs_codec.analysis.rows import outlook, restore_rows
from tests.faces import Gaussians, GaussianSequence, join_rows, open_sequence
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, predicted, random_gaussians, write_sequence


def shuffled(frames, which):
    """Frames, those whose numbers are in `which` each in an order of its own."""
    return [g.take(np.random.default_rng(t).permutation(len(g))) if t in which else g for t, g in enumerate(frames)]


def noisy(frames):
    return [predicted(g, np.random.default_rng(t)) for t, g in enumerate(frames)]


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


@pytest.mark.parametrize(
    ("frames", "keyframes", "mode"),
    [
        (moving_frames(200, 4), None, "auto"),
        (moving_frames(200, 4), None, "match"),
        (moving_frames(50, 1), None, "auto"),
        (moving_frames(50, 2), None, "auto"),
        (moving_frames(90, 2) + moving_frames(120, 2), None, "auto"),
        (moving_frames(300, 2) + moving_frames(300, 2, seed=1), [0, 2], "auto"),
    ],
    ids=["tracked", "matched", "one frame", "two frames", "grown", "another scene at a keyframe"],
)
def test_where_nothing_is_lost_all_stays_as_it_is(tmp_path, frames, keyframes, mode):
    restored = restore_rows(open_sequence(write_sequence(tmp_path, frames, keyframes=keyframes)), mode)
    assert not restored.sequence.orders and restored.notes == []
    assert restored.sequence.breaks == ((2,) if len(frames[0]) < len(frames[-1]) else ())


def test_the_rows_of_the_embedded_scene_stay_as_they_are():
    assert restore_rows(open_sequence(FOX)).notes == []


def test_frames_that_nothing_joins_start_groups(tmp_path):
    frames = [*moving_frames(300, 2), *(random_gaussians(300, seed=s) for s in (7, 8)), random_gaussians(300, seed=8)]
    restored = restore_rows(open_sequence(write_sequence(tmp_path, frames)))
    assert restored.unmatched == (2, 3) and plan_groups(restored.sequence).spans == [(0, 2), (2, 3), (3, 5)]
    [note] = restored.notes
    assert note.startswith("frames 2-3: rows are not those of the frame before") and "times the bytes" in note


def test_other_counts_every_frame_are_said_and_not_matched(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, [random_gaussians(300 + i, seed=i) for i in range(3)]))
    restored = restore_rows(sequence)
    assert restored.alone == (0, 1, 2) and "another number of Gaussians" in restored.notes[0]
    [note] = restore_rows(sequence, frames=range(1, 2)).notes  # of a sequence that grows
    assert note.startswith("frame 1: each has another number of Gaussians than the frames beside it")


def thinned(frames, share=0.1):
    """Frames, each in an order of its own and without a share of its rows, and which rows are left, in that order."""
    kept = [np.random.default_rng(t).permutation(len(g))[: round((1 - share) * len(g))] for t, g in enumerate(frames)]
    return [g.take(rows) for g, rows in zip(frames, kept, strict=True)], kept


def test_rows_that_frames_lack_are_there_without_opacity(tmp_path):
    frames = moving_frames(300, 6)
    written, kept = thinned(frames)
    restored = restore_rows(open_sequence(write_sequence(tmp_path, written)))
    assert restored.unmatched == restored.alone == () and restored.missing == pytest.approx(0.1, abs=0.01)
    assert plan_groups(restored.sequence).spans == [(0, 6)]
    count, known = restored.sequence.count(0), []
    for t, rows in enumerate(kept):
        shown, order = restored.sequence.read(t), restored.sequence.orders[t]
        there = order != -1
        np.testing.assert_array_equal(np.sort(order[there]), np.arange(len(rows)))  # each row of the file once
        np.testing.assert_array_equal(shown.means[there], frames[t].means[rows[order[there]]])
        assert (shown.opacities()[~there] < 1e-8).all() and np.isfinite(shown.means).all()
        known.append(np.where(there, rows[order], -1))  # which of the 300 each Gaussian of the run is
    always = [len({*column} - {-1}) == 1 for column in np.transpose(known)]
    assert count <= 306 and np.mean(always) > 0.97  # few take the place of one that has just gone


def test_a_run_ends_where_most_of_its_gaussians_are_gone(tmp_path):
    """A third of the rows is new in every frame: what was there long ago is not held for ever."""
    rows = random_gaussians(1000)
    frames = [rows.take(slice(100 * t, 100 * t + 300 + t % 2)) for t in range(7)]
    restored = restore_rows(open_sequence(write_sequence(tmp_path, frames)))
    counts = [restored.sequence.count(t) for t in range(7)]
    assert restored.sequence.breaks and max(counts) <= 602 and restored.alone == ()
    for t, g in enumerate(frames):
        shown = restored.sequence.read(t)
        seen = shown.take(shown.opacities() > 1e-8)
        assert sorted(seen.means[:, 0]) == sorted(g.means[:, 0])


def test_a_broken_row_does_not_stand_in_for_those_that_are_missing(tmp_path):
    frames, _ = thinned(moving_frames(300, 3))
    frames[1].means[0] = np.nan
    restored = restore_rows(open_sequence(write_sequence(tmp_path, frames)))
    loaded = restored.sequence.load(range(3))
    assert len(loaded.frames[0]) == restored.sequence.count(0) and len(loaded.notes) == 1


def test_only_the_frames_that_are_asked_for_are_looked_at_and_none_where_rows_are_to_be_kept(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, shuffled(moving_frames(300, 6), {1, 4})))
    assert restore_rows(sequence, frames=range(3, 6)).matched == (4, 5)
    assert restore_rows(sequence, "keep").sequence is sequence


def test_usage_of_rows_in_another_order_is_not_taken(tmp_path, monkeypatch):
    monkeypatch.setattr("airgs_codec.scene.sequence.load_usage", lambda *_: "known")
    sequence = open_sequence(write_sequence(tmp_path, shuffled(moving_frames(300, 4), {1})))
    (tmp_path / "usage.npz").touch()
    assert sequence.usage(0, 2) == "known"
    assert restore_rows(sequence).sequence.usage(0, 2) is None


def test_rows_that_all_are_matched_are_out_of_order_only_where_they_were(tmp_path):
    """`match` finds the order that files have: nothing was put into another, and what the trainer measured counts."""
    frames = moving_frames(300, 4)
    restored = restore_rows(open_sequence(write_sequence(tmp_path, shuffled(frames, {2}))), "match")
    assert restored.matched == (2, 3) and sorted(restored.sequence.orders) == [2]
    np.testing.assert_array_equal(means(restored.sequence), [g.means for g in frames])


def test_rows_are_looked_for_where_they_would_go_on_to(tmp_path):
    """A lattice of equal rows that moves faster and faster, in the end by more than the rows are apart."""
    lattice = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), axis=-1).reshape(-1, 3)
    one = random_gaussians(1)
    looks = [getattr(one, name).repeat(len(lattice), 0) for name in one.__slots__[1:]]
    places = np.cumsum([0, *(0.3 * 1.3**t for t in range(6))])
    frames = [Gaussians(np.add(lattice, [place, 0, 0]).astype(np.float32), *looks) for place in places]
    restored = restore_rows(open_sequence(write_sequence(tmp_path, shuffled(frames, {2, 5, 6}))), "match")
    np.testing.assert_array_equal(means(restored.sequence), [g.means for g in frames])


def test_a_row_that_was_away_is_not_expected_to_go_on():
    """It is back elsewhere and rests there, and its twin, which was slow, now rests where the other would have gone."""
    still, twin, frames = random_gaussians(60), random_gaussians(1, seed=5), []
    for places in ((0, 8), (8,), (7.0,), (3, 6), (3, 6)):
        twins = [replace(twin, means=np.array([[0.1 * place, 4, 0]], np.float32)) for place in places]
        frames.append(join_rows([still, *twins]))
    frames[-1] = frames[-1].take(np.r_[0:60, 61, 60])  # they change places in the file
    found = restore_rows(GaussianSequence.from_arrays(frames, fps=24), "match").sequence
    assert found.orders[4][-2:].tolist() == [61, 60]


def test_frames_that_a_file_says_are_unlike_those_before_have_no_other_number(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, [random_gaussians(300, seed=i) for i in range(3)]))
    assert restore_rows(replace(sequence, breaks=(1, 2))).alone == ()


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (moving_frames(300, 4), ""),
        (shuffled(moving_frames(300, 4), {1}), "rows: out of order"),
        (thinned(moving_frames(300, 4), 0.03)[0], "rows: out of order"),
        (thinned(moving_frames(300, 4), 0.3)[0], "rows: of those of the first 3 frames, each lacks "),
        (noisy(moving_frames(300, 4)), "rows: of those of the first 3 frames, each lacks "),
        ([random_gaussians(300, seed=i) for i in range(4)], "rows: the first 3 frames do not share them"),
        ([random_gaussians(300 + i, seed=i) for i in range(4)], "rows: the first 3 frames do not share them"),
    ],
)
def test_the_first_frames_tell_what_rows_will_cost(tmp_path, frames, words):
    found = outlook(open_sequence(write_sequence(tmp_path, frames)))
    assert found.words.startswith(words) and bool(found.words) == bool(words)
    assert found.shared == (words in ("", "rows: out of order"))


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
