"""What commands say on a terminal: help, mistakes in one line, progress; mistakes end with 2 and leave nothing."""

import io
import os
import re
import sys

import pytest

from airgs_codec.cli import terminal
from tests import faces
from tests.support.paths import FOX, FOX_VIEWS, GOLDEN, VALID
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tools.check_docs import command_error

EVERYDAY = 18  # options of a command, on one screen
NAMES = ("decode", "encode", "manifest", "play", "serve", "train")
MANIFEST = ("compare", "export-page", "inspect", "rungs", "set-view", "validate")
COMMANDS = {name: getattr(faces, f"airgs_{name}") for name in NAMES}
PLACES = {"FOX": GOLDEN / "fox", "TWO": VALID / "two-groups-sh1", "FRAMES": FOX, "VIEWS": FOX_VIEWS}
PLACES |= {"ONE": VALID / "one-gaussian", "TRACE": FOX / "trace.csv"}
MISTAKES = {  # words that follow those of the command, and what is said of them
    "encode none": {
        "": "none: expected", "--quality much": "--quality", "--preset none": "--preset",
        "--fps 24 --fps 25": "--fps specified multiple times",
        "--group-frames few": "Invalid value for --group-frames: ",
        "--levels zero": "expected PRUNED:FACTOR,…, got 'zero'", "--segment inf": "segment length",
        "-o scene.mp4": "expected a folder or a name that ends in .airgs",
        "--report page.html": "page.html: expected a folder",
    },
    "encode scene": {
        "-o file/out --json": "file", "-o file --json": "got a file",
        "--report /proc/nowhere/x": "expected a folder that can be written", "-o /proc/out.airgs --json": "/proc/",
        "-o /dev/null/out.airgs --json": "/dev/null", "--region none.json": "none.json: cannot read a viewing region",
        "--region empty.json": "empty.json: missing fields",
        "--margin -1 --json": "margin: expected 0 or more world units, got -1.0",
        "--margin nan --json": "margin: expected 0 or more world units, got nan",
        "--up north": "--up: expected x, -x, y", "--up 0,0,0": "expected a direction",
        "--up --unit 2": "Invalid value for --up: expected x, ", "--unit 2": "--unit: expected --up with it",
        "--up y --unit nan": "metres a unit, got nan", "--up y --unit -1": "metres a unit, got -1",
        "--up y --transform nowhere.txt": "neither --up nor --unit",
        "--transform nowhere.txt": "nowhere.txt: cannot read",
        "--jobs 0": 'Invalid value "0" for --jobs. Must be >= 1.',
        "--executor ray --json": "--executor: expected dask or dask:ADDRESS, got 'ray'",
        "--target-de 0 --json": "target: expected a positive ΔE, got 0",
        "--target-de nan --json": "target: expected a positive ΔE, got nan",
        "--target-de grey": "Invalid value for --target-de: ",
        "--target-mbps 0.0001 --preset fast --json": "out of reach",
    },
    "encode": {
        "": "--scene requires an argument", "none.splatv": "none.splatv", "FOX -o x.airgs": "fox",
        "NOPLY -o out": "expected a .ply header, got b'no ply'", "CUT -o out --json": "000001.ply: expected 20",
        "DEGREES -o out": "000001.ply: expected SH degree 0", "CAMERAS -o out": "transforms.json: expected cameras (",
        "FRAMES --calibrate none -o out --device cuda --json": "device cuda: torch sees no CUDA device",
        "VIEWS -o out --device cuda": "device cuda: torch sees no CUDA device",
    },
    "decode FOX -o": {
        "frames.mp4": "frames.mp4: expected a name that ends in", "a.ply --frames 9999": "--frames",
        "frames --frames 0:9": "inside 0:4", "a.spz --format none": "--format", "a.ply --level L99 --frames 0": "level",
        "a.spz --format sog --frames 0": "ends in .sog, or in / for a folder",
        "a.spz": "expected one frame, got 4 (--frames N; for more, name a folder and --format spz)",
        "meta.json": "expected one frame, got 4", "file --format spz": "expected a folder, got a file",
        "file/": "expected a folder, got a file", "x.dec": "x.dec",
        "folder.spz --frames 0": "expected a file, got a folder: end it in /",
        "NOTHING": "expected the name of a file or folder", "FOX": "expected a place outside of packages",
        f"{GOLDEN}/fox/a.spz --frames 0": "expected a place outside of packages",
    },
    "decode": {"none.airgs -o a.ply": "none.airgs"},
    "manifest compare FRAMES FOX -o out": {
        "--frames 9": "--frames", "--frames x": "--frames", "--every 0": "--every", "--rung Q9+L0": "keyframe_quality",
        "--rung Q0": "level", "--views nowhere.json": "nowhere.json",
    },
    "manifest rungs ONE scene": {
        "--frames 9": "--frames", "--every 0": "--every", "--draws -1": "--draws",
    },
    "manifest": {
        "none FOX": "none", "inspect none.airgs": "none.airgs",
        "inspect FOX --plot ladder": "ladder: expected a name that ends in .",
        "inspect FOX --plot /proc/nowhere/x": "expected a folder that can be written",
        "inspect FOX --plot missing/a.png": "missing/a.png: cannot write the picture", "compare FOX none": "none",
        "compare FOX FOX -o worst.png": "worst.png: expected a folder", "compare FOX FOX -o file": "expected a folder",
        "compare FOX FOX -o file/below": "expected a folder",
        "compare FRAMES TWO -o out": "expected 24 frames a second", "compare FRAMES ftp://somewhere/else -o out": "ftp",
        "compare scene scene -o out --rung Q0+L0": "expected a package for the rung Q0+L0",
        "compare CUT CUT -o out": "000001.ply: expected 20",
        "rungs TWO scene": "scene: expected 5 frames, got 1", "rungs scene scene": "scene",
    },
    "play FOX --trace": {
        "none.csv": "none.csv", "const:5 --policy none": "policy: expected",
        "const:5 --policy fixed:99": "policy: expected",
        "const:5 --video film.avi": "film.avi: expected a name that ends in .mp4",
        "none --video /proc/nowhere/x.mp4": "expected a folder that can be written",
        "const:5 --player.buffer 1e-320": "buffer: expected 0.001 s or more", "const:5 --scale 1e308": "scale",
    },
    "play FOX --compare": {
        "": "--traces", "--traces none.csv": "none.csv", "--traces folder.spz": "empty",
        "--traces const:1 --policies best": "policy: expected", "--traces const:1 --offsets 0": "offset",
        "--traces const:1 --policies paper,paper": "policies",
    },
    "play TWO --trace TRACE --policy fixed:0": {
        "--rtt -1": "round trip", "--rtt nan": "round trip", "--player.loops 0": "loops",
        "--player.budget 0": "budget: expected at least 1, got 0", "--player.budget 1": "Gaussians or more, got 1",
        "--player.budget 9 --compare": "--player.budget: expected a single session",
        "--report never --compare": "--report: expected a single session", "--player.buffer nan": "buffer",
        "--offset 1e9": "offset", "--scale 0": "scale",
        "--buffer 3": "Unknown option: --buffer. Did you mean --player.buffer?",
        "--playr.buffer=3": "Did you mean --player.buffer?",
        "--player.buffer long": "Invalid value for --player.buffer: ",
        "--player.buffer": "--player.buffer requires an argument", "--http.as-fast": "--http.as-fast",
        "--video out.mp4 --device cuda": "device cuda: torch sees no CUDA device",
    },
    "play http://127.0.0.1:1/x": {
        "": "cannot be reached", "--trace const:1": "no --trace", "--compare": "--compare",
        "--http.timeout 0": "time-out",
    },
    "play": {
        "none.airgs --trace const:5": "none.airgs", "FOX": "airgs-serve /", "folder.spz --trace TRACE": "folder.spz",
        "TWO --trace zero.csv": "zero.csv", "FOX --trace second.csv --end error --player.loops 30": "ends after",
    },
    "serve TWO": {
        "TWO": "expected", "--port 65536": "expected", "--host no.such.host.invalid": "expected",
        "--certificate chain.pem": "expected --certificate and --key together",
        "--certificate chain.pem --key key.pem": "chain.pem: expected a PEM certificate",
    },
    "serve": {"none": "none: "},
    "train BLOBS -o m": {
        "--frames 3:9": "frames inside 0:5", "--frames x": "expected A:B", "--hold-out cam99": "no camera cam99",
        "--iterations 5": "expected FIRST,KEY,FRAME", "--budget 0": "budget of at least 1",
        "--near -1": "expected a positive distance", "--fps 0": "expected 0 < fps", "--max-size 3": "at least 16",
        "--sync nowhere.json": "nowhere.json", "--foreground given": "expected a mask",
        "--foreground all": '"off", "given"',
        "--seed 1 --seed 2": "airgs-train: Parameter --seed specified multiple times.\n",
        "--report /proc/nowhere/x": "expected a folder that can be written",
        **{f"{words} 2 --device cpu": f"{words}: expected --group-frames" for words in ("--jobs", "--work")},
        "--executor dask --device cpu": "--executor: expected --group-frames",
        "--group-frames 0 --device cpu": "expected group_frames of at least 1",
    },
    "train": {
        "none -o model": "none", "none -o model.ply": "expected a folder or a name that ends in .gaussians",
        "nowhere": "expected multi-view pictures",
        "VIEWS -o out --device cuda": "device cuda: torch sees no CUDA device",
    },
}  # fmt: skip
MISTAKES["encode none"] |= {f"--fps {rate}": "--fps" for rate in ("0", "-1", "inf", "5e-324", "1e-9", "1e308")}
MISTAKES["encode scene"] |= {
    f"--target-de 1 {other} 40": "expected one of --quality, --target-psnr, --target-de"
    for other in ("--target-psnr", "--target-mbps")
}
MISTAKES["encode none"] |= {f"--group-frames {'9' * 25}": "group_frames: expected a whole number"}
MISTAKES["encode none"] |= {f"--quality {x}": "step factors" for x in ("0", "1e-320", "1e308", "inf", "nan")}
MISTAKES["encode none"] |= {
    f"{name} {text}": f"Invalid value for {name}: expected a number or a fraction, got '{text}'"
    for name in ("--fps", "--bake-fps", "--duration")
    for text in ("1/0", "nan", "fast", "1e30000000")
}
ROWS = [(f"{command} {words}", says) for command, mistakes in MISTAKES.items() for words, says in mistakes.items()]


