"""airgs-encode as a user runs it: once in earnest, and else what its options ask of the library and what it says."""

import json
import re
import shutil
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest

from tests import faces
from tests.support.camera_files import write_colmap_binary, write_inria
from tests.support.manifests import in_groups, tiny_manifest
from tests.support.paths import FOX, GOLDEN
from tests.support.scenes import moving_frames, write_sequence
from tests.support.splat_files import splat_bytes
from tests.support.views import ring

LINES = "airgs_codec.cli.terminal.LINE_S"
REGION = json.loads((GOLDEN / "fox" / "airgs.json").read_text())["region"] | {"turn": 3}


def encode_sog(folder):
    """Frames of SOG, the package that airgs-encode makes of them, and what it says meanwhile."""
    scene = folder / "scene"
    scene.mkdir(parents=True)
    for number, path in enumerate(sorted(FOX.glob("*.ply"))[:3]):
        (scene / f"{number}.sog").write_bytes(splat_bytes(faces.read_ply(path).take(slice(0, 900)), ".sog"))
    (folder / "region.json").write_text(json.dumps(REGION))
    words = f"{scene} -o {folder}/out --preset fast --keep-all --measure-pictures 1 --region {folder}/region.json"
    with redirect_stdout(StringIO()) as said, redirect_stderr(StringIO()) as heard, patch(LINES, 0.0):
        assert faces.airgs_encode([*words.split(), "--up", "0,3,4", "--unit", "0.01"]) == 0
    for name, text in (("said", said), ("heard", heard)):
        (folder / name).write_text(text.getvalue())


@pytest.fixture(scope="session")
def encoded(made_once):
    return made_once("sog", encode_sog)


