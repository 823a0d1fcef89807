"""airgs-play and airgs-serve on a real, tiny package; airgs-serve says where, and stops when it is told to."""

import json
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

from tests.faces import ConfigError, HttpSettings, SessionSettings, airgs_play, airgs_serve, is_built
from tests.support.paths import FOX, VALID
from tests.support.servers import plainly_serving

PACKAGE = VALID / "two-groups-sh1"
SERVE = [sys.executable, "-c", "import sys; from airgs_codec.cli.serve import main; sys.exit(main())"]


def play(capsys, *options, package=PACKAGE):
    status = airgs_play([str(package), "--trace", str(FOX / "trace.csv"), *map(str, options)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_a_url_is_played_over_http(capsys, tmp_path):
    film, report = tmp_path / "seen.mp4", tmp_path / "report"
    options = ["--policy", "fixed:Q1+L0", "--player.loops", "1", "--video", str(film), "--report", str(report)]
    with plainly_serving(PACKAGE) as port:
        status = airgs_play([f"http://127.0.0.1:{port}/", "--http.as-fast", *options, "--json"])
    result = json.loads(capsys.readouterr().out)
    assert status == 0 and film.read_bytes()[4:8] == b"ftyp" and (report / "index.html").exists()
    assert result["startup_requests"] == 7 and result["startup_bytes"] > result["startup_table_bytes"] > 0
    assert (result["lost"], result["retried"], result["trace"]) == ([], [], None)


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


def test_defaults_are_those_of_the_settings(monkeypatch, capsys):
    taken = []

    def opened(url, http, *_):
        taken.append(http)
        raise ConfigError("not over HTTP here")

    def simulated(package, link, policy, settings, faults):
        taken.append(settings)
        raise ConfigError("not played here")

    monkeypatch.setattr("airgs_codec.cli.play.HttpDownloader", opened)
    monkeypatch.setattr("airgs_codec.cli.play.simulate", simulated)
    assert airgs_play(["http://nowhere"]) == 2
    assert play(capsys)[0] == 2
    changed = {"buffer": 3, "startup": 2, "resume": 1, "decode-frame": 0.005, "loops": 4, "budget": 9}
    words = [word for name, value in changed.items() for word in (f"--player.{name}", value)]
    assert play(capsys, *words, "--player.no-replace", "--player.no-abandon", "--player.no-pipelined")[0] == 2
    changed = SessionSettings(3.0, 2.0, 1.0, 0.005, False, False, False, 4, 9)
    assert taken == [HttpSettings(), SessionSettings(), changed]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_told_to_stop(number):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*SERVE, str(PACKAGE), "--port", "0"], **pipes) as process:
        address = process.stdout.readline().split()[-1]
        folder = process.stdout.readline().strip()
        assert folder == f"{address}{PACKAGE.name}/"
        with urllib.request.urlopen(f"{folder}airgs.json", timeout=10) as answer:
            assert answer.read() == (PACKAGE / "airgs.json").read_bytes()
        opened = process.stdout.readline().split()[-1]
        assert not is_built() or opened == f"{address}player.html?src={PACKAGE.name}/"
        process.send_signal(number)
        out, errors = process.communicate(timeout=20)
    assert process.returncode == 0 and out == "stopped\n"
    assert not errors


def test_a_server_may_be_there_before_its_first_package(tmp_path):
    pipes = {"stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([*SERVE, str(tmp_path), "--port", "0"], **pipes) as process:
        address = process.stdout.readline().split()[-1]
        assert "no package yet" in process.stdout.readline()
        shutil.copytree(PACKAGE, tmp_path / "later")
        with urllib.request.urlopen(f"{address}later/airgs.json", timeout=10) as answer:
            assert answer.read() == (PACKAGE / "airgs.json").read_bytes()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=20)
    assert process.returncode == 0


def test_a_port_that_is_taken_is_one_line_and_2(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert airgs_serve([str(PACKAGE), "--port", str(taken.getsockname()[1])]) == 2
    line = capsys.readouterr().err
    assert "expected an address to listen at" in line and line.count("\n") == 1
