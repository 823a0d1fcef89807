"""airgs-play on a real, tiny package."""

import json

import pytest

from airgs_codec.cli import play as play_command
from airgs_codec.cli.options import run_program, takes
from tests.faces import HttpSettings, SessionSettings, airgs_play
from tests.support.paths import FOX, VALID
from tests.support.servers import plainly_serving

PACKAGE = VALID / "two-groups-sh1"
TRACE = FOX / "trace.csv"


def play(capsys, *options, package=PACKAGE, trace=TRACE):
    status = airgs_play([str(package), "--trace", str(trace), *map(str, options)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_a_url_is_played_over_http(capsys, tmp_path):
    film, report = tmp_path / "seen.mp4", tmp_path / "report"
    with plainly_serving(PACKAGE) as port:
        url = f"http://127.0.0.1:{port}/"
        options = [
            "--http.as-fast",
            "--policy",
            "fixed:Q1+L0",
            "--player.loops",
            "1",
            "--video",
            str(film),
            "--report",
            str(report),
        ]
        status = airgs_play([url, *options, "--json"])
    result = json.loads(capsys.readouterr().out)
    assert status == 0 and film.read_bytes()[4:8] == b"ftyp" and (report / "index.html").exists()
    assert result["startup_requests"] == 7 and result["startup_bytes"] > result["startup_table_bytes"] > 0
    assert (result["lost"], result["retried"], result["trace"]) == ([], [], None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["http://127.0.0.1:1/x"], "cannot be reached"),
        (["http://127.0.0.1:1/x", "--trace", "const:1"], "no --trace"),
        (["http://127.0.0.1:1/x", "--compare"], "--compare"),
        (["http://127.0.0.1:1/x", "--http.timeout", "0"], "time-out"),
        (["http://127.0.0.1:1/x", "--measure-decoding"], "got a URL"),
        ([str(PACKAGE), "--trace", "const:1", "--http.as-fast"], "--http.as-fast"),
    ],
)
def test_what_a_url_cannot_be_played_with_is_one_line_and_2(capsys, options, words):
    assert airgs_play(options) == 2
    err = capsys.readouterr().err
    assert err.startswith("airgs-play: ") and words in err and err.count("\n") == 1


def test_json_repeats_exactly(capsys):
    runs = [play(capsys, "--policy", "fixed:0", "--json") for _ in range(2)]
    assert runs[0] == runs[1]
    status, out, err = runs[0]
    result = json.loads(out)
    assert (status, err) == (0, "")
    assert result["trace_scale"] == 1.0 and result["trace"] == "trace.csv" and result["frames"] > 0


def test_report_and_film(capsys, tmp_path):
    report, film = tmp_path / "report", tmp_path / "out.mp4"
    options = ["--policy", "fixed:0", "--player.loops", 1, "--report", report, "--video", film, "--json"]
    status, out, _ = play(capsys, *options)
    assert status == 0 and json.loads(out)["region"]["source"] == "orbit"
    assert (report / "index.html").exists() and film.read_bytes()[4:8] == b"ftyp"


def test_defaults_are_those_of_the_settings():
    taken = []
    keep = takes(play_command.Play)(lambda options: taken.append(options) or 0)
    assert run_program("airgs-play", keep, ["scene.airgs"]) == 0
    (options,) = taken
    assert options.player == SessionSettings() and options.http == HttpSettings()
    changed = {"buffer": "3", "startup": "2", "resume": "1", "decode-frame": "0.005", "loops": "4", "budget": "9"}
    words = [word for name, value in changed.items() for word in (f"--player.{name}", value)]
    flags = ["--player.no-replace", "--player.no-abandon", "--player.no-pipelined"]
    assert run_program("airgs-play", keep, ["scene.airgs", *words, *flags]) == 0
    assert taken[1].player == SessionSettings(3.0, 2.0, 1.0, 0.005, False, False, False, 4, 9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--policy", "fixed:99"], "--policy: expected"),
        (["--rtt", "-1"], "round trip"),
        (["--rtt", "nan"], "round trip"),
        (["--player.loops", "0"], "loops"),
        (["--player.budget", "0"], "budget: expected at least 1 Gaussian"),
        (["--player.budget", "1"], "Gaussians or more, got 1"),
        (["--player.budget", "9", "--compare"], "--player.budget: expected a single session"),
        (["--report", "never", "--compare"], "--report: expected a single session"),
        (["--player.buffer", "nan"], "buffer"),
        (["--offset", "1e9"], "offset"),
        (["--scale", "0"], "scale"),
    ],
)
def test_bad_options_are_one_line_and_2(capsys, options, words):
    status, out, err = play(capsys, *(["--policy", "fixed:0"] if "--policy" not in options else []), *options)
    assert (status, out) == (2, "")
    assert err.startswith("airgs-play: ") and words in err and err.count("\n") == 1


def test_bad_files_are_one_line_and_2(capsys, tmp_path):
    zero = tmp_path / "zero.csv"
    zero.write_text("0,0\n1,0\n")
    for options in ({"trace": zero}, {"trace": tmp_path / "none"}, {"package": tmp_path}):
        status, out, err = play(capsys, "--policy", "fixed:0", **options)
        assert (status, out) == (2, "")
        assert err.startswith("airgs-play: ") and err.count("\n") == 1
