"""The commands as a user runs them: reports, files, exit codes, one clear line for bad input."""

import json

import numpy as np
import pytest

from tests.faces import airgs_decode, airgs_encode, airgs_manifest, read_ply, write_ply
from tests.support.camera_files import write_colmap_binary, write_inria
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.splat_files import splat_bytes
from tests.support.views import ring


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli")
    scene = write_sequence(folder / "scene", moving_frames(120, 4), fps=10, keyframes=[0, 2])
    (scene / "ATTRIBUTION.txt").write_text("points by nobody\n")
    options = ["--x264-preset", "veryfast", "--calibrate", "none", "--keep-all"]
    assert airgs_encode([str(scene), "-o", str(folder / "out"), *options, "--json"]) == 0
    return folder / "out"


def line_of(capsys):
    text = capsys.readouterr().err.strip()
    assert "\n" not in text and "Traceback" not in text
    return text


def test_encode_reports_what_it_did(tmp_path, capsys):
    scene = write_sequence(tmp_path / "scene", moving_frames(60, 2))
    words = [str(scene), "--x264-preset", "veryfast", "--measure-pictures", "2"]
    assert airgs_encode(words) == 0
    out = capsys.readouterr().out
    assert " + L0 " in out and "play it: airgs-serve " in out and len(out.splitlines()) <= 24
    assert airgs_encode([*words, "--verbose"]) == 0
    assert "quality against the original" in capsys.readouterr().out
    assert (tmp_path / "scene.airgs" / "manifest.mpd").exists()


def test_the_folder_one_stands_in_can_be_encoded(tmp_path, monkeypatch):
    monkeypatch.chdir(write_sequence(tmp_path / "scene", moving_frames(20, 1)))
    assert airgs_encode([".", "--x264-preset", "ultrafast", "--measure-pictures", "0", "--json"]) == 0
    assert (tmp_path / "scene.airgs" / "manifest.mpd").exists()


def test_ladder_presets_and_levels(tmp_path, capsys):
    scene = write_sequence(tmp_path / "scene", moving_frames(60, 2))
    base = [str(scene), "-o", str(tmp_path / "out"), "--x264-preset", "ultrafast", "--measure-pictures", "0"]
    assert airgs_encode([*base, "--preset", "paper", "--json"]) == 0
    tables = json.loads((tmp_path / "out" / "airgs.json").read_text())
    assert [(v["pruned"], v["factor"]) for v in tables["levels"]] == [(i / 10, 1.0) for i in range(11)]
    assert airgs_encode([*base, "--levels", "0:1,25:4", "--quality", "low"]) == 0
    tables = json.loads((tmp_path / "out" / "airgs.json").read_text())
    assert [(v["pruned"], v["factor"]) for v in tables["levels"]] == [(0.0, 1.0), (0.25, 4.0)]
    assert airgs_encode([*base, "--levels", "zero"]) == 2
    assert "PRUNED:FACTOR" in capsys.readouterr().err


def test_groups_of_a_length_and_a_first_look(tmp_path, capsys):
    scene = write_sequence(tmp_path / "scene", moving_frames(60, 4), fps=10)
    base = [str(scene), "-o", str(tmp_path / "out"), "--measure-pictures", "0"]
    for options, frames in ((["--group-frames", "2"], [2, 2]), ([], [4])):
        assert airgs_encode([*base, "--preset", "quick", *options]) == 0
        tables = json.loads((tmp_path / "out" / "airgs.json").read_text())
        assert tables["index"][0]["frames"] == frames
    assert tables["generator"]["settings"]["preset"] == "superfast"
    assert airgs_encode([*base, "--group-frames", "few"]) == 2
    assert "argument --group-frames: expected a whole number, got 'few'" in capsys.readouterr().err


