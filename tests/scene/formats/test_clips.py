"""Files of many frames: what is baked from moving Gaussians, what is refused, how an encode goes through."""

import json
import pickle
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.scene.cameras.forms import PLACEHOLDER
from airgs_codec.scene.gaussians import SATURATED_LOGIT, logits_of
from tests.faces import (
    SH_C0,
    SceneError,
    airgs_encode,
    airgs_manifest,
    decode,
    open_package,
    open_sequence,
    open_side,
    read_frame_header,
    sigmoid,
    write_ply,
)
from tests.support.camera_files import as_inria
from tests.support.clip_files import random_rows, splatv_bytes, write_spacetime_ply
from tests.support.effort import few_calls
from tests.support.scenes import random_gaussians
from tests.support.views import ring


@pytest.fixture
def splatv(tmp_path):
    path = tmp_path / "a.splatv"
    path.write_bytes(splatv_bytes(random_rows(300)))
    return path


def test_a_gaussian_moves_turns_and_fades_as_its_row_says(tmp_path):
    rows = random_rows(2)
    rows["mean"], rows["motion"] = (1, 2, 3), [(1, 0, 0), (0, 2, 0), (0, 0, 4)]
    rows["quaternion"], rows["turn"], rows["scale"] = (1, 0, 0, 0), (0, 2, 0, 0), (0, 1, 0.5)
    rows["centre"], rows["width"], rows["rgba"] = 0.25, 0.5, (255, 0, 51, 128)
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(rows))
    g = open_sequence(tmp_path / "a.splatv", bake_fps=4, duration=1).read(3)  # half of the clip after the centre
    assert g.means[1].tolist() == [1.5, 2.5, 3.5] and g.quaternions[1].tolist() == [1, 1, 0, 0]
    np.testing.assert_allclose(g.log_scales[1], [-np.inf, 0, np.log(0.5)], atol=1e-6)
    np.testing.assert_allclose(g.sh_dc[1] * SH_C0 + 0.5, [1, 0, 0.2], atol=1e-6)
    assert sigmoid(g.opacity_logits)[1] == pytest.approx(128 / 255 / np.e, abs=1e-6)


def test_opacities_of_0_and_1_are_finite_and_none_is_made_up():
    assert logits_of(np.array([0.0, 1, 0.5])).tolist() == [-SATURATED_LOGIT, SATURATED_LOGIT, 0]
    assert np.isnan(logits_of(np.array([np.nan]))).all()


def test_the_model_as_ply_gives_the_frames_of_its_splatv(tmp_path, splatv):
    write_spacetime_ply(tmp_path / "a.ply", random_rows(300))
    a, b = (open_sequence(tmp_path / name, bake_fps=12, duration=Fraction(1, 2)) for name in ("a.ply", "a.splatv"))
    assert len(a) == len(b) == 6 and (a.fps, a.sh_degree) == (12, 0)
    for frame in (0, 5):
        for name in a.read(0).__slots__:
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
    side = open_side(str(splatv))
    assert (side.frames, side.fps) == (50, 30)
    assert side.bytes_per_frame == pytest.approx(splatv.stat().st_size / 50)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"bake_fps": 0}, "0 < fps"),
        ({"duration": 0}, "1 to"),
        ({"duration": 10**9}, "1 to"),
        ({"duration": -1}, "1 to"),
    ],
)
def test_a_clip_without_frames_or_without_end_is_refused(splatv, options, says):
    with pytest.raises(SceneError, match=says):
        open_sequence(splatv, **options)


def test_frames_are_not_baked_and_clips_are_no_frames(tmp_path, splatv):
    write_ply(tmp_path / "b.ply", random_gaussians(5))
    with pytest.raises(SceneError, match=r"expected a clip to bake \(\.splatv.*got frames"):
        open_sequence(tmp_path / "b.ply", bake_fps=10)
    write_spacetime_ply(tmp_path / "c.ply", random_rows(5))
    for path in (splatv, tmp_path / "c.ply"):
        with pytest.raises(SceneError, match="expected one frame"):
            read_frame_header(path)
    with pytest.raises(SceneError, match=r"c\.ply: expected one frame"):
        open_sequence(tmp_path)


