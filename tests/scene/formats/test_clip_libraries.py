"""Clips that libraries read in processes of their own: .4dgs and .splat4d are what was written, or refused."""

import importlib.util
import json
import pickle
import shutil
import struct

import fourdgs
import numpy as np
import pytest
from fourdgs.convert import convert_ply_sequence

from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.scene.formats.splat import read_splat
from tests.faces import SH_C0, SceneError, open_sequence, sigmoid
from tests.support.clip_files import gaussian_set, numbered_4dgs, write_splat4d
from tests.support.effort import few_calls
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

BOUND = 0.051  # of the median size: how far .4dgs may move a mean


def bound(g):
    return BOUND * float(np.median(np.exp(g.log_scales)))


def expect_close(found, expected, means, scales=0.021, alpha=4e-3, rotation=0.02):
    """Attributes within the bounds that the libraries keep; rows are the same."""
    assert len(found) == len(expected)
    np.testing.assert_allclose(found.means, expected.means, atol=means)
    np.testing.assert_allclose(found.log_scales, expected.log_scales, atol=scales)
    np.testing.assert_allclose(sigmoid(found.opacity_logits), expected.opacities(), atol=alpha)
    colours = [np.clip(g.sh_dc * SH_C0 + 0.5, 0, 1) for g in (found, expected)]
    np.testing.assert_allclose(*colours, atol=alpha)
    a, b = (g.quaternions.astype(np.float64) for g in (found, expected))
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b))
    assert 2 * np.arccos(np.clip(np.abs((a * b).sum(axis=1)), 0, 1)).max() < rotation


def test_splat4d_frames_are_within_the_bounds_of_its_writer(tmp_path):
    frames = moving_frames(300, 5)
    order = write_splat4d(tmp_path / "a.splat4d", frames, fps=24)
    sequence = open_sequence(tmp_path / "a.splat4d")
    assert (len(sequence), sequence.fps, sequence.sh_degree) == (5, 24, 0)
    assert "300 Gaussians in 5 frames, 24 a second" in sequence.clip.note
    for number in (4, 0):
        stored = read_splat(tmp_path / "a" / f"frame_{number:04d}.splat")
        expect_close(sequence.read(number), stored.take(order.astype(np.intp)), 2.1e-3, alpha=0.016, rotation=1e-3)
    assert plan_groups(sequence).spans == [(0, 5)]


def test_numbered_4dgs_rows_are_in_the_order_of_their_numbers(tmp_path):
    frames, chance = moving_frames(100, 6), np.random.default_rng(0)
    orders = [chance.permutation(100) for _ in frames]
    states = [(g.take(order), order) for g, order in zip(frames, orders, strict=True)]
    (tmp_path / "a.4dgs").write_bytes(numbered_4dgs(states, fps=12))
    sequence = open_sequence(tmp_path / "a.4dgs")
    assert (len(sequence), sequence.fps) == (6, 12)
    for number in range(6):
        expect_close(sequence.read(number), frames[number], bound(frames[0]))
    twice = open_sequence(tmp_path / "a.4dgs", bake_fps=24)
    assert len(twice) == 12
    sent = pickle.loads(pickle.dumps(twice))  # as other processes read it
    np.testing.assert_array_equal(sent.read(5).means, sequence.read(2).means)


