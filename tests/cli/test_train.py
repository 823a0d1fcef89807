"""airgs-train, and airgs-encode of multi-view scenes."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.cli import train as train_command
from airgs_codec.cli.train import match_cameras
from airgs_codec.trainer.fit.losses import PSNR_DEFINITION
from tests.faces import (
    Pictures,
    airgs_encode,
    airgs_train,
    open_package,
    open_scene,
    read_model,
    read_picture,
    to_bytes,
    with_held_out,
    write_png,
)
from tests.support.training import SETTINGS, write_blobs

QUICK = ["--iterations", "30,20,8", "--budget", "150", "--sh-degree", "0", "--device", "cpu"]


@pytest.fixture(scope="module")
def blobs(tmp_path_factory):
    return write_blobs(tmp_path_factory.mktemp("scene") / "blobs")


def test_airgs_train_says_what_it_did_and_reports(blobs, tmp_path, capsys):
    words = [str(blobs), "-o", str(tmp_path / "m"), "--report", str(tmp_path / "r"), *QUICK, "--frames", "0:2"]
    assert airgs_train(words) == 0
    out = capsys.readouterr().out
    assert f"{blobs}: 2 frames of 40x40, 6 training cameras and 1 held out\n" in out
    assert "first frame" in out and "held-out" in out and out.count("\nframe") == 2
    assert "dB (mean over views and frames)" in out  # packages pool the squared error of all views instead
    assert {"index.html", "frame-000000.png", "frame-000001.png"} <= {p.name for p in (tmp_path / "r").iterdir()}
    page = (tmp_path / "r" / "index.html").read_text()
    assert "frame-000001.png" in page and "Cameras that were held out see" in page and PSNR_DEFINITION in page
    assert airgs_train(words) == 2  # the model is there
    assert "--resume" in capsys.readouterr().err
    assert airgs_train([*words, "--resume", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["keyframes"] == [0] and summary["psnr_definition"] == PSNR_DEFINITION


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "expected multi-view pictures"),
        (["SCENE", "--frames", "3:9"], "frames inside 0:5"),
        (["SCENE", "--frames", "x"], "expected A:B"),
        (["SCENE", "--hold-out", "cam99"], "no camera cam99"),
        (["SCENE", "--iterations", "5"], "expected FIRST,KEY,FRAME"),
        (["SCENE", "--budget", "0"], "budget of at least one"),
        (["SCENE", "--near", "-1"], "expected a positive distance"),
        (["SCENE", "--fps", "0"], "expected 0 < fps"),
        (["SCENE", "--max-size", "3"], "16 pixels"),
        (["SCENE", "--sync", "nowhere.json"], "nowhere.json"),
        (["SCENE", "--foreground", "given"], "expected a mask"),
        (["SCENE", "--foreground", "all"], "off, given"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(blobs, tmp_path, capsys, words, message):
    words = [str(blobs) if w == "SCENE" else w for w in words]
    assert airgs_train([*words, "-o", str(tmp_path / "m")]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1
    assert not list(tmp_path.glob("m/*"))


def test_a_wrong_folder_is_refused_before_torch_is_loaded(tmp_path):
    code = (
        "import sys; from airgs_codec.cli.train import main\n"
        f"assert main([{str(tmp_path)!r}]) == 2\nassert 'torch' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


def test_airgs_encode_trains_multi_view_scenes_first(blobs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("airgs_codec.cli.train.default_settings", lambda device: replace(SETTINGS, frame_iterations=5))
    shutil.copytree(blobs, tmp_path / "blobs")
    quickly = ["--x264-preset", "ultrafast", "--measure-pictures", "2", "--calibrate", "none"]
    words = [str(tmp_path / "blobs"), *quickly]
    assert airgs_encode(words) == 0
    assert "first frame" in capsys.readouterr().out
    package = open_package(tmp_path / "blobs.airgs")
    assert package.manifest.frames == 5 and package.manifest.region.source == "cameras"
    assert package.manifest.attribution == "blobs by nobody"
    record = read_model(tmp_path / "blobs.gaussians").record
    assert record.quality() in package.manifest.decisions
    assert (tmp_path / "blobs.gaussians" / "usage.npz").is_file()
    assert airgs_encode([*words, "--json"]) == 0  # the model is there: only encoded
    json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "iterations"),
    [
        ({}, (2500, 1000, 300)),
        ({"effort": "quick"}, (1000, 400, 120)),
        ({"effort": "high"}, (6250, 2500, 750)),
        ({"effort": "high", "iterations": "9,8,7"}, (9, 8, 7)),
    ],
)
def test_effort_is_iterations_of_every_frame(words, iterations):
    found = train_command._settings(train_command.Train("scene", **words), "cpu", views=16)
    assert (found.iterations_from_scratch(16), found.key_iterations, found.frame_iterations) == iterations


def test_a_psnr_that_no_fit_reaches_is_said_once(blobs, tmp_path, capsys):
    words = [str(blobs), "-o", str(tmp_path / "m"), "--frames", "0:3", "--min-psnr", "99", *QUICK]
    assert airgs_train([*words, "--report", str(tmp_path / "r")]) == 0
    err = capsys.readouterr().err
    assert err.count("warning: frame 0: ") == err.count("\n") == 1
    assert "no fit reaches the 99 dB of --min-psnr" in err
    assert "no fit reaches the 99 dB" in (tmp_path / "r" / "index.html").read_text()
    assert airgs_train([*words, "--resume", "--json"]) == 0
    assert "no fit reaches the 99 dB" in json.loads(capsys.readouterr().out)["warnings"][0]


def test_an_option_is_given_once(blobs, capsys):
    assert airgs_train([str(blobs), "--seed", "1", "--seed", "2"]) == 2
    assert capsys.readouterr().err == "airgs-train: argument --seed: expected one value, got another one: '2'\n"


def test_offsets_of_a_file_are_those_of_the_run(blobs, tmp_path, capsys):
    late, other = tmp_path / "late.json", tmp_path / "other.json"
    late.write_text('{"cam01": 1, "cam02": -0.5}')
    other.write_text('{"cam01": 1, "cam02": -1}')
    words = [str(blobs), "-o", str(tmp_path / "m"), "--min-psnr", "0", *QUICK]
    assert airgs_train([*words, "--sync", str(late)]) == 0
    assert capsys.readouterr().out.count("\nframe") == 3  # of 5: from frame 1, and cam01 has no frame 5
    assert read_model(tmp_path / "m").record.scene["offsets"] == {"cam01": 1.0, "cam02": -0.5}
    assert airgs_train([*words, "--sync", str(other), "--resume"]) == 2
    assert "the run there has offsets" in capsys.readouterr().err
    assert airgs_train([*words, "--resume"]) == 0  # what was found is not looked for again


def test_cameras_out_of_step_are_said(blobs, capsys, monkeypatch):
    offsets = {"cam01": 1.25, "cam02": -2.0}
    monkeypatch.setattr("airgs_codec.trainer.data.sync.find_offsets", lambda *_: offsets)
    scene = open_scene(blobs)
    assert match_cameras(scene, (0, None), "auto", None, quiet=False).offsets == offsets
    assert capsys.readouterr().out == (
        "cam02 is 2 frames early, cam01 is 1.25 frames late: matched, all have 1 of 5 frames; --sync off leaves it\n"
    )
    assert match_cameras(scene, (0, None), "off", None, quiet=True).frames == scene.frames
    assert match_cameras(scene, (0, None), "auto", {"cam01": 1.0}, quiet=False).offsets == {"cam01": 1.0}
    assert capsys.readouterr().out == ""


def test_pictures_without_anything_are_one_line_and_exit_2(blobs, tmp_path, capsys):
    shutil.copytree(blobs, tmp_path / "scene")
    for path in (tmp_path / "scene" / "images").rglob("*.png"):
        write_png(path, np.zeros_like(read_picture(path)))
    words = [str(tmp_path / "scene"), "-o", str(tmp_path / "m"), "--iterations", "90,20,8", *QUICK[2:]]
    assert airgs_train(words) == 2
    err = capsys.readouterr().err
    assert "expected pictures that show something" in err and err.count("\n") == 1
    assert not list(tmp_path.glob("m/*.ply"))


def test_a_report_shows_pictures_as_they_were_trained_on(blobs, tmp_path):
    """Without held-out cameras it shows a training picture, and that was exposed as the average camera would have."""
    folder, words = tmp_path / "m", ["--frames", "0:1", "--hold-out", "none", "--match-exposure", "on", *QUICK]
    assert airgs_train([str(blobs), "-o", str(folder), "--report", str(tmp_path / "r"), *words]) == 0
    pictures = Pictures(with_held_out(open_scene(blobs, frames=(0, 1)), []))
    alike = pictures.with_exposure(read_model(folder).record.exposure)
    plain, exposed = (to_bytes(p.train(0)[0].target.rgb)[20:] for p in (pictures, alike))  # under the label
    shown = read_picture(tmp_path / "r" / "frame-000000.png")[20:, : plain.shape[1]]
    assert (shown == exposed).all() and (shown != plain).any()
