"""airgs-serve as a user runs it: it says where, serves, stops when it is told to."""

import shutil
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

from airgs_codec.cli import serve
from tests.support.paths import VALID

PACKAGE = VALID / "two-groups-sh1"
COMMAND = [sys.executable, "-c", "import sys; from airgs_codec.cli.serve import main; sys.exit(main())"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_told_to_stop(number):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*COMMAND, str(PACKAGE), "--port", "0"], **pipes) as process:
        address = process.stdout.readline().split()[-1]
        folder = process.stdout.readline().strip()
        assert folder == f"{address}{PACKAGE.name}/"
        with urllib.request.urlopen(f"{folder}airgs.json", timeout=10) as answer:
            assert answer.read() == (PACKAGE / "airgs.json").read_bytes()
        opened = process.stdout.readline().split()[-1]
        assert not serve.is_built() or opened == f"{address}player.html?src={PACKAGE.name}/"
        process.send_signal(number)
        out, errors = process.communicate(timeout=20)
    assert process.returncode == 0 and out == "stopped\n"
    assert not errors


def test_a_server_may_be_there_before_its_first_package(tmp_path):
    pipes = {"stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([*COMMAND, str(tmp_path), "--port", "0"], **pipes) as process:
        address = process.stdout.readline().split()[-1]
        assert "no package yet" in process.stdout.readline()
        shutil.copytree(PACKAGE, tmp_path / "later")
        with urllib.request.urlopen(f"{address}later/airgs.json", timeout=10) as answer:
            assert answer.read() == (PACKAGE / "airgs.json").read_bytes()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=20)
    assert process.returncode == 0


def test_what_cannot_be_served_is_one_line_and_status_2(tmp_path, capsys):
    package = str(PACKAGE)
    (tmp_path / "frame.ply").touch()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        wrong = [
            [str(tmp_path)],
            [package, package],
            [package, "--port", str(taken.getsockname()[1])],
            [package, "--port", "65536"],
            [package, "--host", "no.such.host.invalid"],
            [package, "--certificate", "chain.pem"],
            [package, "--certificate", "chain.pem", "--key", "key.pem"],
        ]
        for arguments in wrong:
            assert serve.main(arguments) == 2
            line = capsys.readouterr().err
            assert line.startswith("airgs-serve: ") and line.count("\n") == 1
            assert "expected" in line or "cannot read" in line
