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
    (encode, ["none", "--fps", "0"], "--fps"),
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
    (play, [FOX, "--trace", "const:5", "--policy", "none"], "none"),
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
