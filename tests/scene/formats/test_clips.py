"""Files of many frames: what is baked from moving Gaussians, what libraries decode, what is refused, and an encode."""

import importlib.util
import itertools
import json
import pickle
import shutil
from fractions import Fraction

import fourdgs
import numpy as np
import pytest
from fourdgs.convert import convert_ply_sequence

from tests import faces
from tests.faces import SceneError, open_sequence, plan_groups, read_frame, sigmoid
from tests.support import clip_files
from tests.support.camera_files import PLACEHOLDER, as_inria, saved
from tests.support.effort import few_calls
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.views import ring

ROWS = clip_files.random_rows(20)


@pytest.fixture
def splatv(tmp_path):
    return saved(tmp_path / "a.splatv", clip_files.splatv_bytes(clip_files.random_rows(300)))


def test_a_gaussian_moves_turns_and_fades_as_its_row_says(tmp_path):
    rows = clip_files.random_rows(2)
    rows["mean"], rows["motion"] = (1, 2, 3), [(1, 0, 0), (0, 2, 0), (0, 0, 4)]
    rows["quaternion"], rows["turn"], rows["scale"] = (1, 0, 0, 0), (0, 2, 0, 0), (0, 1, 0.5)
    rows["centre"], rows["width"], rows["rgba"] = 0.25, 0.5, (255, 0, 51, 128)
    saved(tmp_path / "a.splatv", clip_files.splatv_bytes(rows))
    g = open_sequence(tmp_path / "a.splatv", bake_fps=4, duration=1).read(3)  # half of the clip after the centre
    assert g.means[1].tolist() == [1.5, 2.5, 3.5] and g.quaternions[1].tolist() == [1, 1, 0, 0]
    np.testing.assert_allclose(g.log_scales[1], [-np.inf, 0, np.log(0.5)], atol=1e-6)
    np.testing.assert_allclose(g.sh_dc[1] * faces.SH_C0 + 0.5, [1, 0, 0.2], atol=1e-6)
    assert sigmoid(g.opacity_logits)[1] == pytest.approx(128 / 255 / np.e, abs=1e-6)


def test_the_model_as_ply_gives_the_frames_of_its_splatv(tmp_path, splatv):
    clip_files.write_spacetime_ply(tmp_path / "a.ply", clip_files.random_rows(300))
    a, b = (open_sequence(tmp_path / name, bake_fps=12, duration=Fraction(1, 2)) for name in ("a.ply", "a.splatv"))
    assert len(a) == len(b) == 6 and (a.fps, a.sh_degree) == (12, 0)
    for frame, name in itertools.product((0, 5), a.read(0).__slots__):
        np.testing.assert_allclose(getattr(a.read(frame), name), getattr(b.read(frame), name), atol=2e-5)
    assert plan_groups(b, 4).spans == [(0, 3), (3, 6)]


def test_how_many_frames_is_said_and_the_clip_can_be_sent_to_a_worker(splatv):
    sequence = open_sequence(splatv)
    assert (len(sequence), sequence.fps) == (50, 30) and "by default" in sequence.clip.note
    slow = open_sequence(splatv, bake_fps=20, duration=0.5, fps=10)
    assert (len(slow), slow.fps) == (10, 10) and "10 frames at 20 a second: 0.5 s" in slow.clip.note
    packed = pickle.dumps(sequence)
    assert len(packed) < 3000
    np.testing.assert_array_equal(pickle.loads(packed).read(49).means, sequence.read(49).means)
    side = faces.open_side(str(splatv))
    assert (side.frames, side.fps) == (50, 30)
    assert side.bytes_per_frame == pytest.approx(splatv.stat().st_size / 50)


def test_frames_are_not_baked_and_clips_are_no_frames_and_the_full_model_is_refused(tmp_path, splatv):
    faces.write_ply(tmp_path / "b.ply", random_gaussians(5))
    with pytest.raises(SceneError, match=r"expected a clip to bake \(\.splatv.*got frames"):
        open_sequence(tmp_path / "b.ply", bake_fps=10)
    clip_files.write_spacetime_ply(tmp_path / "c.ply", ROWS)
    for path in (splatv, tmp_path / "c.ply"):
        with pytest.raises(SceneError, match="expected one frame"):
            faces.read_frame_header(path)
    with pytest.raises(SceneError, match=r"c\.ply: expected one frame"):
        open_sequence(tmp_path)
    for more in ("f_t_0", "f_dc_3"):
        with pytest.raises(SceneError, match="of a network"):
            open_sequence(clip_files.write_spacetime_ply(tmp_path / "d.ply", ROWS, more))


