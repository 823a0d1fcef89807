"""The CPU renderer against its plain float64 definition: pictures, gradients, statistics, extremes."""

import importlib.machinery
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.render import backend, cpu, cuda, measure_contribution
from airgs_codec.render import cpu_kernels as kernels
from airgs_codec.render.cpu import activate, blend, gradients, project
from airgs_codec.render.reference import blending_weights, render_reference
from tests.faces import CPU, Camera, ConfigError, RasterInputs, Redraw, render
from tests.support.scenes import random_gaussians

# Single pixels flip at alpha = 1/255 between float32 and float64: one flip moves a pixel by up to 4e-3.
MEAN_ERROR, MAX_ERROR = 1e-5, 5e-3
NAMES = ("means", "quaternions", "scales", "opacities", "sh")


def camera(distance=4.0, width=70, height=50, turn=0.4) -> Camera:
    matrix = np.eye(4)
    matrix[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    matrix[2, 3] = distance
    return Camera("test", width, height, 60.0, 62.0, 33.0, 26.0, matrix)


def inputs(count=200, degree=1, seed=0, **columns):
    a = activate(random_gaussians(count, degree, seed))
    values = {name: getattr(a, name).astype(np.float64) for name in NAMES}
    values["scales"] = values["scales"] * 0.3
    return {n: np.asarray(columns.get(n, v), np.float32).astype(np.float64) for n, v in values.items()}


def rasterize(inputs, view, background=(0.0, 0.0, 0.0)):
    return [drawn[0] for drawn in cuda.rasterize(inputs, [replace(view, background=background)])]


def both(values, view, background=(0.2, 0.5, 0.9), seed=1):
    """Pictures and gradients of the renderer and of the reference for the same random loss."""
    rng = np.random.default_rng(seed)
    weights = torch.from_numpy(rng.normal(size=(view.height, view.width, 3)))
    weights_t = torch.from_numpy(rng.normal(size=(view.height, view.width)))
    out = []
    for dtype, function in ((torch.float32, rasterize), (torch.float64, render_reference)):
        tensors = [torch.from_numpy(values[n]).to(dtype).requires_grad_() for n in NAMES]
        rgb, transmittance = function(RasterInputs(*tensors), view, background)
        ((rgb * weights.to(dtype)).sum() + (transmittance * weights_t.to(dtype)).sum()).backward()
        gradients = {n: t.grad.double().numpy() for n, t in zip(NAMES, tensors, strict=True)}
        out.append((rgb.detach().double().numpy(), transmittance.detach().double().numpy(), gradients))
    return out


def relative(a, b):
    norm = np.linalg.norm(b)
    return np.linalg.norm(a - b) / norm if norm else np.linalg.norm(a)


def check(values, view, tolerance, names=NAMES):
    (rgb, transmittance, gradients), (rgb_ref, transmittance_ref, gradients_ref) = both(values, view)
    assert np.abs(rgb - rgb_ref).mean() <= MEAN_ERROR and np.abs(rgb - rgb_ref).max() <= MAX_ERROR
    assert np.abs(transmittance - transmittance_ref).max() <= MAX_ERROR
    for name in names:
        assert np.isfinite(gradients[name]).all(), name
        assert relative(gradients[name], gradients_ref[name]) <= tolerance, name


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_pictures_and_gradients_equal_the_reference(degree):
    check(inputs(200, degree, seed=degree), camera(), 1e-4)


THIN, LENGTHS = np.random.default_rng(3), np.repeat([1e-10, 0.0, 1.0, 5.0], 50)[:, None]
EXTREMES = {
    "needles, ratio 1e4": ({"scales": THIN.permuted(np.tile([1.0, 1e-4, 1e-4], (200, 1)), axis=1)}, 4.0),
    "needles of 30 x 3e-3": ({"scales": np.tile([30.0, 3e-3, 3e-3], (200, 1))}, 4.0),
    "scales over six decades": ({"scales": np.exp(np.random.default_rng(0).normal(size=(200, 3)) * 3 - 4)}, 4.0),
    "opacity 0 and 1": ({"opacities": np.repeat([1.0, 0.0], 100)}, 4.0),
    "opacity above the clamp": ({"opacities": np.full(200, 0.9995)}, 4.0),
    "tiny and zero quaternions": ({"quaternions": np.random.default_rng(1).normal(size=(200, 4)) * LENGTHS}, 4.0),
    "camera inside the scene": ({}, 0.3),
}


@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_equal_the_reference(name):
    columns, distance = EXTREMES[name]
    values, turned = inputs(200, 1, **columns), "quaternions" in columns
    # Where a quaternion is tiny its gradient scales with 1 / |q|: compared apart, so that it does not drown the rest.
    check(values, camera(distance), 1e-3, [n for n in NAMES if not (n == "quaternions" and turned)])
    if turned:
        (_, _, got), (_, _, want) = both(values, camera(distance))
        for rows in (slice(0, 50), slice(100, 150), slice(150, 200)):
            assert relative(got["quaternions"][rows], want["quaternions"][rows]) <= 1e-3
        assert not got["quaternions"][50:100].any()  # zero reads as identity and stays put


# Of 1e4 x 1 x 1e-2 before the camera the mean and quaternion gradients are rounding noise: a trainer clamps.
ABSURD = [({"scales": np.tile(sizes, (200, 1))}, camera()) for sizes in ([1e4, 1.0, 1e-2], [100.0] * 3, [1e-9] * 3)]
ON_PLANE = replace(camera(0.0, turn=0.0), near=0.01)  # and large Gaussians around the camera
ABSURD += [({"means": np.tile([1e-3, 2e-3, depth], (200, 1)), "scales": np.full((200, 3), size)}, ON_PLANE)
           for depth in (0.0, 1e-30, 0.01, np.nextafter(0.01, 1), 0.010001) for size in (1e-4, 0.1, 10.0)]  # fmt: skip


@pytest.mark.parametrize(("columns", "view"), ABSURD)
def test_absurd_sizes_and_means_on_the_near_plane_give_the_reference_picture_and_finite_gradients(columns, view):
    (rgb, _, gradients), (expected, _, _) = both(inputs(**columns), view)
    assert np.abs(rgb - expected).mean() <= MEAN_ERROR and np.abs(rgb - expected).max() <= MAX_ERROR
    assert np.isfinite(rgb).all() and all(np.isfinite(g).all() for g in gradients.values())


def test_behind_the_camera_and_of_no_gaussians_nothing_is_drawn_and_nothing_pulls():
    (rgb, transmittance, gradients), _ = both(inputs(), camera(-5.0))
    none = render(random_gaussians(3).take(np.arange(0)), camera(), (0.2, 0.5, 0.9))
    for picture in (rgb, none.rgb):
        np.testing.assert_allclose(picture, np.broadcast_to(np.float32([0.2, 0.5, 0.9]), (50, 70, 3)))
    assert (transmittance == 1).all() and not any(g.any() for g in gradients.values())


# 1e30 is finite and means something as a scale, an opacity past the clamp or the length of a quaternion.
BAD = [(n, v) for n in NAMES for v in (np.nan, np.inf, -np.inf)] + [("means", 1e30), ("sh", 1e30)]


@pytest.mark.parametrize(("name", "bad"), BAD)
def test_a_value_that_is_not_finite_culls_its_gaussian_alone(name, bad):
    values = inputs(60)
    values[name].reshape(60, -1)[7, 0] = bad
    keep = np.arange(60) != 7
    tensors = [torch.from_numpy(values[n]).float().requires_grad_() for n in NAMES]
    rgb, transmittance = rasterize(RasterInputs(*tensors), camera())
    (rgb.sum() + transmittance.sum()).backward()
    others = [torch.from_numpy(values[n][keep]).float() for n in NAMES]
    np.testing.assert_array_equal(rgb.detach().numpy(), rasterize(RasterInputs(*others), camera())[0].numpy())
    assert all(torch.isfinite(t.grad).all() for t in tensors)


def test_statistics_equal_the_blending_weights_of_the_reference():
    g, view = random_gaussians(150, 1), camera()
    seen, a = measure_contribution(g, view), activate(g)
    weights, _, _ = blending_weights(RasterInputs(*(torch.tensor(getattr(a, n)).double() for n in NAMES)), view)
    weights = weights.numpy()
    np.testing.assert_allclose(seen.total, weights.sum(axis=0), atol=5e-2, rtol=1e-3)
    np.testing.assert_allclose(seen.peak, weights.max(axis=0), atol=MAX_ERROR)
    assert np.abs(seen.hits - (weights > 0).sum(axis=0)).max() <= 2  # pixels at alpha = 1/255 flip
    # large Gaussians in many layers: tiles end early, and those at the edges of the picture hold pixels beside it
    large, opacity = np.full((400, 3), 1.0, np.float32), np.full(400, 8.0, np.float32)
    opaque = replace(random_gaussians(400), log_scales=large, opacity_logits=opacity)
    few = measure_contribution(opaque, view)
    assert 0 < np.count_nonzero(few.hits) < 20 and few.hits.max() <= view.width * view.height
    for statistics, scene in ((seen, g), (few, opaque)):
        assert statistics.total.sum() == pytest.approx((1 - render(scene, view).transmittance).sum(), rel=1e-5)


@pytest.mark.parametrize("logit", [0.0, 8.0])
def test_contribution_and_gradients_of_one_pass_are_those_of_two(logit):
    g, behind = random_gaussians(300, 2), (0.2, 0.5, 0.9)
    g, view = replace(g, opacity_logits=g.opacity_logits + np.float32(logit)), replace(camera(), background=behind)
    active, pull = activate(g), np.random.default_rng(0).normal(size=(50, 70, 3)).astype(np.float32)
    seen, derivatives = CPU.load(g).contribution_and_gradients(view, pull)
    alone, apart = measure_contribution(g, view), blend(active, view, behind)
    np.testing.assert_allclose(seen.total, alone.total, rtol=1e-6)
    assert np.array_equal(seen.peak, alone.peak) and np.array_equal(seen.hits, alone.hits)
    expected = gradients(apart, pull, np.zeros((50, 70), np.float32))[0]
    for name in NAMES:
        wanted = getattr(expected, name)
        np.testing.assert_allclose(getattr(derivatives, name), wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())


def expect_same(picture, alone):
    np.testing.assert_array_equal(picture.rgb, alone.rgb)
    np.testing.assert_array_equal(picture.transmittance, alone.transmittance)


def test_views_drawn_together_are_those_drawn_alone_and_rows_taken_out_were_never_there():
    g, views, behind = random_gaussians(300, 1), [camera(), camera(3.0, 33, 47), camera(turn=0.0)], (0.1, 0.2, 0.3)
    for view in views:
        expect_same(CPU.load(g).draw(view, behind), render(g, view, behind))
    for share in (0.0, 0.4, 1.0):
        kept = np.random.default_rng(0).random(300) < share
        expect_same(project(activate(g), camera()).draw(behind, kept), render(g.take(kept), camera(), behind))


def test_two_runs_give_the_same_bits():
    for a, b in zip(*(both(inputs(300, 2), camera())[0] for _ in range(2)), strict=True):
        np.testing.assert_equal(a, b)


def test_only_some_tiles_are_drawn_again():
    """Picture and gradients are those of the whole picture where it is drawn, and the rest is what was there."""
    values, view = inputs(), camera()
    a = RasterInputs(*(values[n].astype(np.float32) for n in NAMES))
    tiles = np.random.default_rng(3).uniform(size=(4, 5)) < 0.4
    pixels = np.repeat(np.repeat(tiles, 16, axis=0), 16, axis=1)[:50, :70]
    rows = np.random.default_rng(5).uniform(size=150) < 0.5  # of 200: the last 50 have gradients, too
    wanted = np.concatenate([rows, np.ones(50, bool)])
    before = blend(RasterInputs(*(c * np.float32(0.9) for c in a)), view, (0.2, 0.5, 0.9)).picture
    whole = blend(a, view, (0.2, 0.5, 0.9))
    part = blend(a, view, (0.2, 0.5, 0.9), Redraw(tiles, lambda: before, rows))
    assert np.array_equal(part.picture.rgb, np.where(pixels[..., None], whole.picture.rgb, before.rgb))
    assert np.array_equal(part.picture.transmittance[~pixels], before.transmittance[~pixels])
    rng = np.random.default_rng(4)
    grad = rng.normal(size=(50, 70, 3)).astype(np.float32) * pixels[..., None]
    none = np.zeros((50, 70), np.float32)
    parts, wholes = (gradients(drawn, grad, none) for drawn in (part, whole))
    for x, y in zip(parts[0], wholes[0], strict=True):
        assert np.abs(y[wanted]).max() > 0 and relative(x[wanted], y[wanted]) < 1e-6
        assert not x[~wanted].any()
    assert relative(parts[2][wanted], wholes[2][wanted]) < 1e-6
    assert len(part.projected.slots) < 0.7 * len(whole.projected.slots)


def test_a_device_that_cannot_run_is_refused_and_auto_takes_cuda_where_gsplat_runs(monkeypatch):
    monkeypatch.setattr(backend, "find_spec", lambda name: None if name == "gsplat" else importlib.machinery)
    assert backend.open_renderer("auto") is backend.open_renderer("cpu") is backend.CPU
    with pytest.raises(ConfigError, match="device cuda: gsplat is not installed: pip install"):
        backend.open_renderer("cuda")
    with pytest.raises(ConfigError, match="expected auto, cpu, cuda, got 'gpu'"):
        backend.open_renderer("gpu")
    monkeypatch.setattr(backend, "_missing", lambda: None)
    assert backend.open_renderer("auto").device == backend.open_renderer("cuda").device == "cuda"
    assert "gsplat" not in sys.modules


def test_another_process_compiles_what_gradients_take(monkeypatch):
    def signatures():
        return [
            len(kernel.signatures) for kernel in (kernels.blend_gradient, kernels.sum_pairs, kernels.project_gradient)
        ]

    view, shown = camera(), cpu.Loaded(activate(random_gaussians(50, 1, 0)))
    cpu.compile_ahead()
    assert not cpu._AHEAD  # all is in numba's cache
    monkeypatch.setattr(cpu, "_is_cached", lambda kernel: False)
    cpu.compile_ahead()
    (process,) = cpu._AHEAD
    shown.contribution_and_gradients(view, np.zeros((view.height, view.width, 3), np.float32))
    assert process.returncode == 0 and not cpu._AHEAD
    before = signatures()
    cpu.compile_gradients()
    assert signatures() == before
