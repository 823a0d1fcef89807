"""gsplat against the CPU renderer where it runs; what is made around it everywhere, with a stand-in of its shapes."""

import sys
import types
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from airgs_codec.render import cuda
from airgs_codec.render.backend import Renderer
from airgs_codec.render.cuda import AbsGrad, OnCuda
from airgs_codec.trainer.fit.losses import mean_psnr, render, render_views
from airgs_codec.trainer.fit.optimise import PerGaussian, Schedule, optimise
from tests.faces import ATTRIBUTES, CPU, RasterInputs, View, from_gaussians
from tests.support import fake_gsplat
from tests.support.scenes import random_gaussians
from tests.support.views import coloured_cloud, moved, ring, views_of
from tools.check_gpu import compare

missing = cuda.missing()
on_gsplat = pytest.mark.skipif(missing is not None, reason=f"gsplat: {missing}")


@on_gsplat
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


@on_gsplat
def test_pictures_and_gradients_are_within_their_limits():
    g, camera = random_gaussians(500, 1), ring(1, size=100)[0]
    assert compare(CPU.load(g), Renderer("cuda").load(g), camera).good()


@on_gsplat
def test_cameras_drawn_at_once_are_those_drawn_alone():
    cameras, together = ring(3, size=48), AbsGrad()
    p = {n: t.requires_grad_() for n, t in from_gaussians(random_gaussians(200, 1), "cuda").items()}
    pictures, _ = render_views(p, cameras, 1, together)
    alone, counts = [], []
    for camera in cameras:
        one = AbsGrad()
        alone.append(render(p, camera, 1, one)[0])
        alone[-1].square().sum().backward()
        counts.append(one.read())
    pictures.square().sum().backward()
    torch.testing.assert_close(pictures, torch.stack(alone))
    gradients, seen = together.read()
    torch.testing.assert_close(gradients, sum(g for g, _ in counts), rtol=1e-3, atol=1e-4)
    assert torch.equal(seen, sum(s for _, s in counts))


@on_gsplat
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


@pytest.fixture
def stand_in(monkeypatch):
    fake_gsplat.install(monkeypatch)


VIEW = replace(ring(1, size=72)[0], height=56, fx=80.0, fy=85.0, cy=30.0, background=(0.2, 0.4, 0.6))


def loaded(g):
    return CPU.load(g), OnCuda.of(CPU.load(g).inputs, "cpu")


def test_pictures_and_rows_left_out_are_those_of_the_cpu_and_an_empty_scene_is_its_background(stand_in):
    there, here = loaded(random_gaussians(200, 1))
    for background in (None, (1.0, 0.0, 0.5)):
        a, b = there.draw(VIEW, background), here.draw(VIEW, background)
        np.testing.assert_allclose(b.rgb, a.rgb, atol=1e-5)
        np.testing.assert_allclose(b.transmittance, a.transmittance, atol=1e-5)
    for rows in (None, np.arange(200) % 3 > 0, np.zeros(200, bool)):
        np.testing.assert_allclose(here.without(VIEW)(rows), there.without(VIEW)(rows), atol=1e-5)
    _, none = loaded(random_gaussians(3, 1).take(np.arange(0)))
    assert (none.draw(VIEW).rgb == np.float32([0.2, 0.4, 0.6])).all()
    contribution, gradients = none.contribution_and_gradients(VIEW, np.ones((56, 72, 3), np.float32))
    assert len(contribution.total) == 0 and gradients.sh.shape == (0, 4, 3)


@pytest.mark.parametrize("version", ["1.5.3", "1.6"])
def test_cameras_of_equal_shapes_are_drawn_in_one_call_and_absolute_gradients_are_their_sum(monkeypatch, version):
    inputs = RasterInputs(*(torch.tensor(c).requires_grad_() for c in CPU.load(random_gaussians(90)).inputs))
    cameras = [replace(c, background=(0.1 * i, 0.5, 0.2)) for i, c in enumerate(ring(3, size=40))]
    ones, together = [AbsGrad() for _ in cameras], AbsGrad()
    for c, one in zip(cameras, ones, strict=True):
        cuda.rasterize(inputs, [c], one)[0].square().sum().backward()
    pictures, left = cuda.rasterize(inputs, cameras, together)
    pictures.square().sum().backward()
    fake_gsplat.install(monkeypatch, version)
    for drawn, other in zip((pictures, left), cuda.rasterize(inputs, cameras), strict=True):
        torch.testing.assert_close(drawn, other)
    gradients, seen = together.read()
    torch.testing.assert_close(gradients, sum(one.read()[0] for one in ones))
    assert torch.equal(seen, sum(one.read()[1].long() for one in ones)) and seen.max() == 3


class Operators(TorchDispatchMode):
    count = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.count += 1
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("weights", [{}, {"temporal": 1e-6}, {"opacity_weight": 0.003, "scale_weight": 0.1}])
def test_a_fit_by_gsplat_is_that_of_the_cpu_and_an_iteration_of_four_pictures_takes_few_operators(monkeypatch, weights):
    """On a GPU a launch takes longer than most kernels. Each call of gsplat counts as one operator."""
    base, views = from_gaussians(random_gaussians(100, 1)), views_of(random_gaussians(100, 1, seed=1), ring(6))
    if "temporal" in weights:
        weights = {"temporal": {name: torch.full_like(p, weights["temporal"]) for name, p in base.items()}}

    def fit(iterations):
        variables = PerGaussian(base, 5.0, **weights)
        with Operators() as seen:
            optimise(variables, views, Schedule("fit", iterations, lambda _: 1, views=4), np.random.default_rng(0))
        return variables.detached(), seen.count

    expected, _ = fit(8)
    fake_gsplat.install(monkeypatch)
    (found, _), (_, few), (_, many) = fit(8), fit(8), fit(18)
    assert many - few <= 130 * 10
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, rtol=0, atol=2e-3)


def test_kernels_that_do_not_compile_are_one_line(stand_in, monkeypatch):
    def fail(name):
        raise RuntimeError("Ninja is required to load C++ extensions\n(all that the compiler said)")

    kernels = types.ModuleType("gsplat.cuda")
    kernels.__getattr__ = fail
    monkeypatch.setitem(sys.modules, "gsplat.cuda", kernels)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert cuda.missing() == "gsplat's kernels cannot be compiled: Ninja is required to load C++ extensions"