def moving_set():
    """Three windows of a second each for 20 rows, and rows that are there all the time; some fade."""
    g = random_gaussians(80)
    clip = gaussian_set(g, 3.0, np.arange(80 * 9, dtype=np.int64).reshape(80, 9).astype(np.uint8))
    window = np.minimum(np.arange(80) // 20, 3)
    clip.win_lo, clip.win_hi = np.where(window < 3, window, 0.0), np.where(window < 3, window + 1.0, 3.0)
    clip.mu_t = (clip.win_lo + 0.5).astype(np.float32)
    clip.sigma_t = np.where(np.arange(80) % 2, np.inf, 0.25).astype(np.float32)
    clip.colors[:, 3] = np.maximum(clip.colors[:, 3], 0.3)
    clip.motions = np.random.default_rng(1).normal(size=(80, 3)).astype(np.float32)
    return clip


def test_a_4dgs_shows_what_its_library_does(tmp_path):
    fourdgs.write(str(tmp_path / "a.4dgs"), moving_set(), 3.0)
    sequence = open_sequence(tmp_path / "a.4dgs", bake_fps=10)
    assert (len(sequence), sequence.sh_degree) == (30, 1)
    scene = fourdgs.read(str(tmp_path / "a.4dgs"))
    for number in (0, 14, 15, 29):
        g, state = sequence.read(number), scene.state_at((number + 0.5) / 10)
        assert len(g) == len(state["indices"])
        np.testing.assert_allclose(g.means, state["centers"], atol=1e-6)
        np.testing.assert_allclose(sigmoid(g.opacity_logits), state["opacity"], atol=1e-3)
        codes = scene.gaussians.sh[state["indices"]].reshape(-1, 3, 3).transpose(0, 2, 1)
        np.testing.assert_allclose(g.sh_rest, codes * (8 / 255) - 4, atol=1e-5)


def test_a_converted_sequence_has_its_frames_whole(tmp_path):
    frames = moving_frames(60, 4, degree=1)
    clip, seconds = convert_ply_sequence(str(write_sequence(tmp_path / "scene", frames)), fps=25)
    fourdgs.write(str(tmp_path / "a.4dgs"), clip, seconds)
    sequence = open_sequence(tmp_path / "a.4dgs")
    assert (len(sequence), sequence.fps, sequence.sh_degree) == (4, 25, 1)
    for number, g in enumerate(frames):
        found = sequence.read(number)
        order = ((g.means[None] - found.means[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        expect_close(found, g.take(order), bound(g))
        np.testing.assert_allclose(found.sh_rest, g.take(order).sh_rest, atol=0.02)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    frames = moving_frames(40, 3)
    write_splat4d(folder / "a.splat4d", frames, fps=24)
    (folder / "a.4dgs").write_bytes(numbered_4dgs([(g, np.arange(40)) for g in frames], fps=24))
    fourdgs.write(str(folder / "b.4dgs"), moving_set(), 3.0)
    return folder


def test_what_leaves_no_choice_is_not_baked(good):
    for name, options in (("a.splat4d", {"bake_fps": 3}), ("a.splat4d", {"duration": 1}), ("a.4dgs", {"duration": 1})):
        with pytest.raises(SceneError, match=f"{name}: expected no"):
            open_sequence(good / name, **options)


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("a.splat4d", b"SP4D", b"SP5D", "expected a .splat4d header"),
        ("a.splat4d", b"SP4D\x01", b"SP4D\x02", "of version 2"),
        ("a.splat4d", b'"n":40,', b'"n":4e9,', "expected a .splat4d header"),
        ("a.splat4d", b'"n":40,"t"', b'"n":99999999,"t"', "can hold"),
        ("a.splat4d", b'"fps":24.0', b'"fps":-4.0', "fps"),
        ("a.splat4d", b'"fps":24.0', b'"fps":"1e99999999"', "expected a .splat4d header"),
        ("a.4dgs", b"\x894DGS", b"\x894DGT", "what fourdgs cannot read"),
        ("a.4dgs", np.float64(0.125).tobytes(), np.float64(1e300).tobytes(), "1 to 262144 frames"),
        ("b.4dgs", b"gaussian-birth", b"gaussian-death", "gaussian-death"),
    ],
)
def test_a_header_that_cannot_be_is_refused(tmp_path, good, name, old, new, says):
    data = (good / name).read_bytes()
    assert old in data
    data = data.replace(old, new, 1)
    if name.endswith(".splat4d"):
        data = data[:8] + (int.from_bytes(data[8:12], "little") + len(new) - len(old)).to_bytes(4, "little") + data[12:]
    (tmp_path / name).write_bytes(data)
    with few_calls(200_000), pytest.raises(SceneError, match=says) as caught:
        open_sequence(tmp_path / name)
    assert "\n" not in str(caught.value) and str(caught.value).count(name) == 1


@pytest.mark.parametrize("name", ["a.splat4d", "a.4dgs", "b.4dgs"])
def test_a_missing_library_and_an_empty_file_are_said(tmp_path, good, name, monkeypatch):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(SceneError, match=f"{name}: expected .*4d"):
        open_sequence(tmp_path / name)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(shutil, "which", lambda name, path: None)
    with pytest.raises(SceneError, match=r"airgs-codec\[formats\]"):
        open_sequence(good / name).read(0)


@pytest.mark.parametrize("fps", ["1/0", "1e30000000", "fast", 0, 2000, None])
def test_a_splat4d_whose_frame_rate_is_none_is_refused_at_once(tmp_path, fps):
    header = json.dumps({"n": 5, "t": 1, "fps": fps}).encode()
    (tmp_path / "a.splat4d").write_bytes(struct.pack("<4sII", b"SP4D", 1, len(header)) + header)
    with pytest.raises(SceneError, match=r"a\.splat4d: expected"):
        open_sequence(tmp_path / "a.splat4d")