@pytest.mark.parametrize("command", [*NAMES, *(f"manifest {name}" for name in MANIFEST)])
def test_help_ends_with_three_examples_that_the_command_takes(command, capsys):
    program, *arguments = command.split()
    assert COMMANDS[program]([*arguments, "--help"]) == 0
    title, *examples = capsys.readouterr().out.split("\n")[-5:-1]
    assert title == "Examples:" and all(line.startswith(f"  airgs-{command} ") for line in examples)
    assert [error for line in examples if (error := command_error(line.split(), True))] == []


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "manifest"])
def test_help_lists_few_options_and_the_rest_is_listed_by_name(name, capsys):
    listed = {}
    for words in ("--help", "--help-all"):
        assert COMMANDS[name]([words]) == 0
        listed[words] = re.findall(r"^  (--[a-z][\w.-]*)", capsys.readouterr().out, re.MULTILINE)
    few, every = listed.values()
    assert 0 < len(few) <= EVERYDAY and set(few) <= set(every) and len(every) == len(set(every))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    write_sequence(tmp_path / "scene", moving_frames(20, 1))
    for name, text in (("file", "mine"), ("empty.json", "{}"), ("zero.csv", "0,0\n1,0\n"), ("second.csv", "0,1")):
        (tmp_path / name).write_text(text)
    (tmp_path / "folder.spz").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("airgs_codec.render.backend._missing", lambda: "torch sees no CUDA device")
    return tmp_path


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """Scenes of which something cannot be used, by names for it."""
    names, frames = ("NOPLY", "CUT", "DEGREES", "CAMERAS"), moving_frames(20, 2)
    scenes = {name: write_sequence(tmp_path_factory.mktemp(name), frames) for name in names}
    cut = scenes["CUT"] / "000001.ply"
    cut.write_bytes(cut.read_bytes()[:-50])
    (scenes["NOPLY"] / "000001.ply").write_bytes(b"no ply")
    faces.write_ply(scenes["DEGREES"] / "000001.ply", random_gaussians(20, 1))
    (scenes["CAMERAS"] / "transforms.json").write_text("{}")
    return scenes


