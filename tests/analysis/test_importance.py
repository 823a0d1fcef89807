"""What a scene does not need, against rendering without it."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from airgs_codec.analysis import importance
from airgs_codec.analysis.importance import RowPruning, estimate_cost, pooled_error, pooled_within, select_omissions
from airgs_codec.analysis.sensitivity import measure_sensitivity, measure_views
from airgs_codec.coding.motion import channel_weights, motion_classes, motion_units, withheld_error
from tests import faces
from tests.faces import mse, open_sequence, plan_groups, render
from tests.support.paths import FOX
from tests.support.scenes import random_gaussians
from tests.support.views import measure_usage


@pytest.fixture(scope="module")
def scene():
    """The training views of the embedded scene, and the first, middle and last frame of its first group."""
    sequence = open_sequence(FOX)
    start, stop = plan_groups(sequence).spans[0]
    loaded = sequence.load(range(start, stop)).frames
    return faces.training_views(sequence.cameras), [loaded[0], loaded[len(loaded) // 2], loaded[-1]]


def test_removed_rows_cost_what_was_allowed(scene):
    cameras, frames = scene
    expected = importance.removal_errors(frames, measure_sensitivity(frames, cameras))
    rank = importance.importance(expected, measure_usage(frames, cameras))
    chosen = cameras[:: len(cameras) // 5][:6]
    pruning = RowPruning(list(zip(itertools.cycle(frames), chosen, strict=False)), rank, expected, {})
    counts = []
    for allowed in (0.0, 0.002, 0.005, 0.02):
        kept = pruning.within(allowed)
        assert kept.error <= allowed**2 and not kept.rows[rank[kept.rows] == 0].size
        counts.append(len(kept.rows))
    assert counts == sorted(counts, reverse=True) and counts[0] > counts[-1]
    pictures = [mse(render(frames[1].take(kept.rows), c).rgb, render(frames[1], c).rgb) for c in cameras]
    assert float(np.mean(pictures)) < 3 * allowed**2  # of views that were not looked at


def test_rows_that_no_ranking_picture_showed_stay_if_others_show_them(scene):
    cameras, frames = scene
    views = [(frames[0], camera) for camera in cameras[:3]]
    shown = np.flatnonzero(measure_usage([frames[0]], cameras[:3]).total > 0)
    rows = np.arange(len(frames[0]))
    lost = 1.0 - np.isin(rows, shown[::3])
    missed = RowPruning(views, lost, lost, {})  # as if those that ranked had missed them
    kept = missed.within(0.001)
    assert kept.error <= 0.001**2 and np.intersect1d(kept.rows, shown[::3]).size and missed.error_of(len(rows)) == 0
    seen = 1.0 * np.isin(rows, shown)
    assert RowPruning(views, seen, seen, {}).within(0.0).rows.tolist() == shown.tolist()


def test_a_small_thing_that_is_plainly_seen_stays_whatever_the_mean_says(scene):
    """An eye: a few rows in one place that are least important by rank, and change few pixels by much."""
    cameras, frames = scene
    g = frames[0]
    centre = g.means[np.argmax(measure_usage([g], cameras[:1]).peak)]
    eye = np.argsort(np.linalg.norm(g.means - centre, axis=1))[:12]
    rank = 1.0 - np.isin(np.arange(len(g)), eye)
    pruning = RowPruning([(g, camera) for camera in cameras[:4]], rank, rank, {})
    least = pruning.within(0.05)
    without = replace(least, rows=np.setdiff1d(least.rows, eye), error=0.0)

    def worst(rows):
        pairs = [(render(g.take(rows), c).rgb, render(g, c).rgb) for c in cameras[:4]]
        return max(float(np.abs(a - b).max()) for a, b in pairs)

    kept = pruning.with_details(without, 0.0027)
    assert np.intersect1d(kept.rows, eye).size and np.isin(without.rows, kept.rows).all()
    assert worst(kept.rows) < worst(without.rows) / 2
    assert kept.error == pytest.approx(pruning.error_of(len(g)), abs=0.05**2)
    allowed = worst(without.rows) / 37  # at which no place is plainly another, and nothing comes back
    assert pruning.with_details(without, 1.01 * allowed).rows.tolist() == without.rows.tolist()


def test_a_row_is_as_important_as_it_is_seen_and_as_its_alpha_counts():
    """Alphas of a half and of one: their squares are 0.625 in the mean. What no picture shows is of no importance."""
    g = random_gaussians(2)
    frames = [replace(g, opacity_logits=np.array([logit, 0.0], np.float32)) for logit in (0.0, 100.0)]
    usage, s = SimpleNamespace(peak=np.array([0.5, 0.0]), total=np.array([8.0, 3.0])), SimpleNamespace(opacity=4.0)
    assert importance.importance(importance.removal_errors(frames, s), usage).tolist() == [0.5 * 8.0 * 4.0 * 0.625, 0.0]


def test_the_worst_pictures_weigh_more_in_a_pooled_error_and_what_is_sure_to_be_beyond_is_drawn_no_further():
    """The first two of four suffice for the root of 0.25 / 4, 0.25."""
    assert pooled_error([2.0, 2.0, 2.0]) == pytest.approx(2.0)
    assert pooled_error([0.0, 0.0, 0.0, 4.0]) == pooled_within([0.0, 0.0, 0.0, 4.0], 4, 2.0) == pytest.approx(2.0)
    for allowed, drawn, rest in ((0.28, True, []), (0.249, False, [0.1, 0.2])):
        errors = iter([0.3, 0.4, 0.1, 0.2])
        assert (pooled_within(errors, 4, allowed) < math.inf) == drawn and list(errors) == rest


def test_where_no_line_tells_the_number_of_rows_it_is_found_to_one_per_cent(monkeypatch):
    """Nothing is lost by 436 rows of 1000, and everything by one more."""
    pruning = RowPruning([], np.ones(1000), np.ones(1000), {})
    monkeypatch.setattr(pruning, "error_of", lambda left: pruning._errors.setdefault(1000 - left, float(left < 564)))
    assert 564 <= len(pruning.within(0.5).rows) < 564 + 10 and len(pruning._errors) <= 10
    assert len(pruning.within(2.0).rows) == 1


def test_things_go_as_long_as_they_pay_most_first_and_half_of_them_where_all_is_too_dear():
    sizes, errors, none = np.full(3, 10.0), np.array([1.0, 100.0, 3.0]), np.zeros(3)

    def error(chosen, most):
        assert most == 0.5 * sizes[chosen].sum()
        return float(errors[chosen].sum())

    def chosen(guesses, error, sizes=sizes):
        return select_omissions(sizes, guesses, error, 1.0)[0].tolist()

    assert select_omissions(sizes, errors, error, 0.0) == (pytest.approx(none), 0.0)
    assert chosen(errors, error) == [True, False, True]
    assert chosen(none, error) == [True, False, False]  # guesses that are too low: fewer are left out
    assert chosen(sizes, lambda some, _: 0.0) == [False] * 3  # a guess that is no less than the price
    for price, kept in ((1e9, False), (5.0, True), (5.1, False)):  # at half of what their bytes are worth, no dearer
        assert chosen(none, lambda some, _, price=price: price * some.sum()) == [kept] * 3
    two = np.array([100.0, 10.0]), np.array([40.0, 5.0])
    first, cost = select_omissions(*two, lambda some, _: 60.0 if some.all() else 40.0, 1.0)
    assert (first.tolist(), cost) == ([True, False], 40.0) and first.dtype == bool
    alike = chosen(np.zeros(64), lambda some, _: 0.0 if some.sum() < 40 else 1e9, np.ones(64))
    assert alike == [True] * 32 + [False] * 32  # the first of equals


def test_sums_of_costs_are_those_of_all_rows():
    random = np.random.default_rng(0)
    values, centres = 3 * random.normal(size=(4, 2, 30)) + 5, np.array([5.0, -7.0])
    weights = random.uniform(size=(2, 30))
    sums = importance.CostSums.of(centres)
    for rows in (slice(0, 10), slice(10, 30)):
        sums.add(values[:, :, rows], weights[:, rows])
    sizes, errors = estimate_cost(values, centres, weights)
    np.testing.assert_array_equal(sums.costs()[0], sizes)
    np.testing.assert_allclose(sums.costs()[1], errors)
    away = (np.square(values - centres[:, None]).mean(axis=0) * weights).sum(axis=1)
    np.testing.assert_allclose(errors, away - 0.1 * weights.sum(axis=1))
    np.testing.assert_array_equal(estimate_cost(values - centres[:, None], np.zeros(2), weights)[0], sizes)


def test_bytes_are_of_first_pictures_and_of_changes_and_large_values_count_as_the_largest():
    def size(*frames):
        values = np.array(frames, float)[:, None]
        return estimate_cost(values, np.zeros(1), np.ones_like(values[0]))[0].tolist()

    assert size([0], [0]) == [0.0]  # one row is no news
    assert size([9] * 4 + [0] * 4, [0] * 8) == [2.0]  # a bit a row at first, then another that it goes back
    assert size([-9000, 9000, 0, 300] * 2) == size([-255, 255, 0, 255] * 2)
    assert size(range(8)) == [3.0]  # each of them once: three bits a row


@pytest.fixture(scope="module")
def measured():
    frame, cameras = open_sequence(FOX).load([4]).frames[0], list(open_sequence(FOX).cameras)[:4]
    return frame, cameras, measure_sensitivity([frame] * 8, cameras)


def jittered(g, name, size):
    rng = np.random.default_rng(7)
    if name == "quaternions":
        turn = faces.from_rotation_vector(rng.normal(0, size, (len(g), 3)))
        return replace(g, quaternions=faces.multiply(turn, g.quaternions.astype(np.float64)).astype(np.float32))
    if name == "opacity":
        alpha = np.clip(g.opacities() + rng.normal(0, size, len(g)), 1e-6, 1 - 1e-6)
        return replace(g, opacity_logits=np.log(alpha / (1 - alpha)).astype(np.float32))
    value = getattr(g, name)
    return replace(g, **{name: (value + rng.normal(0, size, value.shape)).astype(np.float32)})


@pytest.mark.parametrize(
    ("name", "size"),
    [("means", 3e-4), ("log_scales", 3e-2), *((n, 1e-2) for n in ("quaternions", "opacity", "sh_dc", "sh_rest"))],
)
def test_errors_of_the_size_of_a_step_make_the_error_that_was_predicted(measured, name, size):
    frame, cameras, s = measured
    worse = jittered(frame, name, size)
    rendered = np.mean([mse(render(worse, c).rgb, render(frame, c).rgb) for c in cameras])
    assert size**2 * getattr(s, name).sum() == pytest.approx(rendered, rel=0.2)


def test_the_cost_of_withholding_is_the_rendered_one(measured):
    frame, cameras, s = measured
    steps = faces.DeltaSteps(means=1e-4, quaternions=0.01, log_scales=0.02, opacity=1e-3, sh_dc=0.01, sh_rest=0.01)
    classes = motion_classes(s.means, 1e-2 * float(np.median(s.means)))
    channels = 10 + 3 * (1 + frame.sh_rest.shape[1])
    moved = np.random.default_rng(0).normal(0, 1, (1, channels, len(frame)))
    weights = channel_weights(classes, s.by_attribute(), steps, np.eye(channels - 10))
    for start, stop, name in ((0, 3, "means"), (3, 6, "log_scales"), (10, channels, "sh_dc")):
        changes = np.zeros_like(moved)
        changes[:, start:stop] = moved[:, start:stop]
        unit = motion_units(classes)[:, None] if name == "means" else 1.0
        by = {name: getattr(steps, name) * unit * changes[0, start : min(stop, start + 3)].T}
        if name == "sh_dc":
            by["sh_rest"] = steps.sh_rest * changes[0, 13:].T.reshape(frame.sh_rest.shape)
        other = replace(frame, **{n: (getattr(frame, n) + value).astype(np.float32) for n, value in by.items()})
        rendered = np.mean([mse(render(other, c).rgb, render(frame, c).rgb) for c in cameras])
        assert withheld_error(changes, weights).sum() == pytest.approx(rendered, rel=0.3), name


def test_what_is_behind_the_scene_counts(measured):
    """A black row changes nothing before black, whatever its opacity; before white it does."""
    frame, cameras, _ = measured
    one = frame.take(np.argsort(frame.opacity_logits)[-1:])
    black = replace(one, sh_rest=0 * one.sh_rest, sh_dc=np.full((1, 3), -10, np.float32))
    white = [replace(view, background=(1.0, 1.0, 1.0)) for view in cameras]
    assert measure_sensitivity([black], cameras).opacity.max() == 0 < measure_sensitivity([black], white).opacity.max()


def test_pictures_are_averaged_each_of_a_frame_and_a_camera_of_its_own(measured):
    """A row counts in the frames in which it is seen, by the camera that was paired with them."""
    frame, cameras, _ = measured
    once, twice = (measure_sensitivity(frames, cameras[:1]) for frames in ([frame], [frame, frame]))
    assert twice.sh_dc.sum() == pytest.approx(once.sh_dc.sum(), rel=0.1)
    assert replace(once).take(np.array([2, 0])).opacity.tolist() == [once.opacity[2], once.opacity[0]]
    away = replace(frame, means=frame.means + np.float32(1e5))
    seen, unseen = measure_usage([frame], cameras[:1]), measure_usage([frame], cameras[1:2])
    usage, s = measure_views([(frame, cameras[0]), (away, cameras[1])])
    np.testing.assert_array_equal(usage.hits, seen.hits)
    assert (usage.hits != unseen.hits).any()
    alone = measure_views([(frame, cameras[0])])[1]
    for name in s.__slots__:
        assert getattr(s, name).sum() == pytest.approx(getattr(alone, name).sum() / 2)