def test_encode_reports_what_it_did_and_inspect_what_is_there(encoded, tmp_path, capsys):
    said, package = (encoded / "said").read_text(), str(encoded / "out")
    assert " + L0 " in said and "play it: airgs-serve " in said and len(said.splitlines()) <= 24
    assert "decided: frames 1-2: rows were out of order; matched again, " in said
    assert {path.name for path in encoded.iterdir()} == {"scene", "region.json", "out", "said", "heard"}
    tables = json.loads((encoded / "out" / "airgs.json").read_text())
    assert tables["region"] == REGION | {"source": "file"}
    assert tables["generator"]["settings"]["preset"] == "fast"
    assert faces.airgs_manifest(["inspect", package, "--plot", str(tmp_path / "p.png")]) == 0
    out = capsys.readouterr().out
    for word in ("keyframe tier", "pruned", "PSNR", "left out", "up: (0, 0.6, 0.8); units: one is 0.01 m"):
        assert word in out
    assert (tmp_path / "p.png").stat().st_size > 10_000
    assert faces.airgs_manifest(["inspect", package, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["frames"] == 3 and len(data["rungs"]) == 4 and data["rungs"][0]["psnr"] > 30
    total = sum(data["top_rung_bytes"].values())
    assert total == pytest.approx(3 * data["rungs"][0]["bytes_per_frame"])


def test_an_encode_says_first_what_it_will_take_and_then_how_far_all_of_it_is(encoded):
    heard, size = (encoded / "heard").read_text(), sum(path.stat().st_size for path in (encoded / "out").rglob("*.*"))
    assert 0.5 < float(re.search(r"/out: will take about \d+ s and ([\d.]+) MB\n", heard)[1]) / (size / 1e6) < 2
    stages, shares = zip(*re.findall(r"(?m)^([^:\n]+).*: (\d+)% after", heard), strict=True)
    assert list(dict.fromkeys(stages)) == ["frames", "order of rows", "views", "encoding", "measuring"]
    assert list(shares) == sorted(shares, key=int)


def test_frames_of_sog_come_out_tracked_and_as_they_were_promised(encoded, tmp_path, capsys):
    assert faces.airgs_manifest(["validate", str(encoded / "out")]) == 0
    assert capsys.readouterr().out.startswith("valid: 3 frames")
    assert faces.airgs_decode([str(encoded / "out"), "-o", str(tmp_path / "frames")]) == 0
    a, b = (faces.read_ply(tmp_path / "frames" / f"{n:06d}.ply") for n in (0, 2))
    assert len(a) == len(b) == 900 and np.abs(a.sh_dc - b.sh_dc).max() < 0.2  # rows at random differ by 2
    assert faces.airgs_manifest(["validate", str(encoded / "out"), "--against", str(encoded / "scene")]) == 0


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """What airgs-encode asks of the library, which encodes nothing here; the working folder has a scene."""
    calls, m = [], tiny_manifest()
    groups = in_groups([replace(group, repairs=["mended"]) for group in m.groups])
    rows = faces.Restored(None, matched=(1, 2), sure=0.75, unmatched=(3, 4), alone=(4,))

    def publish(sequence, target, settings, *, progress, **given):
        calls.append(SimpleNamespace(sequence=sequence, target=target, settings=settings, **given))
        done = replace(m, groups=groups, world=settings.world, decisions=["up is guessed to be -y", "others"])
        plan = SimpleNamespace(choices=(faces.Choice("views", "8", 2.0),))
        return faces.EncodeReport(done, 700, plan, rows, 6.0, 0.04)

    monkeypatch.setattr("airgs_codec.cli.encode.publish", publish)
    monkeypatch.chdir(tmp_path)
    write_sequence(tmp_path / "scene", moving_frames(20, 2), fps=10)
    (tmp_path / "world.txt").write_text("2 0 0 1\n0 0 2 1\n0 -2 0 1\n0 0 0 1\n")
    return calls


def levels(*words):
    return tuple(faces.LevelSettings(pruned, factor, quality=quality) for pruned, factor, quality in words)


PAPER = {"levels": tuple(faces.LevelSettings(i / 10) for i in range(11)), "tiers": (1.0,), "keyframe_factors": (1.0,)}
PAPER |= {"calibrate": "none", "usage": "hits", "update_rank": "hits", "keep_all": True, "keyframes": "intra"}
FAST = {"levels": levels((0, 1, 0), (0.5, 2, 1)), "preset": "fast", "calibrate": "none"}
FAST |= {"decide_pictures": 8, "check_pictures": 8, "measure_pictures": 8}
ASKED = {
    "": {}, "--preset paper": PAPER, "--preset fast": FAST,
    "--preset fast --group-frames 2 --measure-pictures 2": FAST | {"group_frames": 2, "measure_pictures": 2},
    "--levels 0:1,25:4": {"levels": levels((0, 1, 0), (0.25, 4, 0)), "calibrate": "steps"},
    "--quality low --rows keep --margin 0.5": {"quality": 1.6, "rows": "keep", "margin": 0.5},
    "--calibrate none --keep-all": {"calibrate": "none", "keep_all": True}, "--x264-preset fast": {"preset": "fast"},
}  # fmt: skip
GOALS = {
    "--target-psnr 41": faces.Goal(faces.PSNR, 41.0), "--target-de 0.6": faces.Goal(faces.DELTA_E, 0.6),
    "--target-mbps 3": faces.Goal.size(37.5),  # at 10 frames a second
}  # fmt: skip


@pytest.mark.parametrize("words", [*ASKED, *GOALS])
def test_options_are_settings_before_the_defaults_and_targets_are_goals(asked, words):
    assert faces.airgs_encode(["scene", *words.split()]) == 0
    assert asked[0].settings == replace(faces.EncodeSettings(), **ASKED.get(words, {}))
    assert (asked[0].goal, asked[0].plan, asked[0].executor, asked[0].work) == (GOALS.get(words), None, None, None)


def test_a_plan_is_printed_alone_and_followed(asked, tmp_path, capsys):
    assert faces.airgs_encode(["scene", "--preset", "fast", "--group-frames", "1", "--plan"]) == 0
    printed = capsys.readouterr().out
    assert not asked and not (tmp_path / "scene.airgs").exists()
    (tmp_path / "plan.json").write_text(printed)
    assert faces.airgs_encode(["scene", "--plan", "plan.json", "--jobs", "2", "--work", "shared"]) == 0
    assert asked[0].plan.to_json() == printed.rstrip("\n") and asked[0].plan.groups == ((0, 1), (1, 2))
    assert isinstance(asked[0].executor, faces.Processes) and asked[0].work == "shared"
    (tmp_path / "plan.json").write_text(printed.replace("groups", "grouped"))
    assert faces.airgs_encode(["scene", "--plan", "plan.json"]) == 2
    assert "airgs-encode: plan.json: unknown fields ['grouped']\n" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["scene", "scene/", "scene/."])
def test_the_package_is_beside_the_scene_unless_it_is_told_where(asked, tmp_path, monkeypatch, place):
    (tmp_path / "scene" / "ATTRIBUTION.txt").write_text("points by nobody\n")
    assert faces.airgs_encode([place]) == faces.airgs_encode([place, "-o", "out", "--attribution", "me"]) == 0
    monkeypatch.chdir(place)
    assert faces.airgs_encode(["."]) == 0
    for name in ("head.ply", "head.compressed.ply"):
        shutil.copy(tmp_path / "scene" / "000000.ply", tmp_path / name)
        assert faces.airgs_encode([str(tmp_path / name)]) == 0
    names = ("scene.airgs", None, "scene.airgs", "head.airgs", "head.airgs")
    assert [call.target for call in asked] == [f"{tmp_path}/{name}" if name else "out" for name in names]
    assert [call.sequence.attribution for call in asked[:3]] == ["points by nobody", "me", "points by nobody"]


def test_figures_are_said_in_words_or_as_json(asked, capsys):
    assert faces.airgs_encode(["scene", "-o", "out"]) == 0
    said, warned = capsys.readouterr()
    assert "repaired: mended" in said and "Q0 + L0" in said and warned == "up is guessed to be -y\n"
    assert said.endswith(
        "\nout: 20 frames, 2.00 s, 0.02 MB with all rungs; 8 s (views 2.0, encoding 6.0)\n"
        "play it: airgs-serve out; all tables: airgs-manifest inspect out\n"
    )
    assert faces.airgs_encode(["scene", "-o", "out", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "package": "out", "frames": 20, "bytes": 19750, "top_rung_bytes": 13300,
        "seconds": {"views": 2.0, "encoding": 6.0, "measuring": 0.04}, "cameras": "scene/transforms.json",
        "rows": {"matched": [1, 2], "sure": 0.75, "unmatched": [3, 4], "alone": [4]}, "repairs": ["mended", "mended"],
    }  # fmt: skip


def test_what_is_told_of_up_and_units_goes_with_the_scene(asked):
    for words, line in (
        ("--up -y", "up: (0, -1, 0); units: unknown"),
        ("--up 0,3,4 --unit 0.01", "up: (0, 0.6, 0.8); units: one is 0.01 m"),
        ("--transform world.txt", "up: (0, 0, 1); units: one is 2 m"),
    ):
        assert faces.airgs_encode(["scene", *words.split()]) == 0
        assert faces.world_words(asked.pop().settings.world) == line


def test_the_cameras_that_are_taken_are_named(asked, tmp_path, capsys):
    scene = write_sequence(tmp_path / "model" / "point_cloud" / "iteration_7", moving_frames(60, 1), cameras=False)
    found = write_inria(tmp_path / "model", ring(3, held_out=1))
    given = write_colmap_binary(tmp_path / "rec", ring(5, held_out=1))
    for words, line in (
        ([], f"{found}, 3 of them, 0 held out"),
        (["--views", given], f"{given}, 5 of them, 1 held out"),
    ):
        assert faces.airgs_encode([str(scene), *map(str, words)]) == 0
        assert capsys.readouterr().out.startswith(f"cameras: {line}\n")
    for views, taken in (["--views", str(given.parent.parent)], str(given)), ([], None):  # where it was
        assert faces.airgs_encode([str(scene), *views, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["cameras"] == taken
        found.unlink(missing_ok=True)
    assert [len(call.sequence.cameras) for call in asked] == [3, 5, 5, 0]
