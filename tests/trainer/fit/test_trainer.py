"""The three kinds of fits: a first frame, a frame in a group, a keyframe."""

import numpy as np
import pytest

from airgs_codec.render import render
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.fit.first import fit_first
from airgs_codec.trainer.fit.losses import mean_psnr, static_shares
from airgs_codec.trainer.fit.points import scene_extent
from airgs_codec.trainer.fit.trainer import FrameBefore, FrameViews, Trainer
from airgs_codec.trainer.settings import Temporal, TrainSettings
from tests.support.views import BALL, appeared, coloured_cloud, joined, moved, ring, views_of


def trainer(**settings) -> Trainer:
    defaults = {"sh_degree": 0, "budget": 400, "capacity": 600}
    counts = {"first_iterations": 150, "key_iterations": 150, "frame_iterations": 60}
    return Trainer(TrainSettings(**(defaults | counts | settings)), scene_extent(ring()))


def test_a_first_frame_approaches_its_pictures_within_the_budget():
    truth = coloured_cloud()
    views = views_of(truth, ring(8))
    g = fit_first(trainer(), FrameViews(0, views), Points(truth.means, None))
    assert mean_psnr(g, views) > 26
    assert len(g) <= 400
    assert np.exp(g.log_scales).max() <= scene_extent(ring()) * 1.001


def test_frames_move_what_moved_and_leave_the_rest_exactly_alone():
    truth = coloured_cloud()
    after = moved(truth, slice(0, 20), (0.05, 0.0, 0.0))
    views = views_of(after, ring(8))
    t = trainer(frame_iterations=120, temporal=Temporal(weight=3e-4))
    group = t.start_group(truth, views)
    g = t.fit_frame(FrameViews(1, views), FrameBefore(truth, None), group)
    assert mean_psnr(g, views) > mean_psnr(truth, views) + 6
    rest = (g.means[20:] == truth.means[20:]).all(axis=1)
    assert rest.mean() > 0.5
    shares = static_shares(truth, g, group.steps)
    assert min(shares.values()) > 0.7


def test_without_the_temporal_loss_nearly_everything_moves():
    truth = coloured_cloud()
    views = views_of(moved(truth, slice(0, 20), (0.05, 0.0, 0.0)), ring(8))
    t = trainer(temporal=Temporal(weight=0.0))
    g = t.fit_frame(FrameViews(1, views), FrameBefore(truth, None), t.start_group(truth, views))
    assert (g.means[20:] == truth.means[20:]).all(axis=1).mean() < 0.1


def test_velocity_starts_a_frame_where_motion_leads():
    truth = coloured_cloud()
    step = np.zeros_like(truth.means)
    step[:20, 0] = 0.05
    views = views_of(moved(truth, slice(0, 20), (0.05, 0.0, 0.0)), ring(8))
    t = trainer(frame_iterations=1)
    with_velocity = t.fit_frame(FrameViews(1, views), FrameBefore(truth, step), t.start_group(truth, views))
    without = t.fit_frame(FrameViews(1, views), FrameBefore(truth, None), t.start_group(truth, views))
    assert mean_psnr(with_velocity, views) > mean_psnr(without, views) + 3


def test_a_velocity_that_leads_away_is_not_taken():
    truth = coloured_cloud()
    step = np.zeros_like(truth.means)
    step[:20, 0] = 0.1
    views = views_of(moved(truth, slice(0, 20), (-0.02, 0.0, 0.0)), ring(8))
    t = trainer(frame_iterations=10)
    group = t.start_group(truth, views)
    away = t.fit_frame(FrameViews(1, views), FrameBefore(truth, step), group)
    none = t.fit_frame(FrameViews(1, views), FrameBefore(truth, None), group)
    assert (away.means == none.means).all()


@pytest.mark.parametrize("deltas", ["mlp", "mlp+residual"])
def test_networks_learn_a_motion(deltas):
    truth = coloured_cloud()
    after = moved(truth, slice(None), (0.04, 0.0, 0.0))
    views = views_of(after, ring(8))
    t = trainer(deltas=deltas, frame_iterations=120)
    g = t.fit_frame(FrameViews(1, views), FrameBefore(truth, None), t.start_group(truth, views))
    assert mean_psnr(g, views) > mean_psnr(truth, views) + 4