def test_its_own_cameras_are_taken_but_not_that_of_every_splatv_nor_rows_that_pad_the_texture(tmp_path):
    rig, padded = as_inria(ring(3)), np.concatenate([ROWS, np.zeros_like(ROWS[:6])])
    sequence = open_sequence(saved(tmp_path / "a.splatv", clip_files.splatv_bytes(padded, cameras=rig)))
    assert len(sequence.cameras) == 3 and sequence.cameras_path == tmp_path / "a.splatv"
    assert len(sequence.read(0)) == len(ROWS)
    saved(tmp_path / "cameras.json", rig[:2])
    of_all = clip_files.splatv_bytes(ROWS, cameras=[rig[0] | {"position": PLACEHOLDER}])
    sequence = open_sequence(saved(tmp_path / "b.splatv", of_all))
    assert len(sequence.cameras) == 2 and "into every file" in sequence.clip.note


def test_a_clip_is_encoded_and_says_how_it_was_baked(tmp_path, splatv, capsys):
    rows = clip_files.random_rows(300)
    rows["quaternion"][:7], rows["turn"][:7], rows["mean"][7] = 0, 0, np.nan
    splatv.write_bytes(clip_files.splatv_bytes(rows, cameras=as_inria(ring(3))))
    baking, out = ["--bake-fps", "8", "--duration", "0.5"], str(tmp_path / "out")
    options = ["--x264-preset", "ultrafast", "--calibrate", "none", "--measure-pictures", "2"]
    assert faces.airgs_encode([str(splatv), "-o", out, *baking, *options]) == 0
    told = capsys.readouterr().out
    assert f"clip: {splatv}: .splatv, 300 Gaussians baked to 4 frames at 8 a second: 0.5 s\n" in told
    assert "a.splatv frames 0-3: 7 Gaussians with zero quaternions" in told
    assert "1 Gaussians that are not finite" in told
    package = faces.open_package(out)
    assert (package.manifest.frames, package.manifest.fps) == (4, 8)
    assert np.isfinite(faces.decode(package, 3).means).all()
    assert faces.airgs_manifest(["validate", out, "--against", str(splatv), *baking]) == 0
    assert faces.airgs_manifest(["compare", str(splatv), out, *baking, "--every", "3", "--json"]) == 0
    compared = json.loads(capsys.readouterr().out.split("\n")[-2])
    assert compared["left_out"] == [] and compared["quality"]["psnr"] > 25
    assert faces.airgs_manifest(["compare", out, out, *baking]) == 2
    assert "expected a clip" in capsys.readouterr().err
    assert faces.airgs_encode([str(splatv), "--duration", "-3"]) == 2
    assert "1 to" in capsys.readouterr().err


def expect_close(found, expected, means=None, scales=0.021, alpha=4e-3, rotation=0.02):
    """Attributes within the bounds that the libraries keep, those of .4dgs by default; rows are the same."""
    assert len(found) == len(expected)
    most = 0.051 * float(np.median(np.exp(expected.log_scales))) if means is None else means
    np.testing.assert_allclose(found.means, expected.means, atol=most)
    np.testing.assert_allclose(found.log_scales, expected.log_scales, atol=scales)
    np.testing.assert_allclose(sigmoid(found.opacity_logits), expected.opacities(), atol=alpha)
    colours = [np.clip(g.sh_dc * faces.SH_C0 + 0.5, 0, 1) for g in (found, expected)]
    np.testing.assert_allclose(*colours, atol=alpha)
    a, b = (g.quaternions.astype(np.float64) for g in (found, expected))
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b))
    assert 2 * np.arccos(np.clip(np.abs((a * b).sum(axis=1)), 0, 1)).max() < rotation


def test_splat4d_frames_are_within_the_bounds_of_its_writer(tmp_path):
    frames = moving_frames(300, 5)
    order = clip_files.write_splat4d(tmp_path / "a.splat4d", frames, fps=24)
    sequence = open_sequence(tmp_path / "a.splat4d")
    assert (len(sequence), sequence.fps, sequence.sh_degree) == (5, 24, 0)
    assert "300 Gaussians in 5 frames, 24 a second" in sequence.clip.note
    for number in (4, 0):
        stored = read_frame(tmp_path / "a" / f"frame_{number:04d}.splat").take(order.astype(np.intp))
        expect_close(sequence.read(number), stored, 2.1e-3, alpha=0.016, rotation=1e-3)
    assert plan_groups(sequence).spans == [(0, 5)]


def test_numbered_4dgs_rows_are_in_the_order_of_their_numbers(tmp_path):
    frames, chance = moving_frames(100, 6), np.random.default_rng(0)
    orders = [chance.permutation(100) for _ in frames]
    states = [(g.take(order), order) for g, order in zip(frames, orders, strict=True)]
    path = saved(tmp_path / "a.4dgs", clip_files.numbered_4dgs(states, fps=12))
    sequence, twice = open_sequence(path), open_sequence(path, bake_fps=24)
    assert (len(sequence), sequence.fps, len(twice)) == (6, 12, 12)
    for number in range(6):
        expect_close(sequence.read(number), frames[number])
    sent = pickle.loads(pickle.dumps(twice))  # as other processes read it
    np.testing.assert_array_equal(sent.read(5).means, sequence.read(2).means)


