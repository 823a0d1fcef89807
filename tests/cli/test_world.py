"""What commands are told of up and units is in the package, and said again."""

import json

import pytest

from tests.faces import airgs_encode, airgs_manifest
from tests.support.regions import region, region_json
from tests.support.scenes import moving_frames, write_sequence


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--up", "-y"], "up: (0, -1, 0); units: not told"),
        (["--up", "0,3,4", "--unit", "0.01"], "up: (0, 0.6, 0.8); units: one is 0.01 m"),
        (["--transform", "WORLD"], "up: (0, 0, 1); units: one is 2 m"),
    ],
)
def test_what_is_told_of_up_and_units_is_in_the_package(tmp_path, options, line, capsys):
    scene = write_sequence(tmp_path / "scene", moving_frames(40, 1))
    (tmp_path / "world.txt").write_text("2 0 0 1\n0 0 2 1\n0 -2 0 1\n0 0 0 1\n")
    words = [str(tmp_path / "world.txt") if option == "WORLD" else option for option in options]
    seen = tmp_path / "region.json"
    seen.write_text(json.dumps(region_json(region())))
    command = [
        str(scene),
        "-o",
        str(tmp_path / "out"),
        "--preset",
        "quick",
        "--measure-pictures",
        "0",
        "--region",
        str(seen),
    ]
    assert airgs_encode([*command, *words, "--verbose"]) == 0 and line in capsys.readouterr().out
    assert airgs_manifest(["inspect", str(tmp_path / "out")]) == 0 and line in capsys.readouterr().out
    assert airgs_manifest(["validate", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--up", "north"], "--up: expected x, -x, y"),
        (["--up", "0,0,0"], "expected a direction"),
        (["--unit", "2"], "--unit: expected --up with it"),
        (["--up", "y", "--unit", "nan"], "metres a unit, got nan"),
        (["--up", "y", "--unit", "-1"], "metres a unit, got -1"),
        (["--up", "y", "--transform", "nowhere.txt"], "neither --up nor --unit"),
        (["--transform", "nowhere.txt"], "nowhere.txt: cannot read"),
    ],
)
def test_worlds_that_cannot_be_are_one_line(tmp_path, options, words, capsys):
    scene = write_sequence(tmp_path / "scene", moving_frames(40, 1))
    assert airgs_encode([str(scene), "-o", str(tmp_path / "out"), *options]) == 2
    error = capsys.readouterr().err.strip()
    assert words in error and "\n" not in error
    assert not (tmp_path / "out").exists()


def test_an_option_after_up_is_no_direction(tmp_path, capsys):
    assert airgs_encode([str(tmp_path), "--up", "--unit", "2"]) == 2
    assert "argument --up: expected " in capsys.readouterr().err
