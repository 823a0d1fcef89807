"""Clips: what is written comes back frame by frame from the libraries of others, rows that rest are written once."""

import subprocess
from dataclasses import replace

import fourdgs
import numpy as np
import pytest

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import SceneError
from airgs_codec.package.package import open_package
from airgs_codec.scene.formats import splat4d
from airgs_codec.scene.formats.form import Losses
from airgs_codec.scene.formats.fourdgs import FOUR_DGS
from airgs_codec.scene.formats.library import find_command
from airgs_codec.scene.formats.splat import read_splat
from airgs_codec.scene.formats.splat4d import SPLAT4D
from airgs_codec.scene.gaussians import SH_C0
from tests.support.paths import GOLDEN
from tests.support.scenes import moving_frames, random_gaussians

FPS = 24.0


@pytest.fixture(scope="module")
def fox():
    return [frame.gaussians for frame in decode_frames(open_package(GOLDEN / "fox"), 0, 4)]


def fitted(form, frames):
    losses = Losses(form.holds, form.name)
    return [losses.fit(g, f"frame {i}") for i, g in enumerate(frames)], losses


def shown(path, frame):
    """The records that a .4dgs shows in the middle of a frame, as fourdgs reads them."""
    scene = fourdgs.read(str(path))
    return scene, scene.gaussians.state_at((frame + 0.5) / FPS)["indices"]


def of_splat4d(path, frame):
    target = path.with_suffix(f".{frame}.splat")
    run = [find_command("splat4d"), "decode", str(path), "--frame", str(frame), "-o", str(target)]
    subprocess.run(run, check=True, capture_output=True)
    return read_splat(target)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_every_frame_of_4dgs_comes_back_within_its_bounds(tmp_path, fox, degree):
    frames, losses = fitted(
        FOUR_DGS, fox if degree == 1 else [random_gaussians(300, degree), random_gaussians(200, degree)]
    )
    FOUR_DGS.write(tmp_path / "a.4dgs", frames, FPS)
    for i, g in enumerate(frames):
        scene, rows = shown(tmp_path / "a.4dgs", i)
        g4 = scene.gaussians
        assert len(rows) == len(g) and scene.header.duration_sec == pytest.approx(len(frames) / FPS)
        median = np.median(np.exp(np.concatenate([f.log_scales for f in frames])))
        far = np.linalg.norm(g4.positions[rows][:, None] - g.means, axis=2)
        order = far.argmin(axis=1)
        assert len(set(order.tolist())) == len(g)
        g = g.take(order)
        assert np.abs(g4.positions[rows] - g.means).max() <= 0.02 * median * 1.2 + 1e-6  # of the records' own median
        assert np.abs(np.log(g4.scales[rows]) - g.log_scales).max() <= np.log(1.005) + 1e-5
        assert np.abs(g4.colors[rows, 3] - g.opacities()).max() <= 0.5 / 255 + 1e-6
        # green is coded, red and blue as differences of whole steps: half a step each
        assert np.abs(g4.colors[rows, :3] - (g.sh_dc * SH_C0 + 0.5)).max() <= 0.5 / 255 + 1e-5
        assert np.abs((g4.rotations[rows][:, [3, 0, 1, 2]] * g.quaternions).sum(axis=1)).min() > 1 - 1e-5
        assert g4.sh_degree == degree
        if degree:
            sh = np.asarray(g4.sh)[rows].reshape(len(g), 3, -1).transpose(0, 2, 1) / 255 * 8 - 4
            assert np.abs(sh - g.sh_rest).max() <= 4 / 255 + 1e-6
    assert any("which Gaussian is which is lost" in line for line in losses.lines())


def test_rows_that_rest_are_one_record_for_all_their_frames(tmp_path):
    g = fitted(FOUR_DGS, [random_gaussians(100)])[0][0]
    moved = replace(g, means=g.means + np.float32(0.5) * (np.arange(100) < 30)[:, None])
    FOUR_DGS.write(tmp_path / "a.4dgs", [g, g, moved, moved.take(slice(0, 40))], FPS)
    scene, _ = shown(tmp_path / "a.4dgs", 0)
    windows = np.round(np.stack([scene.gaussians.win_lo, scene.gaussians.win_hi], 1) * FPS).astype(int).tolist()
    assert sorted(map(tuple, windows)) == [(0, 2)] * 30 + [(0, 3)] * 70 + [(2, 3)] * 30 + [(3, 4)] * 40


def test_every_frame_of_splat4d_comes_back_within_its_bounds(tmp_path, fox):
    frames, losses = fitted(SPLAT4D, fox)
    SPLAT4D.write(tmp_path / "a.splat4d", frames, FPS)
    median = np.exp(np.median(frames[0].log_scales))
    orders = []
    for i, g in enumerate(frames):
        back = of_splat4d(tmp_path / "a.splat4d", i)
        orders.append(np.linalg.norm(back.means[:, None] - g.means, axis=2).argmin(axis=1))
        g = g.take(orders[-1])
        assert np.abs(back.means - g.means).max() <= 0.05 * median * 1.001 + 1e-6
        assert np.abs(back.log_scales - g.log_scales).max() <= np.log(1.02) + 1e-4
        assert np.abs((back.sh_dc - g.sh_dc) * SH_C0).max() <= 1.5 / 255 + 1e-5
        assert np.abs(back.opacities() - g.opacities()).max() <= 1.5 / 255 + 1e-5
    assert len(set(orders[0].tolist())) == len(fox[0]) and all((order == orders[0]).all() for order in orders)
    assert any("SH of degree 0 at most, of 1" in line for line in losses.lines())


def test_frames_of_fewer_rows_are_filled_with_what_nobody_sees(tmp_path):
    frames, losses = fitted(SPLAT4D, [random_gaussians(50, 0), random_gaussians(80, 0)])
    SPLAT4D.write(tmp_path / "a.splat4d", frames, FPS)
    first = of_splat4d(tmp_path / "a.splat4d", 0)
    assert len(first) == 80 and (first.opacities() < 0.5 / 255).sum() >= 30
    assert any("80 rows in every frame: the shorter end in some of alpha 0" in line for line in losses.lines())


@pytest.mark.parametrize("form", [FOUR_DGS, SPLAT4D], ids=lambda form: form.key)
def test_one_frame_is_a_clip_and_nothing_is_left_beside_it(tmp_path, form):
    form.write(tmp_path / f"a.{form.key}", fitted(form, moving_frames(30, 1))[0], FPS)
    assert [p.name for p in tmp_path.iterdir()] == [f"a.{form.key}"]


def test_what_the_command_says_is_the_reason(tmp_path, monkeypatch):
    program = tmp_path / "splat4d"
    program.write_text("#!/bin/sh\necho 'Error: no such thing' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr(splat4d, "find_command", lambda name: str(program))
    with pytest.raises(SceneError, match="cannot write 1 frames: Error: no such thing"):
        SPLAT4D.write(tmp_path / "a.splat4d", [random_gaussians(9, 0)], FPS)
    monkeypatch.setattr(splat4d, "find_command", lambda name: None)
    with pytest.raises(SceneError, match="need splats4d: pip install"):
        SPLAT4D.write(tmp_path / "a.splat4d", [random_gaussians(9, 0)], FPS)
    assert [p.name for p in tmp_path.iterdir()] == ["splat4d"]
