"""Parts of the trainer: losses, optimiser, densification, fits, networks, temporal loss."""

import math

import numpy as np
import pytest
import torch

from airgs_codec.errors import ConfigError
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.render import cuda as gpu
from airgs_codec.render import render
from airgs_codec.render.absgrad import Pull
from airgs_codec.render.differentiable import rasterize
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.multiview import Points, View
from airgs_codec.train.fit.deltas import Driven, Networks
from airgs_codec.train.fit.densify import Growth, grow, prune
from airgs_codec.train.fit.match import Free, TrainingError, match
from airgs_codec.train.fit.parameters import ATTRIBUTES, BETAS, Adam, from_gaussians, to_gaussians
from airgs_codec.train.fit.points import scene_extent
from airgs_codec.train.fit.temporal import Temporal, codec_steps, static_shares
from airgs_codec.train.loss.losses import photometric, windowed_ssim
from airgs_codec.train.loss.target import Target
from airgs_codec.train.settings import TrainSettings, preset
from airgs_codec.train.stages import Trainer
from tests.support.scenes import random_gaussians
from tests.support.views import BALL, appeared, coloured_cloud, joined, moved, ring, views_of


def quality(g: Gaussians, views: list[View]) -> float:
    return float(np.mean([psnr(mse(render(g, v.camera).rgb, v.target.rgb)) for v in views]))


# ------------------------------------------------------------------ losses


@pytest.mark.parametrize("shape", [(16, 16), (7, 33), (40, 5), (1, 1)])
def test_the_fused_loss_and_its_gradient_equal_the_definition(shape):
    rng = np.random.default_rng(0)
    picture, truth = (rng.uniform(-0.1, 1.1, (*shape, 3)).astype(np.float32) for _ in range(2))
    x = torch.from_numpy(picture).requires_grad_()
    fused = photometric(x, Target(truth))
    fused.loss.backward()
    y = torch.from_numpy(picture).double().requires_grad_()
    t = torch.from_numpy(truth).double()
    similarity = windowed_ssim(y, t)
    loss = 0.8 * (y - t).abs().mean() + 0.2 * (1 - similarity)
    loss.backward()
    assert fused.loss.item() == pytest.approx(loss.item(), rel=1e-5)
    assert fused.ssim == pytest.approx(similarity.item(), abs=1e-5)
    assert fused.mse == pytest.approx((y - t).square().mean().item(), rel=1e-5)
    assert (x.grad - y.grad).norm() <= 1e-5 * y.grad.norm()


def test_equal_pictures_have_no_loss_and_black_ones_a_finite_gradient():
    black = np.zeros((12, 12, 3), np.float32)
    x = torch.from_numpy(black.copy()).requires_grad_()
    match_ = photometric(x, Target(black))
    match_.loss.backward()
    assert match_.loss.item() == pytest.approx(0, abs=1e-6)
    assert torch.isfinite(x.grad).all() and x.grad.abs().max() < 1e-6


def test_a_nan_in_the_picture_is_a_nan_in_the_loss():
    picture = torch.zeros(12, 12, 3)
    picture[3, 4, 1] = torch.nan
    assert math.isnan(photometric(picture, Target(np.zeros((12, 12, 3), np.float32))).loss.item())


# ------------------------------------------------------------------ optimiser


def small(rows: int, seed: int = 0):
    return from_gaussians(random_gaussians(rows, 1, seed))


def test_adam_follows_torch():
    start = small(5)
    ours = Adam(start, dict.fromkeys(ATTRIBUTES, 0.01))
    theirs = {n: p.clone().requires_grad_() for n, p in start.items()}
    reference = torch.optim.Adam(theirs.values(), lr=0.01, betas=BETAS, eps=1e-12)
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        for name in ATTRIBUTES:
            gradient = torch.randn(start[name].shape, generator=generator)
            ours.parameters[name].grad, theirs[name].grad = gradient.clone(), gradient.clone()
        ours.step()
        reference.step()
    for name in ATTRIBUTES:
        torch.testing.assert_close(ours.parameters[name].detach(), theirs[name].detach(), rtol=1e-5, atol=1e-6)


def test_rows_keep_their_moments_when_others_come_and_go():
    """The kept row goes on exactly as it would have alone."""
    rates = dict.fromkeys(ATTRIBUTES, 0.01)
    whole, alone = Adam(small(4), rates), Adam({n: p[2:3] for n, p in small(4).items()}, rates)
    for step in range(6):
        if step == 3:
            keep = torch.tensor([False, False, True, True])
            whole.replace_rows(keep, {n: p[:1] for n, p in small(3, seed=5).items()})
        for adam in (whole, alone):
            for p in adam.parameters.values():
                p.grad = torch.full_like(p, math.sin(step + 1))
            adam.step()
    row = 0
    for name in ATTRIBUTES:
        torch.testing.assert_close(whole.parameters[name][row], alone.parameters[name][0], rtol=0, atol=0)
        assert len(whole.parameters[name]) == 3


