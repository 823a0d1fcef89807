"""What is installed: an sdist and a wheel, versions that fit, an image; what other systems import."""

import json
import shutil
import subprocess
import sys
import tarfile
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from urllib.parse import urljoin
from urllib.request import urlopen

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.paths import PACKAGE, REPOSITORY, VALID

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
LOCK = REPOSITORY / "constraints.txt"
BUILD = "import sys; from setuptools import build_meta; print(getattr(build_meta, 'build_' + sys.argv[1])(sys.argv[2]))"
PLAYER = "airgs_codec/serve/page/airgs-player.js"


def alone(site, home):
    """The environment of a process that finds an installed package, and not this repository."""
    return {"PYTHONPATH": str(site), "PATH": "/usr/bin:/bin", "HOME": str(home)}


def run(folder, *words, **how):
    done = subprocess.run([*map(str, words)], cwd=folder, capture_output=True, text=True, check=False, **how)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def files_below(folder):
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {name for name in found if "__pycache__" not in name}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """An sdist unpacked, and the wheel of it installed; both are built in a copy, which may be written to."""
    top = tmp_path_factory.mktemp("built")
    source = top / "source"
    shutil.copytree(PACKAGE, source / "airgs_codec", ignore=shutil.ignore_patterns("__pycache__"))
    for path in [*REPOSITORY.glob("*.*"), REPOSITORY / "LICENSE", *REPOSITORY.glob("tests/*.py")]:
        if path.is_file():
            (target := source / path.relative_to(REPOSITORY)).parent.mkdir(exist_ok=True)
            shutil.copy(path, target)
    sdist = run(source, sys.executable, "-c", BUILD, "sdist", top).split()[-1]
    with tarfile.open(top / sdist) as archive:
        archive.extractall(top / "unpacked", filter="data")
    (unpacked,) = (top / "unpacked").iterdir()
    wheel = run(unpacked, sys.executable, "-c", BUILD, "wheel", top).split()[-1]
    words = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target"]
    run(top, sys.executable, *words, top / "site", top / wheel)
    return unpacked, top / "site"


def test_sdist_and_wheel_hold_the_package_and_no_tests(built):
    unpacked, site = built
    ours = {f"airgs_codec/{name}" for name in files_below(PACKAGE)}
    assert PLAYER in ours and ours <= files_below(unpacked)
    assert {name for name in files_below(site) if name.startswith("airgs_codec/")} == ours
    assert {path.name for path in site.iterdir()} == {"airgs_codec", "airgs_codec-0.1.0.dist-info", "bin"}
    assert not any(name.startswith(("tests/", "tools/", "web/")) for name in files_below(unpacked))


def test_installed_commands_run(built, tmp_path):
    """They find the package that was installed, not that of this repository."""
    _, site = built
    assert {path.name for path in (site / "bin").iterdir()} == set(PROJECT["scripts"])
    assert "Usage: airgs-encode" in run(tmp_path, site / "bin" / "airgs-encode", "--help", env=alone(site, tmp_path))
    code = "import airgs_codec; print(airgs_codec.__file__)"
    assert run(tmp_path, sys.executable, "-c", code, env=alone(site, tmp_path)).startswith(str(site))


def steps_of_image():
    lines = (REPOSITORY / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    return [line.split(None, 1) for line in lines if line and not line.startswith("#")]


SERVE = """
import sys
sys.modules.update(dict.fromkeys(sys.argv[1].split()))  # an import of one fails as where it is not installed
from airgs_codec.cli.serve import main
sys.exit(main(sys.argv[2:]))
"""


def test_the_installed_server_sends_the_player_page_with_what_its_image_installs(built, tmp_path):
    (first,) = (words.split("&&")[0] for _, words in steps_of_image() if "&& pip" in words)
    lacking = {Requirement(one).name for one in PROJECT["dependencies"]} - set(first.split())
    dists = {name: {canonicalize_name(dist) for dist in of} for name, of in packages_distributions().items()}
    names = [name for name, of in dists.items() if of & lacking]
    assert {"numba", "cv2", "av", "PIL"} <= set(names)
    command = [sys.executable, "-c", SERVE, " ".join(names), VALID / "moving", "--port", "0"]
    how = {"cwd": tmp_path, "env": alone(built[1], tmp_path), "text": True}
    with subprocess.Popen(command, stdout=subprocess.PIPE, **how) as server:
        try:
            address = next(word for line in server.stdout for word in line.split() if "player" in word)
            page, script = (urlopen(urljoin(address, name), timeout=60).read() for name in ("", "airgs-player.js"))
        finally:
            server.terminate()
    assert b"airgs-player.js" in page and script == (REPOSITORY / PLAYER).read_bytes()


def test_the_image_copies_what_there_is_and_starts_what_is_installed():
    steps = steps_of_image()
    assert {word for word, _ in steps} == set("FROM WORKDIR COPY RUN USER EXPOSE ENTRYPOINT ENV CMD".split())  # noqa: SIM905
    copied = {name for word, rest in steps if word == "COPY" for name in rest.split()[:-1]}
    shown = {line[1:] for line in (REPOSITORY / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert copied == shown and all((REPOSITORY / name).exists() for name in copied)
    stages = [rest.split() for word, rest in steps if word == "FROM"]
    assert [(stage[0], stage[2]) for stage in stages[1:]] == [(stages[0][2], "serve"), (stages[0][2], "farm")]
    started = [json.loads(rest)[0] for word, rest in steps if word in ("ENTRYPOINT", "CMD")]
    assert started[0] in PROJECT["scripts"] and shutil.which(started[-1], path=Path(sys.executable).parent)


def test_the_lock_has_a_version_of_all_that_is_asked_for_and_fits():
    """Else: run make lock and make test, and commit constraints.txt."""
    locked = {canonicalize_name(line.split("==")[0]): line.split("==")[1] for line in LOCK.read_text().splitlines()}
    extras = PROJECT["optional-dependencies"]
    asked = [*PROJECT["dependencies"], *(one for name, words in extras.items() if name != "cuda" for one in words)]
    asked = [one for one in map(Requirement, asked) if one.name != PROJECT["name"]]
    assert len(asked) > 20 and [str(one) for one in asked if locked.get(one.name, "0") not in one.specifier] == []
    assert Requirement(extras["all"][0]).extras == set(extras) - {"all", "cuda", "dev"}


WINDOWS = """
import os, signal, sys
sys.modules.update(dict.fromkeys(("fcntl", "resource", "pwd", "grp", "termios", "tty")))
for name in ("O_NOFOLLOW", "O_DIRECTORY", "O_NONBLOCK", "sched_getaffinity", "getuid"):
    delattr(os, name)
del signal.SIGKILL, signal.SIGHUP
import airgs_codec
from airgs_codec.cli import compare, decode, encode, manifest, play, serve, train
frame = airgs_codec.decode(sys.argv[1], 1)
try:
    airgs_codec.write(frame, "frame.ply")
except airgs_codec.AirgsError as error:
    print(len(frame), error)
"""


def test_without_what_windows_lacks_packages_are_read_and_writing_is_refused(tmp_path):
    rows, said = run(tmp_path, sys.executable, "-c", WINDOWS, VALID / "moving").split(maxsplit=1)
    assert int(rows) > 0 and said == "frame.ply: expected file locks of POSIX, which are not here; on Windows use WSL\n"
    assert not list(tmp_path.iterdir())