def test_frames_of_sog_are_matched_again_and_come_out_tracked(tmp_path, capsys):
    scene = tmp_path / "scene"
    scene.mkdir()
    for number, path in enumerate(sorted(FOX.glob("*.ply"))[:3]):
        (scene / f"{number}.sog").write_bytes(splat_bytes(read_ply(path).take(slice(0, 900)), ".sog"))
    words = [str(scene), "-o", str(tmp_path / "out"), "--preset", "quick", "--keep-all", "--measure-pictures", "1"]
    assert airgs_encode(words) == 0
    said = capsys.readouterr().out
    assert "decided: frames 1-2: rows were out of order; matched again, " in said
    assert airgs_encode([*words, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["rows"]["matched"] == [1, 2] and report["rows"]["sure"] > 0.99 and report["rows"]["unmatched"] == []
    assert airgs_decode([str(tmp_path / "out"), "-o", str(tmp_path / "frames")]) == 0
    a, b = (read_ply(tmp_path / "frames" / f"{n:06d}.ply") for n in (0, 2))
    assert len(a) == len(b) == 900 and np.abs(a.sh_dc - b.sh_dc).max() < 0.2  # rows at random differ by 2
    assert airgs_manifest(["validate", str(tmp_path / "out"), "--against", str(scene)]) == 0
    assert airgs_encode([*words, "--rows", "keep"]) == 0  # beside it, rows as they are take far more
    assert "matched again" not in capsys.readouterr().out


def test_a_region_from_one_package_serves_another(package, tmp_path):
    tables = json.loads((package / "airgs.json").read_text())
    assert tables["region"]["source"] == "cameras"
    (tmp_path / "region.json").write_text(json.dumps(tables["region"] | {"turn": 3}))
    scene = write_sequence(tmp_path / "scene", moving_frames(20, 1))
    words = [str(scene), "-o", str(tmp_path / "out"), "--x264-preset", "ultrafast", "--measure-pictures", "0"]
    assert airgs_encode([*words, "--calibrate", "none", "--region", str(tmp_path / "region.json")]) == 0
    given = json.loads((tmp_path / "out" / "airgs.json").read_text())["region"]
    assert given == tables["region"] | {"turn": 3, "source": "file"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--region", "none.json"], "none.json: cannot read a viewing region"),
        (["--region", "bad.json"], "bad.json: missing fields"),
        (["--margin", "-1"], "margin: expected 0 or more world units, got -1.0"),
        (["--margin", "nan"], "margin: expected 0 or more world units, got nan"),
    ],
)
def test_regions_that_cannot_be_are_one_line(tmp_path, options, words, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.json").write_text("{}")
    scene = write_sequence(tmp_path / "scene", moving_frames(20, 1))
    assert airgs_encode([str(scene), "-o", str(tmp_path / "out"), *options]) == 2
    assert words in line_of(capsys)
    assert not (tmp_path / "out").exists()


def test_inspect_and_validate(package, tmp_path, capsys):
    assert airgs_manifest(["inspect", str(package), "--plot", str(tmp_path / "p.png")]) == 0
    out = capsys.readouterr().out
    for word in ("key tier", "pruned", "PSNR", "left out"):
        assert word in out
    assert (tmp_path / "p.png").stat().st_size > 10_000
    assert airgs_manifest(["inspect", str(package), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["frames"] == 4 and len(data["rungs"]) == 8 and data["rungs"][0]["psnr"] > 30
    total = sum(data["top_rung_bytes"].values())
    assert total == pytest.approx(4 * data["rungs"][0]["bytes_per_frame"])
    assert airgs_manifest(["validate", str(package)]) == 0
    assert capsys.readouterr().out.startswith("valid: 4 frames")


def test_encode_says_which_cameras_it_took(tmp_path, capsys):
    scene = write_sequence(tmp_path / "model" / "point_cloud" / "iteration_7", moving_frames(60, 1), cameras=False)
    found = write_inria(tmp_path / "model", ring(3, held_out=1))
    given = write_colmap_binary(tmp_path / "rec", ring(5, held_out=1))
    quickly = ["--calibrate", "none", "--x264-preset", "ultrafast", "--measure-pictures", "0"]
    options = [str(scene), "-o", str(tmp_path / "out"), *quickly]
    assert airgs_encode(options) == 0
    assert capsys.readouterr().out.startswith(f"cameras: {found}, 3 of them, 0 held out\n")
    assert airgs_encode([*options, "--views", str(given)]) == 0
    assert capsys.readouterr().out.startswith(f"cameras: {given}, 5 of them, 1 held out\n")
    assert airgs_encode([*options, "--views", str(given.parent.parent), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cameras"] == str(given)  # where it was
    found.unlink()
    assert airgs_encode([*options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cameras"] is None


def test_encode_names_the_repairs(tmp_path, capsys):
    g = random_gaussians(30)
    arrays = {n: getattr(g, n).copy() for n in g.__slots__}
    arrays["quaternions"][3] = 0
    arrays["means"][4] = np.nan
    scene = tmp_path / "scene"
    scene.mkdir()
    write_ply(scene / "0.ply", type(g)(**arrays))
    assert (
        airgs_encode([str(scene), "-o", str(tmp_path / "out"), "--calibrate", "none", "--measure-pictures", "0"]) == 0
    )
    out = capsys.readouterr().out
    assert "1 Gaussians that are not finite" in out and "1 Gaussians with zero quaternions" in out


@pytest.mark.parametrize("option", ["--fps", "--bake-fps", "--duration"])
@pytest.mark.parametrize("text", ["1/0", "nan", "fast", "1e30000000"])
def test_numbers_that_are_none_are_refused(tmp_path, option, text, capsys):
    assert airgs_encode([str(tmp_path), option, text]) == 2
    assert f"argument {option}: expected a number or a fraction, got '{text}'" in capsys.readouterr().err


def test_a_target_that_cannot_be_written_is_one_line(tmp_path, capsys):
    scene = write_sequence(tmp_path / "scene", moving_frames(20, 1))
    (tmp_path / "file").write_text("in the way")
    assert airgs_encode([str(scene), "-o", str(tmp_path / "file" / "out")]) == 2
    assert "file" in line_of(capsys)
    assert airgs_encode([str(scene), "-o", str(tmp_path / "file")]) == 2
    assert "got a file" in line_of(capsys)


@pytest.mark.parametrize("what", ["missing", "no ply", "truncated", "sh degree changes", "bad cameras"])
def test_encode_refuses_bad_scenes_in_one_line_and_leaves_nothing(tmp_path, what, capsys):
    scene, frames = tmp_path / "scene", moving_frames(20, 2)
    if what != "missing":
        write_sequence(scene, [frames[0], random_gaussians(20, 1)] if what == "sh degree changes" else frames)
        second = scene / "000001.ply"
        changed = {"no ply": b"no ply", "truncated": second.read_bytes()[:-50]}
        second.write_bytes(changed.get(what, second.read_bytes()))
        if what == "bad cameras":
            (scene / "transforms.json").write_text("{}")
    assert airgs_encode([str(scene), "-o", str(tmp_path / "out")]) == 2
    assert "expected" in line_of(capsys)
    assert sorted(p.name for p in tmp_path.iterdir()) in (["scene"], [])
