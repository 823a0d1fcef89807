"""3DGStream: what its cache does to Gaussians, that it follows a motion, what is sent, and going on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.errors import ConfigError
from airgs_codec.render import render
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.gaussians import Gaussians, from_rotation_vector, multiply, to_matrices
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.parameters import from_gaussians, to_gaussians
from tests.support.multiview_files import write_views
from tests.support.scenes import random_gaussians
from tests.support.training import SETTINGS
from tests.support.views import appeared, coloured_cloud, joined, ring
from tools.lab.baselines.hashgrid import FieldSettings
from tools.lab.baselines.method import Footage, frame_path, run_method
from tools.lab.baselines.stream3dgs import (
    TURN,
    Region,
    Stream3dgs,
    StreamSettings,
    apply_cache,
    decode,
    region_of,
    transformed,
)

CACHE = FieldSettings(levels=3, features=2, log2_table=8, coarsest=4, width=16)
OPTIONS = StreamSettings(
    replace(SETTINGS, first_iterations=60),
    CACHE,
    iterations=40,
    added_iterations=20,
    rate=3e-2,
    coarse=0.0,
    most_added=30,
)


@pytest.fixture(scope="module")
def blobs(tmp_path_factory):
    """A quarter of a ball turns by a tenth and moves; at frame 2 something comes into empty space."""
    g = coloured_cloud(120)
    frames = [_turned(g, 0.1 * t) for t in range(3)]
    frames[2] = joined(frames[2], appeared())
    folder = tmp_path_factory.mktemp("blobs")
    return write_views(folder, frames, ring(7, size=40, held_out=1), g.means)


def _turned(g: Gaussians, angle: float) -> Gaussians:
    turn = from_rotation_vector(np.array([0.0, angle, 0.0]))
    means = g.means @ to_matrices(turn).T + [0.0, angle, 0.0]
    return replace(g, means=np.where(g.means[:, :1] > 0.3, means, g.means).astype(np.float32))


def _footage(blobs, folder, frames):
    scene = open_scene(blobs, frames=(0, frames))
    return Footage(Pictures(scene), frames, scene.points, folder)


@pytest.fixture(scope="module")
def run(blobs, tmp_path_factory):
    footage = _footage(blobs, tmp_path_factory.mktemp("run"), 3)
    return footage, run_method(Stream3dgs(OPTIONS), footage)


def test_a_new_cache_changes_nothing():
    g = random_gaussians(50, 1)
    region = region_of(g, 1.0)
    assert len(region.rows(g)) == 50
    kept = apply_cache(g, region.new_cache(CACHE), region)
    for name in g.__slots__:
        np.testing.assert_array_equal(getattr(kept, name), getattr(g, name))


def test_rotations_are_composed_and_turn_what_is_seen():
    """A scene that its cache turns about the origin looks, from the turned camera, as it did."""
    g = random_gaussians(60, 1)
    g = replace(g, means=np.zeros_like(g.means), opacity_logits=np.linspace(-3, 0, 60).astype(np.float32))
    turn = from_rotation_vector(np.array([0.4, -0.3, 0.9]))
    changes = torch.zeros(60, 7, dtype=torch.float32)
    changes[:, 3:] = torch.from_numpy(((turn - [1, 0, 0, 0]) / TURN).astype(np.float32))
    turned = to_gaussians(transformed(from_gaussians(g), torch.arange(60), changes, 1.0))
    np.testing.assert_allclose(turned.quaternions, multiply(turn[None], g.quaternions), atol=1e-5)
    camera = ring(1, size=40)[0]
    pose = camera.world_to_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ to_matrices(turn).T
    np.testing.assert_allclose(
        render(turned, replace(camera, world_to_camera=pose)).rgb, render(g, camera).rgb, atol=1e-4
    )


def test_what_is_outside_the_box_rests():
    g = random_gaussians(80, 1)
    region = region_of(g, 0.8)
    rows = region.rows(g)
    assert 20 < len(rows) < 64
    cache = region.new_cache(CACHE)
    with torch.no_grad():
        cache.biases[-1].fill_(1.0)
    moved = apply_cache(g, cache, region)
    np.testing.assert_array_equal(np.flatnonzero((moved.means != g.means).any(axis=1)), rows)


def test_a_motion_is_followed_and_what_appears_is_added(run):
    footage, frames = run
    first = read_ply(frame_path(footage.folder, 0))
    for t in (1, 2):
        views = footage.pictures.held_out(t)
        shown = read_ply(frame_path(footage.folder, t))
        moved = shown.take(slice(len(first)))
        assert mean_psnr(moved, views) > mean_psnr(first, views) + 1.5
    assert frames[2].psnr > mean_psnr(moved, views) + 1.5
    assert frames[2].gaussians > len(first)
    assert frames[2].gaussians - len(first) <= OPTIONS.most_added


def test_bytes_are_those_of_what_a_viewer_decodes(run):
    footage, frames = run
    before = first = read_ply(frame_path(footage.folder, 0))
    region = region_of(first, OPTIONS.share)
    assert frames[0].bytes == frame_path(footage.folder, 0).stat().st_size
    cache = region.new_cache(CACHE).nbytes
    for t in (1, 2):
        data = frame_path(footage.folder, t).with_suffix(".stream").read_bytes()
        assert frames[t].bytes == len(data) == cache + 4 * 14 * (frames[t].gaussians - len(first))
        shown, kept = decode(before, data, CACHE, region), read_ply(frame_path(footage.folder, t))
        for name in shown.__slots__:
            np.testing.assert_array_equal(getattr(shown, name), getattr(kept, name))
        before = shown.take(slice(len(first)))


def test_data_that_is_cut_is_refused():
    g = random_gaussians(10, 1)
    region = Region(np.array([[-1.0] * 3, [1.0] * 3]))
    data = region.new_cache(CACHE).to_bytes()
    assert len(decode(g, data, CACHE, region)) == 10
    with pytest.raises(ConfigError, match="Gaussians of 92 bytes, got 5"):
        decode(g, data + bytes(5), CACHE, region)
    with pytest.raises(ConfigError, match="bytes of a field"):
        decode(g, data[:-2], CACHE, region)


def test_a_run_that_was_stopped_goes_on_the_same(run, blobs, tmp_path):
    footage, frames = run
    again = _footage(blobs, tmp_path, 3)
    write_ply(frame_path(tmp_path, 0), read_ply(frame_path(footage.folder, 0)))
    write_ply(frame_path(tmp_path, 1), read_ply(frame_path(footage.folder, 1)))
    (last,) = Stream3dgs(OPTIONS).frames(again, 2, lambda *_: None)
    assert last.bytes == frames[2].bytes
    kept = read_ply(frame_path(footage.folder, 2))
    for name in kept.__slots__:
        np.testing.assert_array_equal(getattr(last.gaussians, name), getattr(kept, name))
