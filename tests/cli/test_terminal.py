"""What commands say on a terminal: help, mistakes in one line, progress; mistakes end with 2 and leave nothing."""

import io
import os
import re
import sys

import pytest

from airgs_codec.cli import terminal
from tests import faces
from tests.support.paths import FOX as FRAMES
from tests.support.paths import FOX_VIEWS, GOLDEN, VALID
from tests.support.scenes import moving_frames, write_sequence

EVERYDAY = 18  # options of a command, on one screen
NAMES = ("decode", "encode", "manifest", "play", "serve", "train")
COMMANDS = {name: getattr(faces, f"airgs_{name}") for name in NAMES}
PLACES = {"FOX": GOLDEN / "fox", "TWO": VALID / "two-groups-sh1", "FRAMES": FRAMES, "VIEWS": FOX_VIEWS}
PLACES |= {"ONE": VALID / "one-gaussian", "TRACE": FRAMES / "trace.csv"}
PLAY = "play TWO --trace TRACE --policy fixed:0"
MISTAKES = [
    ("encode", "expected SCENE, got none"),
    ("encode none", "none: expected"),
    ("encode none.splatv", "none.splatv"),
    ("encode FOX -o x.airgs", "fox"),
    ("encode none --quality much", "--quality"),
    ("encode none --presett quick", "--presett"),
    ("encode none --preset none", "--preset"),
    *((f"encode none --fps {rate}", "--fps") for rate in ("0", "-1", "nan", "inf", "5e-324", "1e-9", "1e308", "1/0")),
    *((f"encode none {name} {'9' * 25}", name) for name in ("--group-frames", "--jobs", "--x264-preset")),
    *((f"encode none --quality {factor}", "step factors") for factor in ("0", "1e-320", "1e308", "inf", "nan")),
    *(
        (f"encode none {name} {text}", f"argument {name}: expected a number or a fraction, got '{text}'")
        for name in ("--fps", "--bake-fps", "--duration")
        for text in ("1/0", "nan", "fast", "1e30000000")
    ),
    ("encode none --fps 24 --fps 25", "argument --fps: expected one value, got another one: '25'"),
    ("encode none --group-frames few", "argument --group-frames: expected a whole number, got 'few'"),
    ("encode none --levels zero", "expected PRUNED:FACTOR,…, got 'zero'"),
    ("encode none --segment inf", "segment length"),
    ("encode none -o scene.mp4", "expected a folder or a name that ends in .airgs"),
    ("encode none --report page.html", "page.html: expected a folder"),
    ("encode scene -o file/out --json", "file"),
    ("encode scene -o file --json", "got a file"),
    ("encode scene --report /proc/nowhere/x", "expected a folder that can be written"),
    ("encode scene -o /proc/out.airgs --json", "/proc/"),
    ("encode scene -o /dev/null/out.airgs --json", "/dev/null"),
    ("encode scene --region none.json", "none.json: cannot read a viewing region"),
    ("encode scene --region empty.json", "empty.json: missing fields"),
    ("encode scene --margin -1 --json", "margin: expected 0 or more world units, got -1.0"),
    ("encode scene --margin nan --json", "margin: expected 0 or more world units, got nan"),
    ("encode scene --up north", "--up: expected x, -x, y"),
    ("encode scene --up 0,0,0", "expected a direction"),
    ("encode scene --up --unit 2", "argument --up: expected "),
    ("encode scene --unit 2", "--unit: expected --up with it"),
    ("encode scene --up y --unit nan", "metres a unit, got nan"),
    ("encode scene --up y --unit -1", "metres a unit, got -1"),
    ("encode scene --up y --transform nowhere.txt", "neither --up nor --unit"),
    ("encode scene --transform nowhere.txt", "nowhere.txt: cannot read"),
    ("encode FRAMES --calibrate none -o out --device cuda --json", "--device cuda: torch sees no CUDA device"),
    ("encode VIEWS -o out --device cuda", "--device cuda: torch sees no CUDA device"),
    ("decode none.airgs -o a.ply", "none.airgs"),
    ("decode FOX -o frames.mp4", "frames.mp4: expected a name that ends in"),
    ("decode FOX -o a.ply --frames 9999", "--frames"),
    ("decode FOX -o frames --frames 0:9", "inside 0:4"),
    ("decode FOX -o a.spz --format none", "--format"),
    ("decode FOX -o a.spz --frames 0:3", "expected one frame, got 3"),
    ("decode FOX -o a.ply --level L99 --frames 0", "level"),
    ("decode FOX -o a.spz --format sog --frames 0", "ends in .sog, or in / for a folder"),
    ("decode FOX -o a.spz", "expected one frame, got 4 (--frames N; for more, name a folder and --format spz)"),
    ("decode FOX -o meta.json", "expected one frame, got 4"),
    ("decode FOX -o file --format spz", "expected a folder, got a file"),
    ("decode FOX -o file/", "expected a folder, got a file"),
    ("decode FOX -o x.dec", "x.dec"),
    ("decode FOX -o folder.spz --frames 0", "expected a file, got a folder: end it in /"),
    ("decode FOX -o NOTHING", "expected the name of a file or folder"),
    ("decode FOX -o FOX", "expected a place outside of packages"),
    (f"decode FOX -o {GOLDEN}/fox/a.spz --frames 0", "expected a place outside of packages"),
    ("manifest none FOX", "none"),
    ("manifest inspect none.airgs", "none.airgs"),
    ("manifest inspect FOX --plot ladder", "ladder: expected a name that ends in ."),
    ("manifest inspect FOX --plot /proc/nowhere/x", "expected a folder that can be written"),
    ("manifest inspect FOX --plot missing/a.png", "missing/a.png: cannot write the picture"),
    ("manifest compare FOX none", "none"),
    ("manifest compare FOX FOX -o worst.png", "worst.png: expected a folder"),
    ("manifest compare FOX FOX -o file", "expected a folder"),
    ("manifest compare FOX FOX -o file/below", "expected a folder"),
    ("manifest compare FRAMES FOX -o out --frames 9", "--frames"),
    ("manifest compare FRAMES FOX -o out --frames x", "--frames"),
    ("manifest compare FRAMES FOX -o out --every 0", "--every"),
    ("manifest compare FRAMES FOX -o out --rung Q9+L0", "key_quality"),
    ("manifest compare FRAMES FOX -o out --rung Q0", "level"),
    ("manifest compare FRAMES FOX -o out --views nowhere.json", "nowhere.json"),
    ("manifest compare FRAMES TWO -o out", "expected 24 frames a second"),
    ("manifest compare FRAMES ftp://somewhere/else -o out", "ftp"),
    ("manifest compare scene scene -o out --rung Q0+L0", "--rung: expected a package"),
    ("manifest rungs ONE scene --level L9", "level"),
    ("manifest rungs ONE scene --key-quality Q9", "--key-quality: expected one of Q0, got 'Q9'"),
    ("manifest rungs ONE scene --frames 9", "--frames"),
    ("manifest rungs ONE scene --every 0", "--every"),
    ("manifest rungs ONE scene --draws -1", "--draws"),
    ("manifest rungs ONE scene --split none", "split"),
    ("manifest rungs TWO scene", "scene: expected 5 frames, got 1"),
    ("manifest rungs scene scene", "scene"),
    ("play none.airgs --trace const:5", "none.airgs"),
    ("play folder.spz --trace TRACE", "folder.spz"),
    ("play FOX --trace none.csv", "none.csv"),
    ("play TWO --trace zero.csv", "zero.csv"),
    ("play FOX --trace const:5 --policy none", "--policy: expected"),
    ("play FOX --trace const:5 --policy fixed:99", "--policy: expected"),
    ("play FOX --trace const:5 --video film.avi", "film.avi: expected a name that ends in .mp4"),
    ("play FOX --trace none --video /proc/nowhere/x.mp4", "expected a folder that can be written"),
    ("play FOX --trace none --video nowhere/film.mp4", "expected a folder that can be written"),
    ("play FOX --trace const:5 --player.buffer 1e-320", "buffer: expected 0.001 s or more"),
    ("play FOX --trace const:5 --scale 1e308", "scale"),
    (f"{PLAY} --rtt -1", "round trip"),
    (f"{PLAY} --rtt nan", "round trip"),
    (f"{PLAY} --player.loops 0", "loops"),
    (f"{PLAY} --player.budget 0", "budget: expected at least 1 Gaussian"),
    (f"{PLAY} --player.budget 1", "Gaussians or more, got 1"),
    (f"{PLAY} --player.budget 9 --compare", "--player.budget: expected a single session"),
    (f"{PLAY} --report never --compare", "--report: expected a single session"),
    (f"{PLAY} --player.buffer nan", "buffer"),
    (f"{PLAY} --offset 1e9", "offset"),
    (f"{PLAY} --scale 0", "scale"),
    (f"{PLAY} --buffer 3", "argument --buffer: expected an option that there is (--player.buffer?)"),
    (f"{PLAY} --playr.buffer=3", "expected an option that there is (--player.buffer?)"),
    (f"{PLAY} --player.buffer long", "argument --player.buffer: expected a number, got 'long'"),
    (f"{PLAY} --player.buffer", "argument --player.buffer: expected a value, got none"),
    ("play http://127.0.0.1:1/x", "cannot be reached"),
    ("play http://127.0.0.1:1/x --trace const:1", "no --trace"),
    ("play http://127.0.0.1:1/x --compare", "--compare"),
    ("play http://127.0.0.1:1/x --http.timeout 0", "time-out"),
    ("play http://127.0.0.1:1/x --measure-decoding", "got a URL"),
    (f"{PLAY} --http.as-fast", "--http.as-fast"),
    (f"{PLAY} --video out.mp4 --device cuda", "--device cuda: torch sees no CUDA device"),
    ("serve scene", "expected"),
    ("serve TWO TWO", "expected"),
    ("serve TWO --port 65536", "expected"),
    ("serve TWO --host no.such.host.invalid", "expected"),
    ("serve TWO --certificate chain.pem", "expected --certificate and --key together"),
    ("serve TWO --certificate chain.pem --key key.pem", "chain.pem: expected a PEM certificate"),
    ("train none -o model", "none"),
    ("train none -o model.ply", "expected a folder or a name that ends in .gaussians"),
    ("train nowhere", "expected multi-view pictures"),
    ("train BLOBS -o m --frames 3:9", "frames inside 0:5"),
    ("train BLOBS -o m --frames x", "expected A:B"),
    ("train BLOBS -o m --hold-out cam99", "no camera cam99"),
    ("train BLOBS -o m --iterations 5", "expected FIRST,KEY,FRAME"),
    ("train BLOBS -o m --budget 0", "budget of at least one"),
    ("train BLOBS -o m --near -1", "expected a positive distance"),
    ("train BLOBS -o m --fps 0", "expected 0 < fps"),
    ("train BLOBS -o m --max-size 3", "16 pixels"),
    ("train BLOBS -o m --sync nowhere.json", "nowhere.json"),
    ("train BLOBS -o m --foreground given", "expected a mask"),
    ("train BLOBS -o m --foreground all", "off, given"),
    ("train BLOBS -o m --seed 1 --seed 2", "airgs-train: argument --seed: expected one value, got another one: '2'\n"),
    ("train BLOBS -o m --report /proc/nowhere/x", "expected a folder that can be written"),
    ("train VIEWS -o out --device cuda", "--device cuda: torch sees no CUDA device"),
]  # fmt: skip