def test_a_keyframe_builds_what_appeared_and_keeps_old_rows_in_place():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))
    t = trainer(max_growth=0.4)
    g = t.fit_keyframe(FrameViews(1, views), FrameBefore(old, None), t.steps(old, views))
    assert len(old) < len(g) <= round(1.4 * len(old))
    assert mean_psnr(g, views) > mean_psnr(old, views) + 10
    stayed = np.linalg.norm(g.means[: len(old)] - old.means, axis=1) < 0.1  # row n is still that Gaussian
    assert stayed.mean() > 0.9
    added = g.means[len(old) :][g.opacities()[len(old) :] > 0.1]
    assert np.median(np.linalg.norm(added - BALL, axis=1)) < 0.5


def test_a_keyframe_never_passes_the_capacity():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))
    t = trainer(budget=150, capacity=170, max_growth=0.9, key_iterations=60)
    assert len(t.fit_keyframe(FrameViews(1, views), FrameBefore(old, None), t.steps(old, views))) <= 170


def test_inflation_removes_added_gaussians():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))

    def added(weight: float) -> float:
        t = trainer(max_growth=0.4, inflation=weight, key_iterations=120)
        return float(
            t.fit_keyframe(FrameViews(1, views), FrameBefore(old, None), t.steps(old, views))
            .opacities()[len(old) :]
            .sum()
        )

    assert added(1e-1) < 0.6 * added(0.0)
    assert added(1e-6) == pytest.approx(added(0.0), rel=0.1)


def moving(before, after, cameras):
    """Pixels that two clouds show differently."""
    return [np.abs(render(before, c).rgb - render(after, c).rgb).max(axis=2) > 0.01 for c in cameras]


@pytest.mark.parametrize("key", [False, True])
def test_rows_that_rest_are_no_variables(key):
    """Bit for bit, without a temporal loss, in a frame of a group and in a keyframe; and what moves is still found."""
    before, cameras = coloured_cloud(), ring(8)
    after = joined(moved(before, slice(0, 20), (0.05, 0.0, 0.0)), appeared())
    views = views_of(after, cameras)
    t = trainer(temporal=Temporal(weight=0.0), max_growth=0.4)
    target = FrameViews(1, views, moving(before, after, cameras))
    if key:
        g = t.fit_keyframe(target, FrameBefore(before, None), t.steps(before, views))
    else:
        g = t.fit_frame(target, FrameBefore(before, None), t.start_group(before, views))
    same = np.all([getattr(g, n)[:150].reshape(150, -1) == getattr(before, n).reshape(150, -1) for n in ("means",)], 0)
    assert same.all(axis=1)[20:].mean() > 0.4 and not same.all(axis=1)[:20].all()
    assert mean_psnr(g, views) > mean_psnr(before, views) + (8 if key else 1)


def test_a_keyframe_adds_nothing_where_pictures_rest():
    """Nothing is drawn there, so nothing could be fitted: what the first frame missed, and specks in a corner."""
    g, cameras = coloured_cloud(), ring(8)
    views = views_of(joined(g, appeared()), cameras)
    specks = np.zeros((48, 48), bool)
    specks[:3, :3] = True
    t = trainer(max_growth=0.4, inflation=0.0, key_iterations=60)
    fitted = t.fit_keyframe(FrameViews(1, views, [specks] * 8), FrameBefore(g, None), t.steps(g, views))
    assert len(fitted) == len(g)


def test_a_frame_where_nothing_moves_is_the_frame_before():
    g, cameras = coloured_cloud(), ring(8)
    views = views_of(g, cameras)
    t = trainer()
    nothing = [np.zeros((48, 48), bool)] * 8
    assert t.fit_frame(FrameViews(1, views, nothing), FrameBefore(g, None), t.start_group(g, views)) is g


def test_a_fit_that_shows_less_than_the_frame_before_is_not_taken():
    truth = coloured_cloud()
    views = views_of(moved(truth, slice(0, 20), (1e-6, 0.0, 0.0)), ring(8))  # less than 8 bits show
    free = {"frame_iterations": 10, "temporal": Temporal(weight=0.0)}
    for keep_better in (True, False):
        t = trainer(**free, keep_better=keep_better)
        g = t.fit_frame(FrameViews(1, views), FrameBefore(truth, None), t.start_group(truth, views))
        assert (g is truth) == keep_better
    assert mean_psnr(g, views) < mean_psnr(truth, views) - 3
