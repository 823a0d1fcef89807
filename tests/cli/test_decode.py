"""airgs-decode into every format: one frame or a range, any rung, files and folders, and what is refused."""

import json
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests import faces
from tests.faces import FRAMES, airgs_decode, open_package, open_sequence, read_frame
from tests.support.mutations import read_files
from tests.support.paths import GOLDEN, VALID

FOX = GOLDEN / "fox"
KEYS = [form.key for form in FRAMES]


def run(*options):
    return airgs_decode([str(FOX), *map(str, options)])


@pytest.mark.parametrize("key", KEYS)
def test_a_file_is_one_frame_of_a_rung(tmp_path, key, capsys):
    path = tmp_path / "new" / f"fox.{key}"
    assert run("-o", path, "--frames", "2", "--level", "L1", "--keyframe-quality", "Q1", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["format"], report["frames"], report["output"]) == (key, [2, 3], str(path))
    expected = faces.decode(open_package(FOX), 2, level="L1", keyframe_quality="Q1")
    back = read_frame(path)
    assert len(back) == len(expected) and [p.name for p in path.parent.iterdir()] == [path.name]
    np.testing.assert_allclose(np.sort(back.means, axis=0), np.sort(expected.means, axis=0), atol=5e-3)
    assert any("SH" in line for line in report["lost"]) == (key in ("splat", "sog"))
    assert bool(report["lost"]) == (key not in ("ply", "glb"))
    assert any("readers of" in line for line in report["notes"]) == (key in ("spz", "glb")), "nobody told what is up"


@pytest.mark.parametrize(("place", "key"), [
    ("frames", None), ("frames/", None), ("frames.v2/", None), *(("frames", key) for key in KEYS), ("f.v2/", KEYS[-1]),
])  # fmt: skip
def test_a_range_is_a_folder_that_opens_as_a_sequence(tmp_path, place, key):
    assert run("-o", f"{tmp_path}/{place}", *(["--format", key] if key else []), "--frames", "1:3") == 0
    names = [f"00000{i}.{key or 'ply'}" for i in (1, 2)]
    assert sorted(p.name for p in (tmp_path / place).iterdir()) == [*names, "sequence.json"]
    sequence = open_sequence(tmp_path / place)
    assert (len(sequence), sequence.fps) == (2, open_package(FOX).manifest.fps)


def test_a_folder_keeps_its_files_and_settings_and_gets_the_background_where_it_has_none(tmp_path):
    for name in ("had", "new", "joined"):
        (tmp_path / name).mkdir()
    (tmp_path / "had" / "sequence.json").write_text('{"fps": 5}')
    for name in ("had", "new"):
        assert airgs_decode([str(VALID / "white"), "-o", str(tmp_path / name)]) == 0
    had, new = (open_sequence(tmp_path / name) for name in ("had", "new"))
    assert (had.fps, had.background) == (5, (0, 0, 0))
    assert (new.fps, new.background) == (open_package(VALID / "white").manifest.fps, (1, 1, 1))
    (tmp_path / "joined" / "notes.txt").write_text("mine")
    for number in ("0", "1", "1"):
        assert run("-o", tmp_path / "joined", "--frames", number) == 0
    assert read_files(tmp_path / "joined").keys() == {"000000.ply", "000001.ply", "notes.txt", "sequence.json"}


def test_sog_is_a_folder_of_pictures_and_a_range_of_it_says_what_is_lost(tmp_path, capsys):
    assert run("-o", tmp_path / "sog" / "meta.json", "--frames", "0") == 0
    assert len(read_frame(tmp_path / "sog")) == len(faces.decode(open_package(FOX), 0))
    assert not list((tmp_path / "sog").glob("*.sog"))
    capsys.readouterr()
    assert run("-o", tmp_path / "a", "--format", "sog", "--frames", "0:2") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3 and "rounds" in lines[1] and "which Gaussian is which is lost" in lines[2]


@pytest.mark.parametrize("place", ["frames/", "a.splat"])
def test_after_a_failure_everything_is_as_it_was(tmp_path, monkeypatch, place, capsys):
    """The disk is full at the last frame."""
    options = ("-o", f"{tmp_path}/{place}", "--format", "splat", "--frames", "0:3" if place == "frames/" else "2")
    written = FRAMES[KEYS.index("splat")].write

    def full(path, gaussians):
        written(path, gaussians)
        if path.name != "000000.splat":
            raise OSError(28, "No space left on device", str(path))

    def fail():
        broken = [replace(form, write=full) if form.key == "splat" else form for form in FRAMES]
        with monkeypatch.context() as patched:
            patched.setattr("airgs_codec.scene.formats.table.FRAMES", broken)
            assert run(*options) == 2
            assert "No space left" in (said := capsys.readouterr().err) and said.count("\n") == 1

    fail()
    assert not any(tmp_path.iterdir())
    assert run(*options) == 0
    before = read_files(tmp_path)
    fail()
    assert read_files(tmp_path) == before


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_stopped_command_leaves_nothing(tmp_path, number, status):
    """It is stopped when its frames are written, but not yet in their place."""
    code = f"""import os, signal, sys
from airgs_codec.cli import decode
from airgs_codec.scene.formats import table
table.write_settings = lambda *_, **__: os.kill(os.getpid(), {int(number)})
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(decode.main(sys.argv[1:]))"""
    command = [sys.executable, "-c", code, str(FOX), "-o", f"{tmp_path}/frames/"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (status, "airgs-decode: stopped")
    assert not any(tmp_path.iterdir())
