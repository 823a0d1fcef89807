"""The three kinds of fits: a first frame, a frame in a group, a keyframe."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.render import render
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.fit.first import fit_first
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.parameters import InMotion
from airgs_codec.trainer.fit.points import scene_extent
from airgs_codec.trainer.fit.trainer import FrameViews, Trainer
from airgs_codec.trainer.settings import Temporal, TrainSettings
from tests.support.views import BALL, appeared, coloured_cloud, joined, moved, ring, views_of


def trainer(**settings) -> Trainer:
    defaults = {"sh_degree": 0, "budget": 400, "capacity": 600}
    counts = {"first_iterations": 150, "key_iterations": 150, "frame_iterations": 60}
    return Trainer(TrainSettings(**(defaults | counts | settings)), scene_extent(ring()))


def test_a_first_frame_approaches_its_pictures_within_the_budget():
    truth = coloured_cloud()
    views = views_of(truth, ring(8))
    g = fit_first(trainer(), FrameViews(0, views), Points(truth.means, None)).gaussians
    assert mean_psnr(g, views) > 26
    assert len(g) <= 400
    assert np.exp(g.log_scales).max() <= scene_extent(ring()) * 1.001


def test_frames_move_what_moved_and_leave_the_rest_exactly_alone():
    truth = coloured_cloud()
    after = moved(truth, slice(0, 20), (0.05, 0.0, 0.0))
    views = views_of(after, ring(8))
    t = trainer(frame_iterations=120, temporal=Temporal(weight=3e-4))
    group = t.start_group(truth, views)
    g = t.fit_frame(FrameViews(1, views), InMotion(truth), group)
    assert mean_psnr(g, views) > mean_psnr(truth, views) + 6
    rest = (g.means[20:] == truth.means[20:]).all(axis=1)
    assert rest.mean() > 0.5
    assert all((getattr(g, name) == getattr(truth, name))[20:].mean() > 0.5 for name in ("sh_dc", "opacity_logits"))


def test_without_the_temporal_loss_nearly_everything_moves():
    truth = coloured_cloud()
    views = views_of(moved(truth, slice(0, 20), (0.05, 0.0, 0.0)), ring(8))
    t = trainer(temporal=Temporal(weight=0.0))
    g = t.fit_frame(FrameViews(1, views), InMotion(truth), t.start_group(truth, views))
    assert (g.means[20:] == truth.means[20:]).all(axis=1).mean() < 0.1


def test_velocity_starts_a_frame_where_motion_leads():
    truth = coloured_cloud()
    step = np.zeros_like(truth.means)
    step[:20, 0] = 0.05
    views = views_of(moved(truth, slice(0, 20), (0.05, 0.0, 0.0)), ring(8))
    t = trainer(frame_iterations=1)
    with_velocity = t.fit_frame(FrameViews(1, views), InMotion(truth, step), t.start_group(truth, views))
    without = t.fit_frame(FrameViews(1, views), InMotion(truth), t.start_group(truth, views))
    assert mean_psnr(with_velocity, views) > mean_psnr(without, views) + 3


def test_a_velocity_that_leads_away_is_not_taken():
    truth = coloured_cloud()
    step = np.zeros_like(truth.means)
    step[:20, 0] = 0.1
    views = views_of(moved(truth, slice(0, 20), (-0.02, 0.0, 0.0)), ring(8))
    t = trainer(frame_iterations=10)
    group = t.start_group(truth, views)
    away = t.fit_frame(FrameViews(1, views), InMotion(truth, step), group)
    none = t.fit_frame(FrameViews(1, views), InMotion(truth), group)
    assert (away.means == none.means).all()


@pytest.mark.parametrize("deltas", ["mlp", "mlp+residual"])
def test_networks_learn_a_motion(deltas):
    truth = coloured_cloud()
    after = moved(truth, slice(None), (0.04, 0.0, 0.0))
    views = views_of(after, ring(8))
    t = trainer(deltas=deltas, frame_iterations=120)
    g = t.fit_frame(FrameViews(1, views), InMotion(truth), t.start_group(truth, views))
    assert mean_psnr(g, views) > mean_psnr(truth, views) + 4


def test_a_keyframe_builds_what_appeared_and_keeps_old_rows_in_place():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))
    t = trainer(max_growth=0.4)
    g = t.fit_keyframe(FrameViews(1, views), InMotion(old), t.steps(old, views)).gaussians
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
    g = t.fit_keyframe(FrameViews(1, views), InMotion(old), t.steps(old, views)).gaussians
    assert len(g) <= 170


def test_inflation_removes_added_gaussians():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))

    def added(weight: float) -> float:
        t = trainer(max_growth=0.4, inflation=weight, key_iterations=120)
        return float(
            t.fit_keyframe(FrameViews(1, views), InMotion(old), t.steps(old, views))
            .gaussians.opacities()[len(old) :]
            .sum()
        )

    assert added(1e-1) < 0.6 * added(0.0)
    assert added(1e-6) == pytest.approx(added(0.0), rel=0.1)


def moving(before, after, cameras):
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
        g = t.fit_keyframe(target, InMotion(before), t.steps(before, views)).gaussians
    else:
        g = t.fit_frame(target, InMotion(before), t.start_group(before, views))
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
    fitted = t.fit_keyframe(FrameViews(1, views, [specks] * 8), InMotion(g), t.steps(g, views)).gaussians
    assert len(fitted) == len(g)


def test_a_frame_where_nothing_moves_is_the_frame_before():
    g, cameras = coloured_cloud(), ring(8)
    views = views_of(g, cameras)
    t = trainer()
    nothing = [np.zeros((48, 48), bool)] * 8
    assert t.fit_frame(FrameViews(1, views, nothing), InMotion(g), t.start_group(g, views)) is g


def test_a_fit_that_shows_less_than_the_frame_before_is_not_taken():
    truth = coloured_cloud()
    views = views_of(moved(truth, slice(0, 20), (1e-6, 0.0, 0.0)), ring(8))  # less than 8 bits show
    free = {"frame_iterations": 10, "temporal": Temporal(weight=0.0)}
    for keep_better in (True, False):
        t = trainer(**free, keep_better=keep_better)
        g = t.fit_frame(FrameViews(1, views), InMotion(truth), t.start_group(truth, views))
        assert (g is truth) == keep_better
    assert mean_psnr(g, views) < mean_psnr(truth, views) - 3


STEP = np.array([0.1, 0.0, 0.0], np.float32)  # world units that all moves by in a frame


def half_early(truth):
    """What eight cameras see of what moves by STEP, every second one half a frame before the others."""
    views = []
    for i, camera in enumerate(ring(8)):
        after = -0.5 * (i % 2)
        views += [replace(view, after=after) for view in views_of(moved(truth, slice(None), after * STEP), [camera])]
    return views


def test_a_first_frame_of_cameras_out_of_step_is_as_sharp_as_in_step():
    truth, t = coloured_cloud(), trainer(first_iterations=200)
    early, in_step = half_early(truth), views_of(truth, ring(8))
    later = half_early(moved(truth, slice(None), STEP))[1::2]
    target = FrameViews(0, early, later=[replace(view, after=0.5) for view in later])
    found = fit_first(t, target, Points(truth.means, None))
    alone = fit_first(t, FrameViews(0, [replace(view, after=0.0) for view in early]), Points(truth.means, None))
    assert mean_psnr(found.gaussians, in_step) > mean_psnr(alone.gaussians, in_step) + 3
    assert mean_psnr(found, early[1::2]) > mean_psnr(found.gaussians, early[1::2]) + 3
    assert np.median(found.velocity[:, 0]) > 0.3 * STEP[0]


def test_a_rig_in_step_has_no_motion_to_fit():
    truth, views = coloured_cloud(), views_of(coloured_cloud(), ring(8))
    found = fit_first(trainer(first_iterations=1), FrameViews(0, views), Points(truth.means, None))
    assert found.velocity is None and found.at(-0.5) is found.gaussians


@pytest.mark.parametrize("deltas", ["direct", "mlp"])
def test_a_frame_of_cameras_out_of_step_is_as_sharp_as_in_step(deltas):
    truth, t = coloured_cloud(), trainer(deltas=deltas, temporal=Temporal(weight=0.0), frame_iterations=40)
    after = moved(truth, slice(None), STEP)
    early, in_step = half_early(after), views_of(after, ring(8))

    def quality(views):
        g = t.fit_frame(FrameViews(1, views), InMotion(truth), t.start_group(truth, views))
        return mean_psnr(g, in_step)

    assert quality(early) > quality(in_step) - 2
    assert quality(early) > quality([replace(view, after=0.0) for view in early]) + 3
