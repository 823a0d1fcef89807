"""The losses of pictures against their definitions, and what a change costs in codec steps."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.coding.quantize import StepSettings
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import Target
from airgs_codec.trainer.fit.losses import (
    LAMBDA,
    ExposureModel,
    _on_cuda,
    codec_steps,
    matched_psnr,
    mean_psnr,
    photometric,
    temporal_weights,
    windowed_ssim,
)
from airgs_codec.trainer.fit.parameters import ATTRIBUTES
from airgs_codec.trainer.settings import Temporal
from tests.support.scenes import random_gaussians
from tests.support.views import coloured_cloud, ring, views_of


@pytest.mark.parametrize("shape", [(16, 16), (7, 33), (40, 5), (1, 1)])
def test_the_fused_loss_and_its_gradient_equal_the_definition(shape):
    rng = np.random.default_rng(0)
    picture, truth = (rng.uniform(-0.1, 1.1, (*shape, 3)).astype(np.float32) for _ in range(2))
    x = torch.from_numpy(picture).requires_grad_()
    fused = photometric(x, Target(truth))
    fused.backward()
    y = torch.from_numpy(picture).double().requires_grad_()
    t = torch.from_numpy(truth).double()
    similarity = windowed_ssim(y, t)
    loss = 0.8 * (y - t).abs().mean() + 0.2 * (1 - similarity)
    loss.backward()
    assert fused.item() == pytest.approx(loss.item(), rel=1e-5)
    assert 1 - photometric(x, Target(truth), 1.0).item() == pytest.approx(similarity.item(), abs=1e-5)
    assert photometric(x, Target(truth), 0.0).item() == pytest.approx((y - t).abs().mean().item(), rel=1e-5)
    assert (x.grad - y.grad).norm() <= 1e-5 * y.grad.norm()


def test_what_is_computed_on_cuda_is_the_fused_loss_and_the_picture_is_taken_there_once():
    """On tensors of the CPU: the same arithmetic."""
    rng = np.random.default_rng(1)
    picture, truth = (rng.uniform(size=(20, 30, 3)).astype(np.float32) for _ in range(2))
    target = Target(truth)
    x, y = (torch.from_numpy(picture).requires_grad_() for _ in range(2))
    fused, other = photometric(x, target), _on_cuda(y, target, LAMBDA)
    fused.backward()
    other.backward()
    for weight in (0.0, LAMBDA, 1.0):
        assert _on_cuda(y, target, weight).item() == pytest.approx(photometric(x, target, weight).item(), rel=1e-4)
    assert (x.grad - y.grad).norm() <= 1e-4 * x.grad.norm()
    there = target.on_device
    _on_cuda(y, target, LAMBDA)
    assert target.on_device is there


def test_equal_pictures_have_no_loss_and_black_ones_a_finite_gradient():
    black = np.zeros((12, 12, 3), np.float32)
    x = torch.from_numpy(black.copy()).requires_grad_()
    compared = photometric(x, Target(black))
    compared.backward()
    assert compared.item() == pytest.approx(0, abs=1e-6)
    assert torch.isfinite(x.grad).all() and x.grad.abs().max() < 1e-6


def test_a_nan_in_the_picture_is_a_nan_in_the_loss():
    picture = torch.zeros(12, 12, 3)
    picture[3, 4, 1] = torch.nan
    assert math.isnan(photometric(picture, Target(np.zeros((12, 12, 3), np.float32))).item())


def test_codec_steps_are_positive_and_finite_at_extremes():
    g = random_gaussians(12, 1)
    logits = np.array([0, 100, -100, 20, -20, 1, 2, 3, 4, 5, 6, 7], np.float32)
    g = Gaussians(g.means, g.quaternions * 1e-3, g.log_scales, logits, g.sh_dc, g.sh_rest)
    steps = codec_steps(g, ring(3))
    for name in ATTRIBUTES:
        assert steps[name].shape == getattr(g, name).shape
        assert torch.isfinite(steps[name]).all() and (steps[name] > 0).all()
    assert steps["opacity_logits"][0] == pytest.approx(0.058 * 4)
    half = StepSettings().state.quaternions / 2 * np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    np.testing.assert_allclose(steps["quaternions"], np.broadcast_to(half, (12, 4)), rtol=1e-5)


def test_temporal_weights_have_the_unit_they_say():
    steps = {"means": torch.tensor([[0.5, 0.5, 0.5], [2.0, 2.0, 2.0]])}
    assert temporal_weights(Temporal(0.4, "step"), steps)["means"].tolist() == [
        pytest.approx([0.4] * 3),
        pytest.approx([0.1] * 3),
    ]
    assert temporal_weights(Temporal(0.4, "raw"), steps)["means"].tolist() == [pytest.approx([0.4] * 3)] * 2


@pytest.mark.parametrize(("sides", "differs"), [((1.05, 1.05), True), ((1.05, 0.95), False)])
def test_exposure_is_one_only_where_both_halves_of_pictures_ask_for_it(sides, differs):
    gains = np.repeat(sides, 8).astype(np.float32)[None, :, None]
    grey = torch.full((8, 16, 3), 0.5)
    model = ExposureModel(2, "cpu", looks=60)
    for i in range(60):
        target = grey.numpy() * (gains if i % 2 else 2 - gains)
        (model.apply(grey, i % 2) - torch.from_numpy(target)).abs().mean().backward()
        model.step()
    assert model.differs == differs


def test_gains_of_a_picture_are_matched_only_where_its_halves_agree():
    g = coloured_cloud()
    view = views_of(g, ring(1))[0]
    for gain in (np.full(48, 0.7), np.repeat((0.7, 1.0), 24)):
        dark = replace(view, picture=Target(view.target.rgb * gain.astype(np.float32)[None, :, None]))
        better = matched_psnr(g, [dark]) - mean_psnr(g, [dark])
        assert better > 20 if gain[-1] < 1 else better == 0
