"""Mistakes of a newcomer at the commands: each is one line that says what was wrong, and leaves nothing."""

import pytest

from airgs_codec.cli import decode, encode, manifest, play, train
from tests.support.paths import GOLDEN

FOX = str(GOLDEN / "fox")
COMMANDS = [
    (encode, ["none"], "none: expected"),
    (encode, ["none.splatv"], "none.splatv"),
    (encode, [FOX, "-o", "x.airgs"], "fox"),
    (encode, [], "SCENE"),
    (encode, ["none", "--quality", "much"], "--quality"),
    (encode, ["none", "--presett", "quick"], "--presett"),
    (encode, ["none", "--preset", "none"], "--preset"),
    *(
        (encode, ["none", "--fps", rate], "--fps")
        for rate in ("0", "-1", "nan", "inf", "5e-324", "1e-9", "1e308", "1/0")
    ),
    *((encode, ["none", option, "9" * 25], option) for option in ("--group-frames", "--jobs", "--x264-preset")),
    *((encode, ["none", "--quality", factor], "step factors") for factor in ("0", "1e-320", "1e308", "inf", "nan")),
    (encode, ["none", "--segment", "inf"], "segment length"),
    (encode, ["none", "-o", "scene.mp4"], "expected a folder or a name that ends in .airgs"),
    (encode, ["none", "--report", "page.html"], "page.html: expected a folder"),
    (decode, [FOX, "-o", "frames.mp4"], "frames.mp4: expected a name that ends in"),
    (manifest, ["inspect", FOX, "--plot", "ladder"], "ladder: expected a name that ends in ."),
    (manifest, ["compare", FOX, FOX, "-o", "worst.png"], "worst.png: expected a folder"),
    (play, [FOX, "--trace", "const:5", "--video", "film.avi"], "film.avi: expected a name that ends in .mp4"),
    (play, [FOX, "--trace", "const:5", "--player.buffer", "1e-320"], "buffer: expected 0.001 s or more"),
    (play, [FOX, "--trace", "const:5", "--scale", "1e308"], "scale"),
    (train, ["none", "-o", "model.ply"], "expected a folder or a name that ends in .gaussians"),
    (decode, ["none.airgs", "-o", "a.ply"], "none.airgs"),
    (decode, [FOX, "-o", "a.ply", "--frames", "9999"], "--frames"),
    (decode, [FOX, "-o", "a.spz", "--format", "none"], "--format"),
    (decode, [FOX, "-o", "a.spz", "--frames", "0:3"], "expected one frame, got 3"),
    (decode, [FOX, "-o", "a.ply", "--level", "L99", "--frames", "0"], "level"),
    (manifest, ["inspect", "none.airgs"], "none.airgs"),
    (manifest, ["none", FOX], "none"),
    (manifest, ["compare", FOX, "none"], "none"),
    (play, ["none.airgs", "--trace", "const:5"], "none.airgs"),
    (play, [FOX, "--trace", "none.csv"], "none.csv"),
    (play, [FOX, "--trace", "const:5", "--policy", "none"], "--policy: expected"),
    (train, ["none", "-o", "model"], "none"),
]


@pytest.fixture(autouse=True)
def empty(tmp_path, monkeypatch):
    """The working folder, in which nothing is to be left."""
    monkeypatch.chdir(tmp_path)
    yield
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", range(len(COMMANDS)))
def test_a_wrong_command_ends_with_2_and_one_line(number, capsys):
    command, words, says = COMMANDS[number]
    assert command.main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and says in err and err.count("\n") == 1
