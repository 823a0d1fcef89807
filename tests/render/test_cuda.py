"""gsplat against the CPU renderer; skipped where it cannot run."""

import numpy as np
import pytest
import torch

from airgs_codec.render import cuda
from airgs_codec.render.absgrad import AbsGrad
from airgs_codec.train.fit.parameters import ATTRIBUTES, from_gaussians, render
from tests.support.scenes import random_gaussians
from tests.support.views import ring

missing = cuda.missing()


@pytest.mark.skipif(missing is not None, reason=f"gsplat: {missing}")
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_gsplat_draws_the_same_picture_with_the_same_gradients(degree):
    g = random_gaussians(300, degree)
    camera = ring(1, size=64)[0]
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=(64, 64, 3)).astype(np.float32))
    results = []
    for device in ("cpu", "cuda"):
        p = {n: t.requires_grad_() for n, t in from_gaussians(g, device).items()}
        absgrad = AbsGrad()
        rgb, transmittance = render(p, camera, degree, absgrad)
        (rgb * weights.to(device)).sum().backward()
        gradients = {n: p[n].grad.cpu() for n in ATTRIBUTES}
        results.append((rgb.detach().cpu(), transmittance.detach().cpu(), gradients, absgrad.read()[0].cpu()))
    a, b = results
    assert (a[0] - b[0]).abs().max() < 5e-3 and (a[0] - b[0]).abs().mean() < 1e-5
    assert (a[1] - b[1]).abs().mean() < 1e-5
    for name in ATTRIBUTES:
        assert (a[2][name] - b[2][name]).norm() <= 1e-2 * a[2][name].norm() + 1e-6
    assert (a[3] - b[3]).norm() <= 1e-2 * a[3].norm()
