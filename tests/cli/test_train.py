"""airgs-train, and airgs-encode of multi-view scenes."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests import faces
from tests.support.training import SETTINGS

QUICK = ["--iterations", "30,20,8", "--budget", "150", "--sh-degree", "0", "--device", "cpu"]
MEAN = "mean over views of the PSNR of each, in dB"  # packages pool the squared error of all views instead


def test_airgs_train_says_what_it_did_reports_and_goes_on_as_it_began(blobs, tmp_path, capsys):
    late, other, pages = (tmp_path / name for name in ("late.json", "other.json", "r"))
    late.write_text('{"cam01": 1, "cam02": -0.5}')
    other.write_text('{"cam01": 1, "cam02": -1}')
    words = [str(blobs), "-o", str(tmp_path / "m"), "--report", str(pages), "--min-psnr", "99", *QUICK]
    assert faces.airgs_train([*words, "--sync", str(late)]) == 0
    out, err = capsys.readouterr()
    assert f"{tmp_path / 'm'}: will take about " in err and " s and 0." in err
    assert f"{blobs}: 3 frames of 40x40, 6 training cameras and 1 held out\n" in out
    assert "first frame" in out and "held-out" in out and "dB (mean over views and frames)" in out
    assert out.count("\nframe") == 3  # of 5: from frame 1, and cam01 has no frame 5
    (warned,) = (line for line in err.splitlines() if line.startswith("warning: "))
    assert warned.startswith("warning: frame 0: ") and "no fit reaches the 99 dB of --min-psnr" in warned
    assert {path.name for path in pages.iterdir()} >= {"index.html", "frame-000000.png", "frame-000002.png"}
    page = (pages / "index.html").read_text()
    for words_of_page in ("frame-000002.png", "Cameras that were held out see", MEAN, "no fit reaches the 99 dB"):
        assert words_of_page in page
    assert faces.read_model(tmp_path / "m").record.scene["offsets"] == {"cam01": 1.0, "cam02": -0.5}
    for wrong, says in (([], "--resume"), (["--sync", str(other), "--resume"], "the run there has offsets")):
        assert faces.airgs_train([*words, *wrong]) == 2
        assert says in capsys.readouterr().err
    assert faces.airgs_train([*words, "--resume", "--json"]) == 0  # what was found is not looked for again
    summary = json.loads(capsys.readouterr().out)
    assert summary["keyframes"] == [0] and summary["psnr_definition"] == MEAN
    assert "no fit reaches the 99 dB" in summary["warnings"][0]


def test_airgs_encode_trains_multi_view_scenes_first(blobs, tmp_path, capsys, monkeypatch):
    quick = replace(SETTINGS, first_iterations=30, keyframe_iterations=20, frame_iterations=5)
    monkeypatch.setattr("airgs_codec.cli.train.default_settings", lambda device: quick)
    shutil.copytree(blobs, tmp_path / "blobs")
    words = f"{tmp_path}/blobs --x264-preset ultrafast --measure-pictures 2 --calibrate none".split()
    assert faces.airgs_encode(words) == 0
    assert "first frame" in capsys.readouterr().out
    package = faces.open_package(tmp_path / "blobs.airgs")
    assert package.manifest.frames == 5 and package.manifest.region.source == "cameras"
    assert package.manifest.attribution == "blobs by nobody"
    record = faces.read_model(tmp_path / "blobs.gaussians").record
    assert record.quality() in package.manifest.decisions
    assert (tmp_path / "blobs.gaussians" / "usage.npz").is_file()
    monkeypatch.setattr("airgs_codec.cli.encode.publish", stopped)
    assert faces.airgs_encode([*words, "--json"]) == 2  # the model is there: only encoded
    out, err = capsys.readouterr()
    assert out == "" and "first frame" not in err and err.endswith("\nairgs-encode: stopped here\n")


def stopped(*_, **__):
    raise faces.ConfigError("stopped here")


@pytest.fixture
def asked(blobs, tmp_path, monkeypatch):
    """A function of words to the scene and the settings that airgs-train would begin a run with."""
    runs = []

    def begin(scene, folder, settings, **_):
        runs.append((scene, settings))
        stopped()

    def ask(*words):
        assert faces.airgs_train([str(blobs), "-o", str(tmp_path / "m"), *words]) == 2
        return runs.pop()

    monkeypatch.setattr("airgs_codec.trainer.pipeline.open_run", begin)
    return ask


@pytest.mark.parametrize(("words", "iterations"), [
    ("", (1500, 1000, 200)), ("--effort quick", (600, 400, 80)), ("--effort high", (3750, 2500, 500)),
    ("--effort high --iterations 9,8,7", (9, 8, 7)),
])  # fmt: skip
def test_effort_is_iterations_of_every_frame(asked, words, iterations):
    _, found = asked("--device", "cpu", "--sync", "off", *words.split())
    assert (found.iterations_from_scratch(6), found.keyframe_iterations, found.frame_iterations) == iterations


def test_cameras_out_of_step_are_said(asked, blobs, capsys, monkeypatch):
    offsets = {"cam01": 1.25, "cam02": -2.0}
    monkeypatch.setattr("airgs_codec.trainer.data.sync.find_offsets", lambda *_: offsets)
    matched, off = asked()[0], asked("--sync", "off")[0]
    assert matched.offsets == offsets
    assert capsys.readouterr().out == (
        "cam02 is 2 frames early, cam01 is 1.25 frames late: matched, all have 1 of 5 frames; --sync off leaves it\n"
    )
    taken, given = ([[s.source for s in shots] for shots in scene.frames] for scene in (off, faces.open_scene(blobs)))
    assert taken == given and not off.offsets


def test_pictures_without_anything_are_one_line_and_exit_2(blobs, tmp_path, capsys):
    shutil.copytree(blobs, tmp_path / "scene")
    for path in (tmp_path / "scene" / "images").rglob("*.png"):
        faces.write_png(path, np.zeros_like(faces.read_picture(path)))
    assert faces.airgs_train([*f"{tmp_path}/scene -o {tmp_path}/m --iterations 90,20,8".split(), *QUICK[2:]]) == 2
    err = capsys.readouterr().err
    assert "expected pictures that show something" in err and err.count("\n") == 2  # one says how long it may take
    assert not list(tmp_path.glob("m/*.ply"))


def test_a_report_shows_pictures_as_they_were_trained_on(blobs, tmp_path):
    """Without held-out cameras it shows a training picture, and that was exposed as the average camera would have."""
    words = f"{blobs} -o {tmp_path}/m --report {tmp_path}/r --frames 0:1 --hold-out none --match-exposure on"
    assert faces.airgs_train([*words.split(), *QUICK]) == 0
    pictures = faces.Pictures(faces.with_held_out(faces.open_scene(blobs, frames=(0, 1)), []))
    alike = pictures.with_exposure(faces.read_model(tmp_path / "m").record.exposure)
    shown = faces.read_picture(tmp_path / "r" / "frame-000000.png")[20:]  # under the label
    for pair in zip(pictures.train(0), alike.train(0), strict=True):
        plain, exposed = (faces.to_bytes(view.target.rgb)[20:] for view in pair)
        if np.array_equal(shown[:, : plain.shape[1]], exposed):
            assert (shown[:, : plain.shape[1]] != plain).any()
            break
    else:
        pytest.fail("it shows no training picture")