def moving_set():
    """Three windows of a second each for 20 rows, and rows that are there all the time; some fade."""
    g = random_gaussians(80)
    clip = clip_files.gaussian_set(g, 3.0, np.arange(80 * 9, dtype=np.int64).reshape(80, 9).astype(np.uint8))
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
        given = g.take(((g.means[None] - found.means[:, None]) ** 2).sum(axis=2).argmin(axis=1))
        expect_close(found, given)
        np.testing.assert_allclose(found.sh_rest, given.sh_rest, atol=0.02)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    frames = moving_frames(40, 3)
    saved(folder / "a.splatv", clip_files.splatv_bytes(ROWS))
    clip_files.write_splat4d(folder / "a.splat4d", frames, fps=24)
    saved(folder / "a.4dgs", clip_files.numbered_4dgs([(g, np.arange(40)) for g in frames], fps=24))
    fourdgs.write(str(folder / "b.4dgs"), moving_set(), 3.0)
    return folder


def swap(old, new):
    """A change of bytes; the length that stands before the header of a .splat4d is made to agree."""

    def change(data):
        assert old in data
        changed = data.replace(old, new, 1)
        if changed[:2] != b"SP":
            return changed
        length = int.from_bytes(changed[8:12], "little") + len(new) - len(old)
        return changed[:8] + length.to_bytes(4, "little") + changed[12:]

    return change


def other(rows=ROWS, **chunk):
    return lambda data: clip_files.splatv_bytes(rows, **chunk)


RATES = (b'"1/0"', b'"1e30000000"', b'"fast"', b"0", b"2000", b"null")
REFUSED = [  # a file, options, what is changed of it
    ("a.splatv", {}, lambda data: b"", "expected a .splatv"),
    ("a.splatv", {}, lambda data: data[: -64 * 8], "truncated"),
    ("a.splatv", {}, lambda data: data[:-1], "truncated"),
    ("a.splatv", {}, other(np.zeros_like(ROWS)), "rows of zeros"),
    ("a.splatv", {}, other(texwidth=1 << 62), "truncated"),
    ("a.splatv", {}, other(texwidth="4096"), "expected a .splatv"),
    ("a.splatv", {}, other(type="other"), "one chunk"),
    ("a.splatv", {}, lambda data: data[:4] + b"\xff\xff\xff\xff" + data[8:], "header"),
    ("a.splatv", {"bake_fps": 0}, bytes, "0 < fps"),
    *(("a.splatv", {"duration": seconds}, bytes, "1 to") for seconds in (0, 10**9, -1)),
    ("a.splat4d", {"bake_fps": 3}, bytes, r"a\.splat4d: expected no"),
    *((name, {"duration": 1}, bytes, rf"{name}: expected no") for name in ("a.splat4d", "a.4dgs")),
    ("a.splat4d", {}, swap(b"SP4D", b"SP5D"), "expected a .splat4d header"),
    ("a.splat4d", {}, swap(b"SP4D\x01", b"SP4D\x02"), "of version 2"),
    ("a.splat4d", {}, swap(b'"n":40,', b'"n":4e9,'), "expected a .splat4d header"),
    ("a.splat4d", {}, swap(b'"n":40,"t"', b'"n":99999999,"t"'), "can hold"),
    ("a.splat4d", {}, swap(b'"fps":24.0', b'"fps":-4.0'), "fps"),
    ("a.splat4d", {}, swap(b'"fps":24.0', b'"fps":"1e99999999"'), "expected a .splat4d header"),
    *(("a.splat4d", {}, swap(b'"fps":24.0', b'"fps":' + value), r"a\.splat4d: expected") for value in RATES),
    ("a.4dgs", {}, swap(b"\x894DGS", b"\x894DGT"), "what fourdgs cannot read"),
    ("a.4dgs", {}, swap(np.float64(0.125).tobytes(), np.float64(1e300).tobytes()), "1 to 262144 frames"),
    ("b.4dgs", {}, swap(b"gaussian-birth", b"gaussian-death"), "gaussian-death"),
]


@pytest.mark.parametrize(("name", "options", "change", "says"), REFUSED)
def test_what_is_no_clip_and_a_choice_that_is_none_are_refused_at_once(tmp_path, good, name, options, change, says):
    path = saved(tmp_path / name, change((good / name).read_bytes()))
    with few_calls(20_000 if name == "a.splatv" else 200_000), pytest.raises(SceneError, match=says) as caught:
        open_sequence(path, **options)
    assert "\n" not in str(caught.value) and str(caught.value).count(name) == 1


def test_a_missing_library_and_an_empty_file_are_said(tmp_path, good, monkeypatch):
    for name in ("a.splat4d", "a.4dgs", "b.4dgs"):
        with pytest.raises(SceneError, match=f"{name}: expected .*4d"):
            open_sequence(saved(tmp_path / name, b""))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(shutil, "which", lambda name, path: None)
    for name in ("a.splat4d", "a.4dgs", "b.4dgs"):
        with pytest.raises(SceneError, match=r"airgs-codec\[formats\]"):
            open_sequence(good / name).read(0)