def test_shrinking_ends_at_the_minimum_of_the_l1_problem():
    """min (x - a)^2 / 2 + w |x| is at a - w, and exactly at 0 for |a| <= w."""
    wanted = torch.tensor([[1.0, 0.3, -0.05], [-0.8, 0.1, 0.0]])
    adam = Adam({"means": torch.zeros(2, 3)}, {"means": 0.02})
    weight = {"means": torch.full((2, 3), 0.1)}
    for step in range(800):
        adam.rates["means"] = 0.02 * 0.01 ** (step / 800)
        adam.parameters["means"].grad = adam.parameters["means"].detach() - wanted
        adam.step(weight)
    expected = torch.tensor([[0.9, 0.2, 0.0], [-0.7, 0.0, 0.0]])
    result = adam.parameters["means"].detach()
    torch.testing.assert_close(result, expected, rtol=0, atol=5e-3)
    assert (result[expected == 0] == 0).all()


# ------------------------------------------------------------------ densification


def test_growth_ends_at_the_budget_and_never_passes_it():
    growth = Growth(budget=1000, start=0.1, stop=0.6, every=10)
    counts = [growth.target(300, done) for done in np.linspace(0, 1, 101)]
    assert counts[0] == 300 and counts[-1] == 1000
    assert counts == sorted(counts)
    assert growth.target(1200, 0.5) == 1200
    assert not growth.due(20, 1000) and growth.due(300, 1000) and not growth.due(305, 1000)
    assert not growth.due(700, 1000)


def test_growing_adds_what_was_asked_and_leaves_kept_rows_in_place():
    p = small(50)
    score = torch.linspace(0, 1, 50)
    keep, added = grow(p, score, 20, large=0.0, kept=40, rng=np.random.default_rng(0))
    assert keep[:40].all()  # splits of kept rows leave the parent
    assert int(keep.sum()) + len(added["means"]) == 70
    parents = p["log_scales"][-1]
    assert torch.allclose(added["log_scales"][-1], parents - math.log(1.6))
    spread = (added["means"][-1] - p["means"][-1]).norm()
    assert 0 < spread < 6 * p["log_scales"][-1].max().exp()


def test_growing_without_pull_adds_nothing():
    keep, added = grow(small(9), torch.zeros(9), 5, large=1.0, kept=0, rng=np.random.default_rng(0))
    assert added is None and keep.all()


def test_pruning_spares_kept_rows():
    p = small(6)
    p["opacity_logits"] = torch.tensor([-9.0, 3.0, -9.0, 3.0, -9.0, 3.0])
    assert prune(p, kept=3).tolist() == [True, True, True, True, False, True]


def test_the_pull_is_where_the_picture_is_wrong():
    g = coloured_cloud()
    views = views_of(moved(g, slice(0, 1), (0.0, 0.0, 0.3)), ring(4))
    total = torch.zeros(len(g))
    for view in views:
        p = {n: t.requires_grad_() for n, t in from_gaussians(g).items()}
        pull = Pull()
        sh = p["sh_dc"][:, None]
        arguments = (p["means"], p["quaternions"], p["log_scales"].exp(), p["opacity_logits"].sigmoid(), sh)
        photometric(rasterize(*arguments, view.camera, pull=pull)[0], view.target).loss.backward()
        pixels, seen = pull.read()
        assert (pixels[~seen] == 0).all()
        total += pixels
    near = np.linalg.norm(g.means - g.means[0], axis=1) < 0.5
    assert near[int(total.argmax())]


def test_a_pull_cannot_be_read_before_the_backward_pass():
    with pytest.raises(RuntimeError, match="backward"):
        Pull().read()


# ------------------------------------------------------------------ fits


def trainer(**settings) -> Trainer:
    defaults = {"sh_degree": 0, "budget": 400, "capacity": 600}
    counts = {"first_iterations": 150, "key_iterations": 150, "frame_iterations": 60}
    return Trainer(TrainSettings(**(defaults | counts | settings)), scene_extent(ring()))


def test_a_first_frame_approaches_its_pictures_within_the_budget():
    truth = coloured_cloud()
    views = views_of(truth, ring(8))
    g = trainer().first(0, Points(truth.means, None), views)
    assert quality(g, views) > 26
    assert len(g) <= 400
    assert np.exp(g.log_scales).max() <= scene_extent(ring()) * 1.001


