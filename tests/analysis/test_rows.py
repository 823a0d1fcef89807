"""Rows that a writer put into another order are found again; where they cannot be, groups begin, and it is said."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from airgs_codec.analysis import matching
from airgs_codec.analysis.matching import compare_order, match_rows
from tests import faces
from tests.faces import Gaussians, GaussianSequence, closed_groups, join_rows, open_sequence, plan_groups, restore_rows
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, predicted, random_gaussians, write_sequence


def shuffled(frames, which):
    """Frames, those whose numbers are in `which` each in an order of its own."""
    return [g.take(np.random.default_rng(t).permutation(len(g))) if t in which else g for t, g in enumerate(frames)]


def thinned(frames, share=0.1):
    """Frames, each in an order of its own and without a share of its rows, and which rows are left, in that order."""
    kept = [np.random.default_rng(t).permutation(len(g))[: round((1 - share) * len(g))] for t, g in enumerate(frames)]
    return [g.take(rows) for g, rows in zip(frames, kept, strict=True)], kept


def in_memory(frames, **changes):
    return replace(GaussianSequence.from_arrays(frames, fps=24), **changes)


def lattice():
    """Equal rows that move faster and faster, in the end by more than they are apart."""
    places = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), axis=-1).reshape(-1, 3)
    one = random_gaussians(1)
    looks = [getattr(one, name).repeat(len(places), 0) for name in one.__slots__[1:]]
    moves = np.cumsum([0, *(0.3 * 1.3**t for t in range(6))])
    return [Gaussians(np.add(places, [move, 0, 0]).astype(np.float32), *looks) for move in moves]


LACKS = "rows: of those of the first 3 frames, each lacks "
MOVING, LATTICE = moving_frames(300, 6), lattice()
TURNED = [*MOVING[:3], *(g.take(np.random.default_rng(0).permutation(300)) for g in MOVING[3:])]


@pytest.mark.parametrize(("frames", "given", "mode", "matched", "orders"), [
    (MOVING[:5], shuffled(MOVING[:5], {1, 2, 4}), "auto", (1, 2, 3, 4), [1, 2, 4]),
    (MOVING, TURNED, "auto", (3,), [3, 4, 5]),  # an order that stays is matched once
    (MOVING[:4], shuffled(MOVING[:4], {2}), "match", (2, 3), [2]),  # nothing was put into another order than it had
    (LATTICE, shuffled(LATTICE, {2, 5, 6}), "match", (2, 3, 5, 6), [2, 5, 6]),  # they are where they would go on to
], ids=["shuffled", "turned", "match", "lattice"])  # fmt: skip
def test_rows_come_back_in_the_order_of_the_first_frame_and_it_is_said_how_surely(frames, given, mode, matched, orders):
    restored = restore_rows(in_memory(given), mode)
    sequence = restored.sequence
    np.testing.assert_array_equal([sequence.read(t).means for t in range(len(sequence))], [g.means for g in frames])
    assert (restored.matched, sorted(sequence.orders), restored.unmatched) == (matched, orders, ())
    if matched == (1, 2, 3, 4):
        assert restored.sure == 1.0 and plan_groups(sequence).spans == [(0, 5)]
        assert restored.notes == ["frames 1-4: rows were out of order; matched again, 100.0% of them with confidence"]


@pytest.mark.parametrize(
    ("sequence", "mode", "breaks"),
    [
        (in_memory(MOVING[:4]), "auto", ()),
        (in_memory(MOVING[:4]), "match", ()),
        (in_memory(MOVING[:1]), "auto", ()),
        (in_memory(MOVING[:2]), "auto", ()),
        (in_memory(moving_frames(90, 2) + moving_frames(120, 2)), "auto", (2,)),
        (in_memory(MOVING[:2] + moving_frames(300, 2, seed=1), keyframes=(0, 2)), "auto", ()),
        (open_sequence(FOX), "auto", ()),
    ],
    ids=["tracked", "matched", "one frame", "two frames", "grown", "another scene at a keyframe", "embedded"],
)
def test_where_nothing_is_lost_all_stays_as_it_is(sequence, mode, breaks):
    found = restore_rows(sequence, mode)
    assert (found.notes, found.sequence.breaks, bool(found.sequence.orders)) == ([], breaks, False)


def test_frames_that_nothing_joins_start_groups_and_other_counts_every_frame_are_said_and_not_matched():
    frames = [*MOVING[:2], *(random_gaussians(300, seed=s) for s in (7, 8)), random_gaussians(300, seed=8)]
    restored = restore_rows(in_memory(frames))
    assert restored.unmatched == (2, 3) and plan_groups(restored.sequence).spans == [(0, 2), (2, 3), (3, 5)]
    [note] = restored.notes
    assert note.startswith("frames 2-3: rows are not those of the frame before") and "times the bytes" in note
    sequence = in_memory([random_gaussians(300 + i, seed=i) for i in range(3)])
    restored = restore_rows(sequence)
    assert restored.alone == (0, 1, 2) and "another number of Gaussians" in restored.notes[0]
    [note] = restore_rows(sequence, frames=range(1, 2)).notes  # of a sequence that grows
    assert note.startswith("frame 1: each has another number of Gaussians than the frames beside it")
    told = in_memory([random_gaussians(300, seed=i) for i in range(3)], breaks=(1, 2))
    assert restore_rows(told).alone == ()  # a file says that they are unlike those before


def test_rows_that_frames_lack_are_there_without_opacity():
    written, kept = thinned(MOVING)
    restored = restore_rows(in_memory(written))
    assert restored.unmatched == restored.alone == () and restored.missing == pytest.approx(0.1, abs=0.01)
    assert plan_groups(restored.sequence).spans == [(0, 6)]
    count, known = restored.sequence.count(0), []
    for t, rows in enumerate(kept):
        shown, order = restored.sequence.read(t), restored.sequence.orders[t]
        there = order != -1
        np.testing.assert_array_equal(np.sort(order[there]), np.arange(len(rows)))  # each row of the file once
        np.testing.assert_array_equal(shown.means[there], MOVING[t].means[rows[order[there]]])
        assert (shown.opacities()[~there] < 1e-8).all() and np.isfinite(shown.means).all()
        known.append(np.where(there, rows[order], -1))  # which of the 300 each Gaussian of the run is
    always = [len({*column} - {-1}) == 1 for column in np.transpose(known)]
    assert count <= 306 and np.mean(always) > 0.97  # few take the place of one that has just gone


def test_a_run_ends_where_most_of_its_gaussians_are_gone():
    """A third of the rows is new in every frame: what was there long ago is not held for ever."""
    rows = random_gaussians(1000)
    frames = [rows.take(slice(100 * t, 100 * t + 300 + t % 2)) for t in range(7)]
    restored = restore_rows(in_memory(frames))
    assert restored.sequence.breaks and restored.alone == ()
    for t, g in enumerate(frames):
        shown = restored.sequence.read(t)
        assert len(shown) == restored.sequence.count(t) <= 602
        assert sorted(shown.means[shown.opacities() > 1e-8, 0]) == sorted(g.means[:, 0])


def test_a_broken_row_does_not_stand_in_for_those_that_are_missing(tmp_path):
    frames, _ = thinned(MOVING[:3])
    frames[1].means[0] = np.nan
    restored = restore_rows(open_sequence(write_sequence(tmp_path, frames)))
    loaded = restored.sequence.load(range(3))
    assert len(loaded.frames[0]) == restored.sequence.count(0) and len(loaded.notes) == 1


def test_only_the_frames_asked_for_are_looked_at_and_usage_of_rows_in_another_order_is_not_taken(tmp_path, monkeypatch):
    monkeypatch.setattr("airgs_codec.scene.beside.load_usage", lambda *_: "known")
    sequence = open_sequence(write_sequence(tmp_path, shuffled(MOVING, {1, 4})))
    assert restore_rows(sequence, frames=range(3, 6)).matched == (4, 5)
    assert restore_rows(sequence, "keep").sequence is sequence
    (tmp_path / "usage.npz").touch()
    assert sequence.usage(0, 2) == "known"
    assert restore_rows(sequence).sequence.usage(0, 2) is None


def test_a_row_that_was_away_is_not_expected_to_go_on():
    """It is back elsewhere and rests there, and its twin, which was slow, now rests where the other would have gone."""
    still, twin, frames = random_gaussians(60), random_gaussians(1, seed=5), []
    for places in ((0, 8), (8,), (7.0,), (3, 6), (3, 6)):
        twins = [replace(twin, means=np.array([[0.1 * place, 4, 0]], np.float32)) for place in places]
        frames.append(join_rows([still, *twins]))
    frames[-1] = frames[-1].take(np.r_[0:60, 61, 60])  # they change places in the file
    found = restore_rows(GaussianSequence.from_arrays(frames, fps=24), "match").sequence
    assert found.orders[4][-2:].tolist() == [61, 60]


@pytest.mark.parametrize(("frames", "words", "shared"), [
    (MOVING[:4], "", True),
    (shuffled(MOVING[:4], {1}), "rows: out of order", True),
    (thinned(MOVING[:4], 0.03)[0], "rows: out of order", True),
    (thinned(MOVING[:4], 0.3)[0], LACKS, False),
    ([predicted(g, np.random.default_rng(t)) for t, g in enumerate(MOVING[:4])], LACKS, False),
    ([random_gaussians(300, seed=i) for i in range(4)], "rows: the first 3 frames do not share them", False),
    ([random_gaussians(300 + i, seed=i) for i in range(4)], "rows: the first 3 frames do not share them", False),
])  # fmt: skip
def test_the_first_frames_tell_what_rows_will_cost(frames, words, shared):
    found, said = faces.first_look(in_memory(frames))
    assert said.startswith(words) and (bool(said), found) == (bool(words), shared)


NINE = moving_frames(9, 33)
GROWN = in_memory(NINE[:8] + moving_frames(12, 2))


@pytest.mark.parametrize(("sequence", "most", "spans", "note"), [
    (in_memory(NINE + moving_frames(12, 4)), (), [(0, 16), (16, 33), (33, 37)], ""),  # cut evenly
    (in_memory(NINE[:2] + moving_frames(12, 2), keyframes=(0,)), (), [(0, 2), (2, 4)], "frame 2"),  # in a group
    (in_memory(NINE[:7], breaks=(2,)), (3,), [(0, 2), (2, 4), (4, 7)], ""),  # rows are those of other things
    (in_memory(NINE[:7], breaks=(2,), keyframes=(0, 4)), (), [(0, 2), (2, 4), (4, 7)], ""),
    (GROWN, (3,), [(0, 2), (2, 5), (5, 8), (8, 10)], ""),
    (open_sequence(FOX), (), [(0, 5), (5, 10)], ""),  # its keyframes
])  # fmt: skip
def test_groups_start_at_keyframes_and_where_rows_change_and_long_runs_are_cut(sequence, most, spans, note):
    grouping = plan_groups(sequence, *most)
    assert grouping.spans == spans and [note in line for line in grouping.notes] == [True] * bool(note)


@pytest.mark.parametrize(("sequence", "start", "done", "spans"), [
    (GROWN, 0, False, [(0, 3), (3, 6), (6, 9)]),  # whether rows match is seen later
    (GROWN, 6, True, [(6, 9), (9, 10)]),
    (in_memory(NINE[:8], keyframes=(0, 5)), 0, False, [(0, 5)]),
    (in_memory(NINE[:8], keyframes=(0, 5)), 5, True, [(5, 8)]),
])  # fmt: skip
def test_groups_of_a_growing_sequence_close_when_no_frame_can_join_them(sequence, start, done, spans):
    assert closed_groups(sequence, start, 3, done=done) == spans


FOX_FRAMES = [faces.read_ply(path) for path in sorted(FOX.glob("*.ply"))]  # five a group


def in_disorder(g, seed=0):
    order = np.random.default_rng(seed).permutation(len(g))
    return g.take(order), np.argsort(order)


def going_on(before, last):
    """The last frame, moved on as it moved from the one before."""
    return replace(last, means=2 * last.means - before.means)


def alike(g):
    return Gaussians(g.means, *(getattr(g, name)[:1].repeat(len(g), 0) for name in g.__slots__[1:]))


def test_rows_that_all_look_alike_are_found_where_they_were_going_and_so_are_a_few():
    """They move by many times what is between them, so that where they were is no help."""
    before = alike(random_gaussians(300))
    speed = np.random.default_rng(1).normal(size=(300, 3)).astype(np.float32)
    last, now = (replace(before, means=before.means + t * speed) for t in (1, 2))
    other, where = in_disorder(now)
    np.testing.assert_array_equal(match_rows(going_on(before, last), other)[0], where)
    assert (match_rows(last, other)[0] == where).mean() < 0.5
    for few in (random_gaussians(1), random_gaussians(2)):
        assert match_rows(few, few.take(slice(None, None, -1)))[0].tolist() == [*range(len(few))][::-1]


@pytest.mark.parametrize("start", [0, 5])
def test_rows_of_a_trained_sequence_are_found_frame_after_frame_and_left_alone_where_they_are_tracked(start):
    """Tracked ones up to four frames apart: as fast as an animal that runs."""
    for a, b in combinations(FOX_FRAMES[start : start + 5], 2):
        assert compare_order(a, b) == matching.IN_ORDER
    last, before = FOX_FRAMES[start], None
    for number in range(start + 1, start + 5):
        other, where = in_disorder(FOX_FRAMES[number], number)
        order, sure = match_rows(last if before is None else going_on(before, last), other)
        assert (order == where).mean() > 0.999 and sure > 0.99
        assert compare_order(FOX_FRAMES[number - 1], other) == matching.LOST
        before, last = last, other.take(order)


G, ALIKE = random_gaussians(400), alike(random_gaussians(400))
ELSEWHERE = (G.means + np.random.default_rng(0).normal(size=(400, 3))).astype(np.float32)


@pytest.mark.parametrize(("a", "b", "state"), [
    (G, replace(G, means=ELSEWHERE), matching.IN_ORDER),  # they swap places: their looks tell them apart
    (G, replace(G, opacity_logits=-G.opacity_logits), matching.IN_ORDER),
    (ALIKE, replace(ALIKE, means=ALIKE.means + np.float32(3)), matching.IN_ORDER),
    (G, replace(G, means=np.zeros_like(G.means)), matching.IN_ORDER),
    (G.take(slice(0, 7)), in_disorder(G.take(slice(0, 7)))[0], matching.IN_ORDER),  # too few to tell
    (random_gaussians(500, seed=1), random_gaussians(500, seed=2), matching.UNRELATED),
], ids=["fast", "blinking", "alike", "at one place", "few", "unrelated"])  # fmt: skip
def test_fast_blinking_and_equal_rows_are_not_taken_for_lost_nor_other_scenes(a, b, state):
    assert compare_order(a, b) == state and (state == matching.IN_ORDER or match_rows(a, b)[1] < 0.2)


def test_a_neighbour_in_place_of_every_row_is_lost_order():
    """A writer that sorts rows by place shifts them only a little when some of them move."""
    g = FOX_FRAMES[0]
    line = np.argsort(g.means[:, 0], kind="stable")
    a, b = g.take(line), g.take(np.roll(line, 1))
    assert compare_order(a, b) == matching.LOST
    np.testing.assert_array_equal(match_rows(a, b)[0], np.roll(np.arange(len(g)), -1))


def test_broken_and_equal_rows_are_each_given_one_row_and_are_told_apart(monkeypatch):
    """Dead rows at one place would make a tree a list; NaN has no place in one."""
    count, searched = 20_000, []
    g = random_gaussians(count)
    columns = [getattr(g, name).copy() for name in g.__slots__]
    for column in columns:
        column[: count // 2] = column[0]
    columns[0][-3:], columns[3][-5:], columns[2][-7] = np.nan, -np.inf, 1e38
    dead = Gaussians(*columns)
    monkeypatch.setattr(matching, "cKDTree", lambda points: searched.append(points) or cKDTree(points))
    order, _ = match_rows(dead, in_disorder(dead)[0])
    assert searched and all(np.isfinite(points).all() for points in searched)
    assert all(len(np.unique(points, axis=0)) == len(points) for points in searched if points.shape[1] > 3)
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