def test_its_own_cameras_are_taken_but_not_that_of_every_splatv(tmp_path):
    rig = as_inria(ring(3))
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(random_rows(5), cameras=rig))
    sequence = open_sequence(tmp_path / "a.splatv")
    assert len(sequence.cameras) == 3 and sequence.cameras_path == tmp_path / "a.splatv"
    (tmp_path / "cameras.json").write_text(json.dumps(rig[:2]))
    (tmp_path / "b.splatv").write_bytes(splatv_bytes(random_rows(5), cameras=[rig[0] | {"position": PLACEHOLDER}]))
    sequence = open_sequence(tmp_path / "b.splatv")
    assert len(sequence.cameras) == 2 and "into every file" in sequence.clip.note


def test_rows_that_pad_the_texture_are_left_out(tmp_path):
    rows = np.concatenate([random_rows(10), np.zeros(6, random_rows(1).dtype)])
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(rows))
    assert len(open_sequence(tmp_path / "a.splatv").read(0)) == 10


def broken_files():
    rows = random_rows(20)
    good = splatv_bytes(rows)
    yield "empty", b"", "expected a .splatv"
    yield "short", good[: -64 * 8], "truncated"
    yield "odd", good[:-1], "truncated"
    yield "zeros", splatv_bytes(np.zeros_like(rows)), "rows of zeros"
    yield "wide", splatv_bytes(rows, texwidth=1 << 62), "truncated"
    yield "text", splatv_bytes(rows, texwidth="4096"), "at least 1"
    yield "none", splatv_bytes(rows, type="other"), "one chunk"
    yield "long", good[:4] + b"\xff\xff\xff\xff" + good[8:], "header"


@pytest.mark.parametrize(("name", "data", "says"), list(broken_files()), ids=lambda v: v if isinstance(v, str) else "")
def test_a_broken_splatv_is_refused(tmp_path, name, data, says):
    (tmp_path / f"{name}.splatv").write_bytes(data)
    with few_calls(20_000), pytest.raises(SceneError, match=says) as caught:
        open_sequence(tmp_path / f"{name}.splatv")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("more", "says"), [(("f_t_0",), "of a network"), (("f_dc_3",), "of a network")])
def test_the_full_model_is_refused(tmp_path, more, says):
    with pytest.raises(SceneError, match=says):
        open_sequence(write_spacetime_ply(tmp_path / "a.ply", random_rows(5), *more))


def test_a_clip_is_encoded_and_says_how_it_was_baked(tmp_path, splatv, capsys):
    rows = random_rows(300)
    rows["quaternion"][:7], rows["turn"][:7], rows["mean"][7] = 0, 0, np.nan
    splatv.write_bytes(splatv_bytes(rows, cameras=as_inria(ring(3))))
    options = ["--bake-fps", "8", "--duration", "0.5", "--x264-preset", "ultrafast", "--calibrate", "none"]
    assert airgs_encode([str(splatv), "-o", str(tmp_path / "out"), *options, "--measure-pictures", "2"]) == 0
    out = capsys.readouterr().out
    assert f"clip: {splatv}: .splatv, 300 Gaussians baked to 4 frames at 8 a second: 0.5 s\n" in out
    assert "a.splatv frames 0-3: 7 Gaussians with zero quaternions" in out and "1 Gaussians that are not finite" in out
    package = open_package(tmp_path / "out")
    assert (package.manifest.frames, package.manifest.fps) == (4, 8)
    assert np.isfinite(decode(package, 3).means).all()
    baking = ["--bake-fps", "8", "--duration", "0.5"]
    assert airgs_manifest(["validate", str(tmp_path / "out"), "--against", str(splatv), *baking]) == 0
    assert airgs_manifest(["compare", str(splatv), str(tmp_path / "out"), *baking, "--every", "3", "--json"]) == 0
    compared = json.loads(capsys.readouterr().out.split("\n")[-2])
    assert compared["left_out"] == [] and compared["quality"]["psnr"] > 25
    assert airgs_manifest(["compare", str(tmp_path / "out"), str(tmp_path / "out"), *baking]) == 2
    assert "expected a clip" in capsys.readouterr().err
    assert airgs_encode([str(splatv), "--duration", "-3"]) == 2
    assert "1 to" in capsys.readouterr().err
