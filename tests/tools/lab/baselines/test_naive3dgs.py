"""3DGS of every frame: thresholds of the paper at their edges, the shrunk schedule, what a frame costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.errors import TrainingError
from airgs_codec.progress import silent
from airgs_codec.render import render
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.formats.ply import read_ply
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit import parameters
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.parameters import from_gaussians
from tests.support.training import write_blobs
from tests.support.views import coloured_cloud, ring
from tools.lab.baselines.method import Footage, frame_path, run_method
from tools.lab.baselines.threedgs import Naive3dgs, Splats, Timetable, chosen, is_kept, reset_opacity


@pytest.fixture
def footage(tmp_path):
    scene = open_scene(write_blobs(tmp_path / "blobs"), frames=(0, 2))
    return Footage(Pictures(scene), 2, scene.points, tmp_path / "run")


def rows(opacities, scales):
    p = from_gaussians(coloured_cloud(len(scales)))
    p["opacity_logits"] = torch.logit(torch.tensor(opacities, dtype=torch.float64)).float()
    p["log_scales"] = torch.tensor(scales, dtype=torch.float64).log().float()[:, None].repeat(1, 3)
    return p


def test_rows_are_added_from_a_gradient_of_two_in_ten_thousand_on():
    p = rows([0.5] * 4, [0.0199, 0.0199, 0.0201, 0.0201])
    parents, split = chosen(p, torch.tensor([1.99e-4, 2e-4, 1.99e-4, 2e-4]), Timetable().gradient, extent=2.0)
    assert parents.tolist() == [False, True, False, True]
    assert split.tolist() == [False, False, False, True]


def test_faint_and_large_rows_go():
    p = rows([0.0049, 0.0051, 0.9, 0.9], [0.1, 0.1, 0.199, 0.201])
    assert is_kept(p, largest=0.2).tolist() == [False, True, True, False]


def test_a_reset_only_lowers_opacity():
    logits = torch.logit(torch.tensor([0.005, 0.01, 0.99]))
    torch.testing.assert_close(reset_opacity(logits).sigmoid(), torch.tensor([0.005, 0.01, 0.01]))


def test_the_timetable_is_the_papers_and_shrinks_with_the_run():
    paper = Timetable()
    assert [i for i in range(1, 30_001) if paper.densifies(i)] == list(range(600, 15_000, 100))
    assert [i for i in range(1, 30_001) if paper.resets(i)] == [3_000, 6_000, 9_000, 12_000]
    assert (paper.removes_large(3_000), paper.removes_large(3_100)) == (False, True)
    short = paper.scaled(0.1)
    assert short == Timetable(50, 1_500, 100, 750)
    assert [i for i in range(1, 3_001) if short.resets(i)] == [750]
    assert not Timetable(reset=None).removes_large(20_000)


@pytest.mark.parametrize("width", [48, 96])
def test_gradients_are_by_places_of_minus_one_to_one(width):
    """Against moving everything in the picture: twice the width, and a pixel is half as much of it."""
    camera = ring(1, size=48)[0]
    camera = replace(camera, width=width, cx=width / 2)
    g = coloured_cloud(1)
    absgrad, step = AbsGrad(), 0.02
    rgb, _ = parameters.render({n: p.requires_grad_() for n, p in from_gaussians(g).items()}, camera, 0, absgrad)
    weights = torch.linspace(-1, 1, width)[None, :, None]
    (rgb * weights).mean().backward()
    lengths, seen = absgrad.signed()
    shifted = [render(g, replace(camera, cx=camera.cx + d)).rgb * weights.numpy() for d in (-step, step)]
    slope = (shifted[1].mean(dtype=np.float64) - shifted[0].mean(dtype=np.float64)) / (2 * step / (width / 2))
    assert seen.tolist() == [True]
    assert float(lengths[0]) == pytest.approx(abs(slope), rel=0.02)


def test_splats_grow_where_the_gradient_is_and_are_refused_when_none_is_left():
    splats = Splats(coloured_cloud(3), 100.0, Timetable(0, 10, 1, None), seed=0)
    splats.watch().signed = lambda: (torch.tensor([0.0, 1e-3, 2e-4]), torch.tensor([True, True, True]))
    splats.step(1, 10)
    assert len(splats.gaussians()) == 5
    faint = replace(coloured_cloud(3), opacity_logits=np.full(3, -6.0, np.float32))
    splats = Splats(faint, 100.0, Timetable(0, 10, 1, None), seed=0)
    splats.watch().signed = lambda: (torch.zeros(3), torch.ones(3))
    with pytest.raises(TrainingError, match="no Gaussian"):
        splats.step(1, 10)


def test_every_frame_is_learnt_alone_and_costs_its_file(footage):
    method = Naive3dgs(iterations=150, sh_degree=1, points=60)
    frames = run_method(method, footage)
    assert [f.kind for f in frames] == ["key", "key"]
    for t, frame in enumerate(frames):
        path = frame_path(footage.folder, t)
        g = read_ply(path)
        assert (frame.bytes, frame.gaussians) == (path.stat().st_size, len(g))
        views, untrained = footage.pictures.train(t), replace(method, iterations=1).fit(footage, t, silent)
        assert mean_psnr(g, views) > mean_psnr(untrained, views) + 4