def listed(text):
    return re.findall(r"^  (?:-\w, )?(--[a-z][\w.-]*)", text, re.MULTILINE)


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "manifest"])
def test_help_lists_few_options_and_the_rest_is_listed_by_name(name, capsys):
    assert COMMANDS[name](["--help"]) == 0
    few = listed(capsys.readouterr().out)
    assert COMMANDS[name](["--help-all"]) == 0
    every = listed(capsys.readouterr().out)
    assert 0 < len(few) <= EVERYDAY and set(few) <= set(every) and len(every) == len(set(every))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder: a scene, and what is in the way."""
    write_sequence(tmp_path / "scene", moving_frames(20, 1))
    for name, text in (("file", "mine"), ("empty.json", "{}"), ("zero.csv", "0,0\n1,0\n")):
        (tmp_path / name).write_text(text)
    (tmp_path / "folder.spz").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("airgs_codec.render.backend._missing", lambda: "torch sees no CUDA device")
    return tmp_path


@pytest.mark.parametrize(("words", "says"), MISTAKES, ids=[words for words, _ in MISTAKES])
def test_a_mistake_is_one_line_and_2_and_leaves_nothing(words, says, folder, blobs, capsys):
    places = PLACES | {"BLOBS": blobs, "NOTHING": ""}
    command, *arguments = [str(places.get(word, word)) for word in words.split()]
    before = sorted(folder.rglob("*")), sorted(os.listdir(FRAMES.parent))
    assert COMMANDS[command](arguments) == 2
    out, error = capsys.readouterr()
    assert out == "" and says in error and error.count("\n") == 1 and error.startswith(f"airgs-{command}: ")
    assert (sorted(folder.rglob("*")), sorted(os.listdir(FRAMES.parent))) == before


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_what_an_encoding_lacks_is_escaped(encoding, monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", out)
    assert terminal.run_command("name", lambda: terminal.say("\u2192 \u0394E") or 0) == 0
    assert out.buffer.getvalue() == b"\\u2192 \\u0394E\n"


def test_a_log_gets_a_line_of_progress_every_ten_seconds_unless_work_is_quiet(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    bar, quiet = terminal.Bar(), terminal.Bar(quiet=True)
    for second in range(0, 36, 3):
        now[0] = float(second)
        bar("frames", second, 100)
        quiet("others", second, 100)
    bar.close()
    assert capsys.readouterr().err.splitlines() == [
        "frames: 12 of 100, after 12 s, about 88 s left",
        "frames: 24 of 100, after 24 s, about 76 s left",
    ]
