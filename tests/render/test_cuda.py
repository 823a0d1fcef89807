"""gsplat against the CPU renderer; skipped where it cannot run."""

import numpy as np
import pytest
import torch

from airgs_codec.render import cuda
from airgs_codec.render.backend import Renderer
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.parameters import render, render_views
from airgs_codec.trainer.fit.variables import PerGaussian
from tests.faces import ATTRIBUTES, CPU, View, from_gaussians
from tests.support.scenes import random_gaussians
from tests.support.views import coloured_cloud, moved, ring, views_of
from tools.lab.bench.devices import compare

missing = cuda.missing()
pytestmark = pytest.mark.skipif(missing is not None, reason=f"gsplat: {missing}")


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


@pytest.mark.parametrize("bands", [1, cuda.BAND_PAIRS])
def test_pictures_contributions_and_gradients_are_within_their_limits(bands, monkeypatch):
    monkeypatch.setattr(cuda, "BAND_PAIRS", bands)
    g, camera = random_gaussians(500, 1), ring(1, size=100)[0]
    assert compare(CPU.load(g), Renderer("cuda").load(g), camera).good()


def test_cameras_drawn_at_once_are_those_drawn_alone():
    cameras, together = ring(3, size=48), AbsGrad()
    p = {n: t.requires_grad_() for n, t in from_gaussians(random_gaussians(200, 1), "cuda").items()}
    pictures = render_views(p, cameras, 1, together)
    alone, counts = [], []
    for camera in cameras:
        one = AbsGrad()
        rgb, _ = render(p, camera, 1, one)
        rgb.square().sum().backward()
        alone.append(rgb)
        counts.append(one.read())
    sum(rgb.square().sum() for rgb, _ in pictures).backward()
    for (rgb, _), other in zip(pictures, alone, strict=True):
        torch.testing.assert_close(rgb, other)
    gradients, seen = together.read()
    torch.testing.assert_close(gradients, sum(g for g, _ in counts), rtol=1e-3, atol=1e-4)
    assert torch.equal(seen, sum(s for _, s in counts))


def test_a_fit_improves_and_waits_for_the_device_only_in_gsplat():
    """torch warns of every wait: none may come from this package."""
    g = coloured_cloud()
    views: list[View] = views_of(moved(g, slice(0, 40), (0.1, 0, 0)), ring(6))
    variables = PerGaussian(from_gaussians(g, "cuda"), 5.0)
    fit = Schedule("fit", 40, lambda done: 0, views=3)
    optimise(variables, views, fit, np.random.default_rng(0))
    torch.cuda.set_sync_debug_mode("warn")
    try:
        with pytest.warns(UserWarning) as said:
            optimise(variables, views, fit, np.random.default_rng(1))
    finally:
        torch.cuda.set_sync_debug_mode("default")
    ours = [w for w in said if "synchronizing" in str(w.message) and "airgs_codec" in w.filename]
    assert len(ours) <= 1, [f"{w.filename}:{w.lineno}" for w in ours]  # the look at the losses, at the end
    fitted = {n: t.cpu().numpy() for n, t in variables.detached().items()}
    renderer = Renderer("cuda")
    assert mean_psnr(type(g)(*fitted.values()), views, renderer) > mean_psnr(g, views, renderer) + 2
