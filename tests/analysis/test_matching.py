"""Rows that a writer put into another order are found again; those that are where they were stay there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from airgs_codec.analysis import matching
from airgs_codec.analysis.matching import IN_ORDER, LOST, UNRELATED, compare_order, match_rows
from tests.faces import Gaussians, read_ply
from tests.support.paths import FOX
from tests.support.scenes import random_gaussians

FOX_FRAMES = [read_ply(path) for path in sorted(FOX.glob("*.ply"))]  # five a group


def shuffled(g, seed=0):
    """The rows in another order, and where each row went."""
    order = np.random.default_rng(seed).permutation(len(g))
    return g.take(order), np.argsort(order)


def going_on(before, last):
    """The last frame, moved on as it moved from the one before."""
    return replace(last, means=2 * last.means - before.means)


def test_rows_that_all_look_alike_are_found_where_they_were_going():
    """They move by many times what is between them, so that where they were is no help."""
    g = random_gaussians(300)
    looks = [getattr(g, name)[:1].repeat(300, 0) for name in g.__slots__[1:]]
    speed = np.random.default_rng(1).normal(size=(300, 3)).astype(np.float32)
    before, last, now = (Gaussians(g.means + t * speed, *looks) for t in range(3))
    other, where = shuffled(now)
    np.testing.assert_array_equal(match_rows(going_on(before, last), other).order, where)
    assert (match_rows(last, other).order == where).mean() < 0.5


@pytest.mark.parametrize("start", [0, 5])
def test_rows_of_a_trained_sequence_are_found_frame_after_frame(start):
    last, before = FOX_FRAMES[start], None
    for number in range(start + 1, start + 5):
        other, where = shuffled(FOX_FRAMES[number], number)
        matched = match_rows(last if before is None else going_on(before, last), other)
        assert (matched.order == where).mean() > 0.999 and matched.sure > 0.99
        assert compare_order(FOX_FRAMES[number - 1], other)[0] == LOST
        before, last = last, other.take(matched.order)


def test_tracked_rows_are_left_alone():
    for start in (0, 5):
        for a in range(start, start + 5):  # up to four frames apart: as fast as an animal that runs
            for b in range(a + 1, start + 5):
                assert compare_order(FOX_FRAMES[a], FOX_FRAMES[b])[0] == IN_ORDER


def test_fast_blinking_and_equal_rows_are_not_taken_for_lost():
    g = random_gaussians(400)
    moved = replace(g, means=g.means + np.random.default_rng(0).normal(size=(400, 3)).astype(np.float32))
    assert compare_order(g, moved)[0] == IN_ORDER  # rows that swap places: their looks tell them apart
    assert compare_order(g, replace(g, opacity_logits=-g.opacity_logits))[0] == IN_ORDER
    alike = Gaussians(g.means, *(getattr(g, name)[:1].repeat(400, 0) for name in g.__slots__[1:]))
    assert compare_order(alike, replace(alike, means=alike.means + np.float32(3)))[0] == IN_ORDER
    assert compare_order(g, replace(g, means=np.zeros_like(g.means)))[0] == IN_ORDER
    assert compare_order(*(g.take(slice(0, 7)), shuffled(g.take(slice(0, 7)))[0]))[0] == IN_ORDER  # too few to tell


def test_a_neighbour_in_place_of_every_row_is_lost_order():
    """A writer that sorts rows by place shifts them only a little when some of them move."""
    g = FOX_FRAMES[0]
    line = np.argsort(g.means[:, 0], kind="stable")
    a, b = g.take(line), g.take(np.roll(line, 1))
    assert compare_order(a, b)[0] == LOST
    np.testing.assert_array_equal(match_rows(a, b).order, np.roll(np.arange(len(g)), -1))


def test_frames_of_other_scenes_are_unrelated():
    state, sure = compare_order(random_gaussians(500, seed=1), random_gaussians(500, seed=2))
    assert state == UNRELATED and sure < 0.2


def test_broken_and_equal_rows_are_each_given_one_row_and_are_told_apart(monkeypatch):
    """Dead rows at one place would make a tree a list; NaN has no place in one."""
    count = 20_000
    g = random_gaussians(count)
    columns = [getattr(g, name).copy() for name in g.__slots__]
    for column in columns:
        column[: count // 2] = column[0]
    columns[0][-3:] = np.nan
    columns[3][-5:] = -np.inf
    columns[2][-7] = 1e38
    dead = Gaussians(*columns)
    searched = []
    monkeypatch.setattr(matching, "cKDTree", lambda points: searched.append(points) or cKDTree(points))
    matched = match_rows(dead, shuffled(dead)[0])
    assert searched
    assert all(np.isfinite(points).all() for points in searched)
    assert all(len(np.unique(points, axis=0)) == len(points) for points in searched if points.shape[1] > 3)
    np.testing.assert_array_equal(np.sort(matched.order), np.arange(count))


@pytest.mark.parametrize("count", [1, 2])
def test_a_few_rows_can_be_matched(count):
    g = random_gaussians(count)
    np.testing.assert_array_equal(match_rows(g, g.take(slice(None, None, -1))).order, np.arange(count)[::-1])
