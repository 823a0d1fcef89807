"""airgs-play and airgs-serve on a real, tiny package; airgs-serve says where, and stops when it is told to."""

import json
import shutil
import signal
import subprocess
import sys
import urllib.request
from contextlib import contextmanager

import pytest

from tests.faces import ConfigError, HttpSettings, SessionSettings, airgs_play, is_built
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
    options = f"--http.as-fast --policy fixed:Q1+L0 --player.loops 1 --video {film} --report {report} --json"
    with plainly_serving(PACKAGE) as port:
        assert airgs_play([f"http://127.0.0.1:{port}/", *options.split()]) == 0
    result = json.loads(capsys.readouterr().out)
    assert film.read_bytes()[4:8] == b"ftyp" and (report / "index.html").exists()
    assert result["startup_requests"] == 7 and result["startup_bytes"] > result["startup_table_bytes"] > 0
    assert (result["lost"], result["retried"]) == ([], [])


def test_json_repeats_exactly_with_a_report_and_a_film_and_without(capsys, tmp_path):
    options, (report, film) = ["--policy=fixed:0", "--player.loops=1", "--json"], (tmp_path / "r", tmp_path / "a.mp4")
    status, out, err = play(capsys, *options)
    assert (status, out, err) == play(capsys, *options, "--report", report, "--video", film) == (0, out, "")
    result = json.loads(out)
    assert result["frames"] > 0
    assert result["region"]["source"] == "orbit"
    assert (report / "index.html").exists() and film.read_bytes()[4:8] == b"ftyp"


def test_defaults_are_those_of_the_settings(monkeypatch, capsys):
    taken = []

    def take(*arguments):
        taken.extend(settings for settings in arguments if isinstance(settings, HttpSettings | SessionSettings))
        raise ConfigError("not played here")

    monkeypatch.setattr("airgs_codec.cli.play.HttpDownloader", take)
    monkeypatch.setattr("airgs_codec.cli.play.simulate", take)
    assert airgs_play(["http://nowhere"]) == 2
    assert play(capsys)[0] == 2
    changed = {"buffer": 3, "startup": 2, "resume": 1, "decode-frame": 0.005, "loops": 4, "budget": 9}
    words = [f"--player.{name}={value}" for name, value in changed.items()]
    assert play(capsys, *words, "--player.no-replace", "--player.no-abandon", "--player.no-pipelined")[0] == 2
    changed = SessionSettings(3.0, 2.0, 1.0, 0.005, False, False, False, 4, 9)
    assert taken == [HttpSettings(), SessionSettings(), changed]


@contextmanager
def serving(path, number):
    """airgs-serve with an address, which it says first, and what it says then, until a signal of this number."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*SERVE, str(path), "--port", "0"], **pipes) as process:
        yield process.stdout.readline().split()[-1], process.stdout
        process.send_signal(number)
        out, errors = process.communicate(timeout=20)
    assert (process.returncode, out, errors) == (0, "stopped\n", "")


def root_at(address):
    with urllib.request.urlopen(f"{address}airgs.json", timeout=10) as answer:
        return answer.read()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_told_to_stop(number):
    with serving(PACKAGE, number) as (address, said):
        assert said.readline() == f"{address}{PACKAGE.name}/\n"
        assert root_at(f"{address}{PACKAGE.name}/") == (PACKAGE / "airgs.json").read_bytes()
        opened = said.readline().split()[-1]
        assert not is_built() or opened == f"{address}player.html?src={PACKAGE.name}/"


def test_a_server_may_be_there_before_its_first_package(tmp_path):
    with serving(tmp_path, signal.SIGTERM) as (address, said):
        assert "no package yet" in said.readline()
        shutil.copytree(PACKAGE, tmp_path / "later")
        assert root_at(f"{address}later/") == (PACKAGE / "airgs.json").read_bytes()
