"""The three kinds of fits: a first frame, a frame in a group, a keyframe."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.trainer.fit import losses
from airgs_codec.trainer.fit import trainer as fits
from tests.faces import FrameViews, InMotion, Points, Temporal, Trainer, TrainSettings, fit_first, render, scene_extent
from tests.support.views import BALL, appeared, coloured_cloud, joined, moved, ring, views_of

TRUTH, CAMERAS = coloured_cloud(), ring(8)
POINTS = Points(TRUTH.means, None)
FREE = Temporal(weight=0.0)
STEP = np.array([0.1, 0.0, 0.0], np.float32)  # world units that all moves by in a frame


def trainer(**settings) -> Trainer:
    counts = {"first_iterations": 150, "keyframe_iterations": 150, "frame_iterations": 60}
    settings = {"budget": 400, "capacity": 600, "sh_degree": 0} | counts | settings
    return Trainer(TrainSettings(**settings), scene_extent(ring()))


def shifted(by, rows=slice(0, 20)):
    after = moved(TRUTH, rows, (by, 0.0, 0.0))
    return after, views_of(after, CAMERAS)


def fitted(t, views, velocity=None, moving=None):
    before = InMotion(TRUTH) if velocity is None else InMotion(TRUTH, velocity)
    return t.fit_frame(FrameViews(1, views, moving), before, t.start_group(TRUTH, views))


def keyed(t, views, moving=None):
    return t.fit_keyframe(FrameViews(1, views, moving), InMotion(TRUTH), t.steps(TRUTH, views)).gaussians


@pytest.fixture(scope="module")
def ball():
    return views_of(joined(TRUTH, appeared()), CAMERAS)


def test_a_first_frame_approaches_its_pictures_within_the_budget():
    views = views_of(TRUTH, CAMERAS)
    found = fit_first(trainer(), FrameViews(0, views), POINTS)
    assert losses.mean_psnr(found.gaussians, views) > 26
    assert len(found.gaussians) <= 400
    assert np.exp(found.gaussians.log_scales).max() <= scene_extent(ring()) * 1.001
    assert found.velocity is None and found.at(-0.5) is found.gaussians  # a rig in step has no motion to fit


def test_frames_move_what_moved_and_leave_the_rest_exactly_alone():
    _, views = shifted(0.05)
    g = fitted(trainer(frame_iterations=120, temporal=Temporal(weight=3e-4)), views)
    assert losses.mean_psnr(g, views) > losses.mean_psnr(TRUTH, views) + 6
    assert (g.means[20:] == TRUTH.means[20:]).all(axis=1).mean() > 0.5
    assert all((getattr(g, name) == getattr(TRUTH, name))[20:].mean() > 0.5 for name in ("sh_dc", "opacity_logits"))


def test_velocity_starts_a_frame_where_motion_leads_but_is_not_taken_where_it_leads_away():
    velocity = np.zeros_like(TRUTH.means)
    velocity[:20, 0] = 0.05
    _, views = shifted(0.05)
    t = trainer(frame_iterations=1)
    assert losses.mean_psnr(fitted(t, views, velocity), views) > losses.mean_psnr(fitted(t, views), views) + 3
    _, views = shifted(-0.02)
    t = trainer(frame_iterations=10)
    assert (fitted(t, views, 2 * velocity).means == fitted(t, views).means).all()


@pytest.mark.parametrize("deltas", ["mlp", "mlp+residual"])
def test_networks_learn_a_motion(deltas):
    _, views = shifted(0.04, slice(None))
    g = fitted(trainer(deltas=deltas, frame_iterations=120), views)
    assert losses.mean_psnr(g, views) > losses.mean_psnr(TRUTH, views) + 4


def test_a_keyframe_builds_what_appeared_and_keeps_old_rows_in_place(ball):
    g, rows = keyed(trainer(max_growth=0.4), ball), len(TRUTH)
    assert rows < len(g) <= round(1.4 * rows)
    assert losses.mean_psnr(g, ball) > losses.mean_psnr(TRUTH, ball) + 10
    stayed = np.linalg.norm(g.means[:rows] - TRUTH.means, axis=1) < 0.1  # row n is still that Gaussian
    assert stayed.mean() > 0.9
    added = g.means[rows:][g.opacities()[rows:] > 0.1]
    assert np.median(np.linalg.norm(added - BALL, axis=1)) < 0.5


def test_inflation_removes_added_gaussians(ball):
    def added(weight: float) -> float:
        t = trainer(max_growth=0.4, inflation=weight, keyframe_iterations=120)
        return float(keyed(t, ball).opacities()[len(TRUTH) :].sum())

    none = added(0.0)
    assert added(1e-1) < 0.6 * none
    assert added(1e-6) == pytest.approx(none, rel=0.1)


@pytest.mark.parametrize("key", [False, True])
def test_rows_that_rest_are_no_variables(key):
    """Bit for bit, without a temporal loss, in a frame of a group and in a keyframe; and what moves is still found."""
    after = joined(shifted(0.05)[0], appeared())
    views = views_of(after, CAMERAS)
    moving = [np.abs(render(TRUTH, c).rgb - render(after, c).rgb).max(axis=2) > 0.01 for c in CAMERAS]
    g = (keyed if key else fitted)(trainer(temporal=FREE, max_growth=0.4), views, moving=moving)
    same = (g.means[:150] == TRUTH.means).all(axis=1)
    assert same[20:].mean() > 0.4 and not same[:20].all()
    assert losses.mean_psnr(g, views) > losses.mean_psnr(TRUTH, views) + (8 if key else 1)


def test_a_keyframe_adds_nothing_where_pictures_rest(ball):
    """Nothing is drawn there, so nothing could be fitted: what the first frame missed, and specks in a corner."""
    specks = np.zeros((48, 48), bool)
    specks[:3, :3] = True
    t = trainer(max_growth=0.4, inflation=0.0, keyframe_iterations=60)
    assert len(keyed(t, ball, [specks] * 8)) == len(TRUTH)


def test_a_frame_is_the_frame_before_where_nothing_moves_or_its_fit_shows_less():
    assert fitted(trainer(), views_of(TRUTH, CAMERAS), moving=[np.zeros((48, 48), bool)] * 8) is TRUTH
    _, views = shifted(1e-6)  # less than 8 bits show
    kept, taken = (fitted(trainer(frame_iterations=10, temporal=FREE, keep_better=k), views) for k in (True, False))
    assert kept is TRUTH and losses.mean_psnr(taken, views) < losses.mean_psnr(TRUTH, views) - 3


def half_late(truth):
    """What eight cameras see of what moves by STEP, every second one half a frame after the others."""
    late = views_of(moved(truth, slice(None), 0.5 * STEP), CAMERAS[1::2])
    pairs = zip(views_of(truth, CAMERAS[::2]), late, strict=True)
    return [view for now, then in pairs for view in (now, replace(then, after=0.5))]


def test_a_first_frame_of_cameras_out_of_step_is_as_sharp_as_in_step():
    t, late, in_step = trainer(first_iterations=400), half_late(TRUTH), views_of(TRUTH, CAMERAS)
    found = fit_first(t, FrameViews(0, late), POINTS)
    alone = fit_first(t, FrameViews(0, [replace(view, after=0.0) for view in late]), POINTS)
    assert losses.mean_psnr(found.gaussians, in_step) > losses.mean_psnr(alone.gaussians, in_step) + 3
    assert losses.mean_psnr(found, late[1::2]) > losses.mean_psnr(found.gaussians, late[1::2]) + 3
    assert np.median(found.velocity[:, 0]) > 0.3 * STEP[0]


@pytest.mark.parametrize("deltas", ["direct", "mlp"])
def test_a_frame_of_cameras_out_of_step_is_as_sharp_as_in_step(deltas):
    t = trainer(deltas=deltas, temporal=FREE, frame_iterations=40)
    after, in_step = shifted(STEP[0], slice(None))
    late = half_late(after)
    untimed = [replace(view, after=0.0) for view in late]
    quality, expected, wrong = (losses.mean_psnr(fitted(t, views), in_step) for views in (late, in_step, untimed))
    assert quality > expected - 2 and quality > wrong + 3


def test_a_first_frame_has_as_many_gaussians_as_its_pictures_can_tell_within_bounds(monkeypatch):
    budgets = {100: 8000, 400: 11429, 700: 35000, 2000: 64000}  # of pictures of these sizes
    assert {size: fits.usual_budget(ring(8, size=size)) for size in budgets} == budgets
    monkeypatch.setattr(fits, "LEAST_BUDGET", 60)
    truth = coloured_cloud(400)
    found = fit_first(trainer(budget=None), FrameViews(0, views_of(truth, CAMERAS)), Points(truth.means, None))
    assert 60 < len(found.gaussians) <= 48 * 48 / 14
