"""Adam whose rows may come and go, and its L1 norm."""

import math

import numpy as np
import pytest
import torch

from airgs_codec.trainer.fit.losses import LAMBDA, _on_cuda, codec_steps, photometric, temporal_weights, windowed_ssim
from airgs_codec.trainer.fit.parameters import BETAS
from airgs_codec.trainer.fit.variables import HIDDEN, PerGaussian
from tests.faces import ATTRIBUTES, Adam, Gaussians, StepSettings, Target, Temporal, from_gaussians
from tests.support.scenes import random_gaussians
from tests.support.views import random_parameters, ring


def test_adam_follows_torch():
    start = random_parameters(5)
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
    rates = dict.fromkeys(ATTRIBUTES, 0.01)
    whole, alone = Adam(random_parameters(4), rates), Adam({n: p[2:3] for n, p in random_parameters(4).items()}, rates)
    for step in range(6):
        if step == 3:
            keep = torch.tensor([False, False, True, True])
            whole.replace_rows(keep, {n: p[:1] for n, p in random_parameters(3, seed=5).items()})
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


def test_other_values_begin_without_moments():
    rates = dict.fromkeys(ATTRIBUTES, 0.01)
    adam = Adam(random_parameters(3), rates)
    push(adam, 1.0)
    before = {n: p.detach().clone() for n, p in adam.parameters.items()}
    adam.replace_values("opacity_logits", torch.zeros(3))
    push(adam, 0.0)
    assert adam.parameters["opacity_logits"].tolist() == [0.0, 0.0, 0.0]
    assert not torch.equal(adam.parameters["means"], before["means"])


def push(adam: Adam, gradient: float) -> None:
    for p in adam.parameters.values():
        p.grad = torch.full_like(p, gradient)
    adam.step()


def test_rows_are_left_out_of_pictures_alone_and_the_more_the_longer_a_fit_goes_on():
    base = from_gaussians(random_gaussians(400, 1))
    variables = PerGaussian(base, 1.0, dropout=0.5)

    def hidden():
        return int((variables.current()["opacity_logits"] == HIDDEN).sum())

    assert hidden() == 0
    for iteration in (1, 2):
        variables.current()["means"].sum().backward()
        variables.step(iteration, 2)
    assert 120 < hidden() < 280
    assert not (variables.detached()["opacity_logits"] == HIDDEN).any()


@pytest.mark.parametrize(
    ("loss_of", "shape", "tolerance"),
    [
        *((photometric, shape, 1e-5) for shape in ((16, 16), (7, 33), (40, 5), (1, 1))),
        (_on_cuda, (20, 30), 1e-4),  # on tensors of the CPU: the same arithmetic
    ],
)
def test_losses_and_their_gradients_equal_the_definition(loss_of, shape, tolerance):
    rng = np.random.default_rng(0)
    picture, truth = (rng.uniform(-0.1, 1.1, (*shape, 3)).astype(np.float32) for _ in range(2))
    x, target = torch.from_numpy(picture).requires_grad_(), Target(truth)
    fused = loss_of(x, target, LAMBDA)
    fused.backward()
    y = torch.from_numpy(picture).double().requires_grad_()
    t = torch.from_numpy(truth).double()
    similarity = windowed_ssim(y, t)
    loss = 0.8 * (y - t).abs().mean() + 0.2 * (1 - similarity)
    loss.backward()
    assert fused.item() == pytest.approx(loss.item(), rel=tolerance)
    assert 1 - loss_of(x, target, 1.0).item() == pytest.approx(similarity.item(), abs=tolerance)
    assert (x.grad - y.grad).norm() <= tolerance * y.grad.norm()
    there = target.on_device
    assert loss_of(x, target, 0.0).item() == pytest.approx((y - t).abs().mean().item(), rel=tolerance)
    assert target.on_device is there  # the picture is taken there once


def test_equal_pictures_have_no_loss_and_black_ones_a_finite_gradient():
    black = np.zeros((12, 12, 3), np.float32)
    x = torch.from_numpy(black.copy()).requires_grad_()
    compared = photometric(x, Target(black))
    compared.backward()
    assert compared.item() == pytest.approx(0, abs=1e-6)
    assert torch.isfinite(x.grad).all() and x.grad.abs().max() < 1e-6


def test_codec_steps_are_positive_and_finite_at_extremes():
    g = random_gaussians(12, 1)
    logits = np.array([0, 100, -100, 20, -20, 1, 2, 3, 4, 5, 6, 7], np.float32)
    lengths = np.repeat([1e-3, 1e20], 6).astype(np.float32)
    g = Gaussians(g.means, g.quaternions * lengths[:, None], g.log_scales, logits, g.sh_dc, g.sh_rest)
    steps = codec_steps(g, ring(3))
    for name in ATTRIBUTES:
        assert steps[name].shape == getattr(g, name).shape
        assert torch.isfinite(steps[name]).all() and (steps[name] > 0).all()
    assert steps["opacity_logits"][0] == pytest.approx(0.058 * 4)
    half = StepSettings().state.quaternions / 2 * np.linalg.norm(g.quaternions.astype(float), axis=1, keepdims=True)
    np.testing.assert_allclose(steps["quaternions"], np.broadcast_to(half, (12, 4)), rtol=1e-5)


def test_temporal_weights_have_the_unit_they_say():
    steps = {"means": torch.tensor([[0.5, 0.5, 0.5], [2.0, 2.0, 2.0]])}
    assert temporal_weights(Temporal(0.4, "step"), steps)["means"].tolist() == [
        pytest.approx([0.4] * 3),
        pytest.approx([0.1] * 3),
    ]
    assert temporal_weights(Temporal(0.4, "raw"), steps)["means"].tolist() == [pytest.approx([0.4] * 3)] * 2
