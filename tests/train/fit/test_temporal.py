"""The temporal loss: codec steps of every element, and weights in their unit."""

import numpy as np
import pytest
import torch

from airgs_codec.coding.steps import StepSettings
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.fit.parameters import ATTRIBUTES
from airgs_codec.train.fit.temporal import codec_steps, temporal_weights
from airgs_codec.train.settings import Temporal
from tests.support.scenes import random_gaussians
from tests.support.views import ring


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