@pytest.mark.parametrize(("words", "says"), ROWS, ids=[words for words, _ in ROWS])
def test_a_mistake_is_one_line_and_2_and_leaves_nothing(words, says, folder, broken, blobs, capsys):
    places = PLACES | broken | {"BLOBS": blobs, "NOTHING": ""}
    command, *arguments = [str(places.get(word, word)) for word in words.split()]
    before = sorted(folder.rglob("*")), sorted(os.listdir(FOX.parent))
    assert COMMANDS[command](arguments) == 2
    out, error = capsys.readouterr()
    assert out == "" and says in error and error.count("\n") == 1 and error.startswith(f"airgs-{command}: ")
    assert (sorted(folder.rglob("*")), sorted(os.listdir(FOX.parent))) == before


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_what_an_encoding_lacks_is_escaped(encoding, monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", out)
    assert terminal.run_command("name", lambda: terminal.say("\u2192 \u0394E") or 0) == 0
    assert out.buffer.getvalue() == b"\\u2192 \\u0394E\n"


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    return now


def test_a_log_gets_a_line_of_progress_every_half_minute_unless_work_is_quiet(clock, capsys):
    with terminal.Bar() as bar, terminal.Bar(quiet=True) as quiet:
        quiet.expect("nothing", {"others": 1}, 1)
        for second in range(0, 72, 3):
            clock[0] = float(second)
            bar("frames", second, 100)
            quiet("others", second, 100)
    assert capsys.readouterr().err.splitlines() == [
        "frames: 30% after 30 s, about 70 s left",
        "frames: 60% after 60 s, about 40 s left",
    ]


def test_one_bar_is_for_all_stages_after_a_line_of_what_is_expected(clock, capsys):
    with terminal.Bar() as bar:
        bar.expect("x.airgs", {"views": 30, "search": 0, "encoding": 90}, 1_234_567)
        for clock[0], stage, done in (
            (0, "views", 0),
            (30, "encoding: frames 0-9", 0),
            (75, "encoding: frames 10-19", 1),
        ):
            bar(stage, done, 2)
    assert capsys.readouterr().err.splitlines() == [
        "x.airgs: will take about 2 minutes and 1.2 MB",
        "encoding: frames 0-9: 25% after 30 s, about 90 s left",
        "encoding: frames 10-19: 62% after 75 s, about 45 s left",
    ]


@pytest.mark.parametrize("slower", [0.2, 1.0, 5.0])
def test_a_whole_only_grows_and_what_is_left_follows_what_is_seen(clock, slower):
    seconds, seen = {"a": 10, "skipped": 2, "b": 30, "c": 60}, []
    whole = terminal.Whole(seconds, 0.1)
    for stage in "abc":
        for done in range(10):
            whole.report(stage, done, 10)
            whole.report("a" if stage > "a" else "nobody's", 0, 1)  # is over, and was not expected
            seen.append((clock[0] / slower, *whole.look()))
            clock[0] += slower * seconds[stage] / 10
    whole.report("c", 10, 10)
    spent, shares, left = zip(*seen, strict=True)
    assert whole.look() == (1.0, 0.0) and shares[0] == 0 and left[0] == 102
    assert list(shares) == sorted(shares) and shares[-1] == pytest.approx(0.94, abs=0.03)
    assert all(0.5 < found / slower / (100 - at) < 2 for at, found in zip(spent, left, strict=True) if at > 40)


def test_a_bar_goes_on_while_a_stage_says_nothing(clock):
    whole = terminal.Whole({"a": 40, "b": 60}, 0.1)
    shares = []
    for clock[0] in range(0, 100, 10):
        shares.append(whole.look()[0])
    assert shares[:4] == pytest.approx([0, 0.1, 0.2, 0.3]) and shares == sorted(shares) and shares[-1] < 0.6
