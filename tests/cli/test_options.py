"""Options are made of settings: what help lists, and what is refused, in one line."""

import re

import pytest

from airgs_codec.cli import decode, encode, play, serve, train

EVERYDAY = 18  # options of a command, on one screen
COMMANDS = {"decode": decode, "encode": encode, "play": play, "serve": serve, "train": train}


def listed(text):
    return re.findall(r"^  (?:-\w, )?(--[a-z][\w.-]*)", text, re.MULTILINE)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_lists_few_options_and_the_rest_is_listed_by_name(name, capsys):
    assert COMMANDS[name].main(["--help"]) == 0
    few = listed(capsys.readouterr().out)
    assert COMMANDS[name].main(["--help-all"]) == 0
    every = listed(capsys.readouterr().out)
    assert 0 < len(few) <= EVERYDAY and set(few) <= set(every) and len(every) == len(set(every))


@pytest.mark.parametrize(
    ("command", "words", "refusal"),
    [
        (play, ["--buffer", "3"], "argument --buffer: expected an option that there is (--player.buffer?)"),
        (play, ["--playr.buffer=3"], "expected an option that there is (--player.buffer?)"),
        (play, ["--player.buffer", "long"], "argument --player.buffer: expected a number, got 'long'"),
        (play, ["--player.buffer"], "argument --player.buffer: expected a value, got none"),
        (encode, ["--fps", "24", "--fps", "25"], "argument --fps: expected one value, got another one: '25'"),
        (encode, [], "expected SCENE, got none"),
    ],
)
def test_options_that_cannot_be_are_one_line_and_exit_2(command, words, refusal, capsys):
    scene = ["scene"] if words else []
    assert command.main([*scene, *words]) == 2
    error = capsys.readouterr().err
    assert refusal in error and error.count("\n") == 1
