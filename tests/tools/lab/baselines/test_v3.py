"""V^3: what its losses are, that frames learn to move, what is shown is what was paid for, stopped runs go on."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import norm

from airgs_codec.errors import ConfigError
from airgs_codec.progress import silent
from airgs_codec.scene.formats.ply import read_ply
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.parameters import from_gaussians
from airgs_codec.trainer.fit.trainer import FrameViews, make_trainer
from airgs_codec.trainer.settings import TrainSettings
from tests.support.scenes import random_gaussians
from tests.support.training import write_blobs
from tests.support.views import coloured_cloud
from tools.lab.baselines.method import Footage, frame_path, run_method
from tools.lab.baselines.v3 import V3, ResidualLoss, V3Settings, estimated_bits, fit_frame, fit_key
from tools.lab.rd.layouts import v3_layout

SMALL = V3Settings(
    group_frames=2, rows=150, sh_degree=0, key_iterations=120, finetune_iterations=40, field_iterations=20,
    frame_iterations=40, qp=14,
)  # fmt: skip


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return open_scene(write_blobs(tmp_path_factory.mktemp("v3") / "blobs"), frames=(0, 3))


def _footage(scene, folder):
    return Footage(Pictures(scene), len(scene), scene.points, folder)


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory):
    """Three frames in groups of two, in one go."""
    footage = _footage(scene, tmp_path_factory.mktemp("v3") / "whole")
    return footage, run_method(V3(SMALL), footage)


def test_a_frame_learns_to_move(scene):
    pictures, before = Pictures(scene), coloured_cloud(120)
    trainer = make_trainer(TrainSettings(), pictures.train(0), None, "cpu")
    after = fit_frame(trainer, FrameViews(2, pictures.train(2)), before, SMALL, silent)
    unmoved, fitted = (mean_psnr(g, pictures.held_out(2)) for g in (before, after))
    assert fitted > unmoved + 3
    assert len(after) == len(before)


def test_a_field_alone_moves_means_alone(scene):
    pictures, before = Pictures(scene), coloured_cloud(120)
    trainer = make_trainer(TrainSettings(), pictures.train(0), None, "cpu")
    target = FrameViews(2, pictures.train(2))
    after = fit_frame(trainer, target, before, replace(SMALL, field_iterations=60, frame_iterations=0), silent)
    assert mean_psnr(after, pictures.held_out(2)) > mean_psnr(before, pictures.held_out(2)) + 1
    for name in ("quaternions", "log_scales", "opacity_logits", "sh_dc"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_a_keyframe_is_pruned_to_its_rows(scene):
    footage = _footage(scene, None)
    trainer = make_trainer(SMALL.training(), footage.pictures.train(0), scene.points, "cpu")
    g = fit_key(trainer, FrameViews(0, footage.pictures.train(0)), footage, SMALL, silent)
    assert 30 <= len(g) <= SMALL.rows
    assert mean_psnr(g, footage.pictures.held_out(0)) > 18


def test_groups_begin_with_keyframes_of_their_own(finished):
    footage, frames = finished
    assert [frame.kind for frame in frames] == ["key", "frame", "key"]
    assert frames[0].gaussians == frames[1].gaussians
    assert frames[0].bytes > frames[1].bytes > 0
    assert not (footage.folder / "group").exists()


def test_what_is_shown_is_what_its_bytes_decode_to(scene, tmp_path):
    footage = _footage(scene, tmp_path)
    shown = list(itertools.islice(V3(SMALL).frames(footage, 0, silent), 2))
    trained = [read_ply(tmp_path / "group" / f"{t:06d}.ply") for t in range(2)]
    coded = v3_layout(trained, SMALL.qp, SMALL.preset, SMALL.form)
    assert [frame.bytes for frame in shown] == coded.frame_bytes
    for frame, decoded, given in zip(shown, coded.frames, trained, strict=True):
        for name in ("means", "log_scales", "opacity_logits", "sh_dc"):
            np.testing.assert_array_equal(getattr(frame.gaussians, name), getattr(decoded, name))
        assert not np.array_equal(frame.gaussians.means, given.means)


@pytest.mark.parametrize("stage", ["frame 1 of 3 (fine-tuning)", "frame 2 of 3 (after pruning)"])
def test_a_stopped_run_goes_on_the_same(scene, finished, tmp_path, stage):
    whole, frames = finished
    footage, seen = _footage(scene, tmp_path), []

    def stop(name, done, total):
        if name == stage:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_method(V3(SMALL), footage, stop)
    again = run_method(V3(SMALL), footage, lambda name, done, total: seen.append(name))
    assert not any(name.startswith("frame 0") for name in seen)
    assert [replace(frame, seconds=0) for frame in again] == [replace(frame, seconds=0) for frame in frames]
    for t in range(3):
        assert frame_path(tmp_path, t).read_bytes() == frame_path(whole.folder, t).read_bytes()


def test_a_group_that_is_half_given_is_coded_again(scene, finished, tmp_path):
    """Killed after one frame of a coded group: the other one comes from the same videos."""
    whole, frames = finished
    footage = _footage(scene, tmp_path)
    next(V3(SMALL).frames(footage, 0, silent))
    rest = list(V3(SMALL).frames(footage, 1, silent))
    assert [frame.bytes for frame in rest] == [frame.bytes for frame in frames[1:]]
    np.testing.assert_array_equal(rest[0].gaussians.means, read_ply(frame_path(whole.folder, 1)).means)


def _samples(rows=40, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal([0, 3, -20], [0.4, 2, 50], (rows, 3)) + rng.uniform(-0.5, 0.5, (rows, 3))


def test_bits_are_those_of_a_normal_distribution():
    samples, expected = _samples(), 0.0
    for column in samples.T:
        mean, deviation = column.mean(), np.sqrt(column.var() + 1e-6)
        p = [norm.cdf((x + 0.5 - mean) / deviation) - norm.cdf((x - 0.5 - mean) / deviation) for x in column]
        expected += np.mean(-np.log2(p))
    assert float(estimated_bits(torch.from_numpy(samples))) == pytest.approx(expected, rel=1e-9)
    assert float(estimated_bits(torch.from_numpy(samples).float())) == pytest.approx(expected, rel=1e-4)


def test_gradient_of_bits_is_that_of_finite_differences():
    samples = torch.from_numpy(_samples()).requires_grad_()
    assert torch.autograd.gradcheck(estimated_bits, (samples,), eps=1e-6, atol=1e-8, rtol=1e-5)


def test_bits_of_what_is_far_from_all_others_are_finite():
    samples = torch.zeros(5000, 1)
    samples[0] = 1e4
    samples.requires_grad_()
    bits = estimated_bits(samples)
    bits.backward()
    assert torch.isfinite(bits) and torch.isfinite(samples.grad).all()
    assert torch.isfinite(estimated_bits(torch.ones(1, 2)))


def test_losses_hold_scales_rotations_and_opacities():
    before = from_gaussians(random_gaussians(300, 1))
    residual = {name: torch.zeros_like(value) for name, value in before.items()}
    temporal = ResidualLoss(before, 2.0, 0.0, seed=0)
    assert float(temporal(residual)) == 0
    residual["means"] += 1
    residual["sh_rest"] += 1
    assert float(temporal(residual)) == 0
    residual["log_scales"] += 0.1
    residual["opacity_logits"] += 0.5
    assert float(temporal(residual)) == pytest.approx(2 * (0.01 + 0.25), rel=1e-5)


def test_less_spread_costs_fewer_bits_whatever_the_noise():
    before = from_gaussians(random_gaussians(300, 1))
    spread = {name: 0.2 * torch.randn(value.shape, generator=torch.manual_seed(0)) for name, value in before.items()}
    halved = {name: value / 2 for name, value in spread.items()}
    losses = [float(ResidualLoss(before, 0.0, 1.0, seed)(r)) for seed in (0, 1) for r in (spread, halved)]
    assert losses[0] > losses[1] + 2 and losses[2] > losses[3] + 2
    assert losses[0] == float(ResidualLoss(before, 0.0, 1.0, 0)(spread)) != losses[2]


def test_settings_that_cannot_work_are_refused():
    with pytest.raises(ConfigError, match="prune"):
        V3Settings(pruned=1.0)
