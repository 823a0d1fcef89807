"""Forty mistakes of a newcomer: each is one line that says what was wrong and what was expected, and leaves nothing."""

from functools import partial

import pytest

import airgs_codec as airgs
from airgs_codec.cli import decode, encode, manifest, play, train
from tests.support.paths import GOLDEN

FOX = str(GOLDEN / "fox")
CALLS = [
    (partial(airgs.open_package, "none.airgs"), "none.airgs"),
    (partial(airgs.open_package, 3), "path: expected a path"),
    (partial(airgs.open_sequence, "none"), "none: expected a folder"),
    (partial(airgs.open_sequence, None), "folder: expected a path"),
    (partial(airgs.Trace.open, "none.csv"), "none.csv"),
    (partial(airgs.Trace.open, "const:-1"), "const:-1"),
    (partial(airgs.read, "none.spz"), "none.spz: expected"),
    (partial(airgs.read, "frame.xyz"), "frame.xyz: expected"),
    (partial(airgs.write, None, "a.ply"), "gaussians: expected Gaussians"),
    (partial(airgs.decode, FOX, 999), "frame: expected"),
    (partial(airgs.decode, FOX, 0, level="L99"), "level: expected one of"),
    (partial(airgs.decode, FOX, 0, key_quality="best"), "key_quality: expected one of"),
    (partial(airgs.decode, None, 0), "package: expected an open package"),
    (partial(airgs.simulate, FOX, "const:5", "none"), "none"),
    (partial(airgs.simulate, FOX, None), "trace: expected"),
    (partial(airgs.encode, "none", "x.airgs"), "none: expected"),
    (partial(airgs.encode, 3, "x.airgs"), "sequence: expected"),
    (partial(airgs.draw, 3, None), "camera: expected a Camera, got None"),
    (partial(airgs.compare, "none", FOX), "none"),
    (partial(airgs.Sequence.from_arrays, []), "expected"),
]
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


@pytest.mark.parametrize("number", range(len(CALLS)))
def test_a_wrong_call_is_an_error_of_one_line(number):
    call, says = CALLS[number]
    with pytest.raises(airgs.AirgsError) as caught:
        call()
    assert says in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("number", range(len(COMMANDS)))
def test_a_wrong_command_ends_with_2_and_one_line(number, capsys):
    command, words, says = COMMANDS[number]
    assert command.main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and says in err and err.count("\n") == 1


def test_there_are_forty():
    assert len(CALLS) + len(COMMANDS) == 40