def test_frames_move_what_moved_and_leave_the_rest_exactly_alone():
    truth = coloured_cloud()
    after = moved(truth, slice(0, 20), (0.05, 0.0, 0.0))
    views = views_of(after, ring(8))
    t = trainer(frame_iterations=120, temporal=Temporal(weight=3e-4))
    steps = t.steps(truth, views)
    g = t.frame(1, truth, None, steps, views, None)
    assert quality(g, views) > quality(truth, views) + 6
    rest = (g.means[20:] == truth.means[20:]).all(axis=1)
    assert rest.mean() > 0.5
    shares = static_shares(truth, g, steps)
    assert min(shares.values()) > 0.7


def test_without_the_temporal_loss_nearly_everything_moves():
    truth = coloured_cloud()
    views = views_of(moved(truth, slice(0, 20), (0.05, 0.0, 0.0)), ring(8))
    t = trainer(temporal=Temporal(weight=0.0))
    g = t.frame(1, truth, None, t.steps(truth, views), views, None)
    assert (g.means[20:] == truth.means[20:]).all(axis=1).mean() < 0.1


def test_velocity_starts_a_frame_where_motion_leads():
    truth = coloured_cloud()
    step = np.zeros_like(truth.means)
    step[:20, 0] = 0.05
    views = views_of(moved(truth, slice(0, 20), (0.05, 0.0, 0.0)), ring(8))
    t = trainer(frame_iterations=1)
    with_velocity = t.frame(1, truth, step, t.steps(truth, views), views, None)
    without = t.frame(1, truth, None, t.steps(truth, views), views, None)
    assert quality(with_velocity, views) > quality(without, views) + 3


def test_a_keyframe_builds_what_appeared_and_keeps_old_rows_in_place():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))
    t = trainer(added=0.4)
    g = t.keyframe(1, old, None, t.steps(old, views), views)
    assert len(old) < len(g) <= round(1.4 * len(old))
    assert quality(g, views) > quality(old, views) + 10
    stayed = np.linalg.norm(g.means[: len(old)] - old.means, axis=1) < 0.1  # row n is still that Gaussian
    assert stayed.mean() > 0.9
    added = g.means[len(old) :][g.opacities()[len(old) :] > 0.1]
    assert np.median(np.linalg.norm(added - BALL, axis=1)) < 0.5


def test_a_keyframe_never_passes_the_capacity():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))
    t = trainer(budget=150, capacity=170, added=0.9, key_iterations=60)
    assert len(t.keyframe(1, old, None, t.steps(old, views), views)) <= 170


def test_inflation_removes_added_gaussians():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))

    def added(weight: float) -> float:
        t = trainer(added=0.4, inflation=weight, key_iterations=120)
        return float(t.keyframe(1, old, None, t.steps(old, views), views).opacities()[len(old) :].sum())

    assert added(1e-1) < 0.6 * added(0.0)
    assert added(1e-6) == pytest.approx(added(0.0), rel=0.1)


def test_a_loss_that_is_not_finite_ends_the_fit_with_the_view():
    g = coloured_cloud(20)
    views = views_of(g, ring(2))
    views[0].target.rgb[:] = views[1].target.rgb[:] = np.nan
    free = Free(from_gaussians(g), 5.0)
    with pytest.raises(TrainingError, match="iteration 1 in view cam0"):
        match(free, views, 5, np.random.default_rng(0), lambda done: 0)


@pytest.mark.parametrize("extreme", ["opaque", "tiny", "huge", "zero quaternion"])
def test_extreme_rows_stay_finite_in_a_fit(extreme):
    g = coloured_cloud(40)
    columns = {n: getattr(g, n).copy() for n in g.__slots__}
    if extreme == "opaque":
        columns["opacity_logits"][:10] = [100, -100, 20, -20, 0, 50, -50, 5, -5, 1]
    elif extreme == "tiny":
        columns["log_scales"][:10] = -30
    elif extreme == "huge":
        columns["log_scales"][:5] = 8
    else:
        columns["quaternions"][:10] = 0
    views = views_of(g, ring(4))
    free = Free(from_gaussians(Gaussians(**columns)), 5.0)
    match(free, views, 30, np.random.default_rng(0), lambda done: 0)
    after = to_gaussians(free.detached())
    assert all(np.isfinite(getattr(after, n)).all() for n in g.__slots__)
    assert after.log_scales.max() <= math.log(5.0) + 1e-5


# ------------------------------------------------------------------ networks and temporal loss


@pytest.mark.parametrize("degree", [0, 1])
def test_networks_start_at_no_change_and_come_back_from_their_arrays(degree):
    base = from_gaussians(random_gaussians(30, degree))
    networks = Networks(base, 3.0, seed=1)
    assert ("sh_rest" in networks.names) == (degree > 0)
    current = Driven(base, networks, None).current()
    assert all(torch.equal(current[n], base[n]) for n in ATTRIBUTES)
    with torch.no_grad():
        for last in networks.last:
            last.add_(0.1)
    other = Networks(base, 3.0, seed=2)
    other.load(networks.arrays())
    a, b = (n(n.features(base)) for n in (networks, other))
    assert all(torch.equal(a[n], b[n]) for n in networks.names)
    assert (a["means"].abs() > 0).any()


@pytest.mark.parametrize("deltas", ["mlp", "mlp+residual"])
def test_networks_learn_a_motion(deltas):
    truth = coloured_cloud()
    after = moved(truth, slice(None), (0.04, 0.0, 0.0))
    views = views_of(after, ring(8))
    t = trainer(deltas=deltas, frame_iterations=120)
    g = t.frame(1, truth, None, t.steps(truth, views), views, t.networks(truth))
    assert quality(g, views) > quality(truth, views) + 4


def test_codec_steps_are_positive_and_finite_at_extremes():
    g = random_gaussians(12, 1)
    logits = np.array([0, 100, -100, 20, -20, 1, 2, 3, 4, 5, 6, 7], np.float32)
    g = Gaussians(g.means, g.quaternions * 1e-3, g.log_scales, logits, g.sh_dc, g.sh_rest)
    steps = codec_steps(g, ring(3))
    for name in ATTRIBUTES:
        assert steps[name].shape == getattr(g, name).shape
        assert torch.isfinite(steps[name]).all() and (steps[name] > 0).all()
    assert steps["opacity_logits"][0] == pytest.approx(0.058 * 4)


def test_temporal_weights_have_the_unit_they_say():
    steps = {"means": torch.tensor([[0.5, 0.5, 0.5], [2.0, 2.0, 2.0]])}
    assert Temporal(0.4, "step").weights(steps)["means"].tolist() == [
        pytest.approx([0.4] * 3),
        pytest.approx([0.1] * 3),
    ]
    assert Temporal(0.4, "raw").weights(steps)["means"].tolist() == [pytest.approx([0.4] * 3)] * 2


def test_the_papers_preset_is_the_papers():
    s = preset("paper", TrainSettings())
    assert (s.deltas, s.temporal, s.tau, s.inflation) == ("mlp", Temporal(1e-3, "raw"), 30.0, 1e-5)
    assert math.isinf(s.drop)


@pytest.mark.parametrize(
    "wrong",
    [{"budget": 0}, {"capacity": 5}, {"sh_degree": 4}, {"deltas": "x"}, {"method": "x"}, {"drop": 0.0}, {"group": 0}],
)
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(ConfigError, match="expected"):
        TrainSettings(**wrong)


# ------------------------------------------------------------------ gsplat

missing = gpu.missing()


@pytest.mark.skipif(missing is not None, reason=f"gsplat: {missing}")
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_gsplat_draws_the_same_picture_with_the_same_gradients(degree):
    g = random_gaussians(300, degree)
    camera = ring(1, size=64)[0]
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=(64, 64, 3)).astype(np.float32))
    results = []
    for device in ("cpu", "cuda"):
        p = {n: t.requires_grad_() for n, t in from_gaussians(g, device).items()}
        sh = torch.cat([p["sh_dc"][:, None], p["sh_rest"]], dim=1)
        pull = Pull()
        arguments = (p["means"], p["quaternions"], p["log_scales"].exp(), p["opacity_logits"].sigmoid(), sh)
        rgb, transmittance = rasterize(*arguments, camera, pull=pull)
        (rgb * weights.to(device)).sum().backward()
        gradients = {n: p[n].grad.cpu() for n in ATTRIBUTES}
        results.append((rgb.detach().cpu(), transmittance.detach().cpu(), gradients, pull.read()[0].cpu()))
    a, b = results
    assert (a[0] - b[0]).abs().max() < 5e-3 and (a[0] - b[0]).abs().mean() < 1e-5
    assert (a[1] - b[1]).abs().mean() < 1e-5
    for name in ATTRIBUTES:
        assert (a[2][name] - b[2][name]).norm() <= 1e-2 * a[2][name].norm() + 1e-6
    assert (a[3] - b[3]).norm() <= 1e-2 * a[3].norm()
