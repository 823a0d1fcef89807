"""What every test shares: compiled kernels, and the embedded scene, encoded once."""

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import hypothesis
import pytest

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before numba: threads that wait must not take a core
if "PYTEST_XDIST_WORKER" in os.environ:  # whose processes take all cores; before numpy and numba
    os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.support.mutations import read_files
from tests.support.packages import PACKAGES
from tests.support.training import MODELS, write_blobs

hypothesis.settings.register_profile("airgs", deadline=None)  # how long an example takes says nothing
hypothesis.settings.load_profile("airgs")


def pytest_terminal_summary(terminalreporter):
    """Tell which browsers tests played in: each such test records its own."""
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.stats.get(kind, [])]
    browsers = {value for report in reports for name, value in report.user_properties if name == "browser"}
    if browsers:
        terminalreporter.write_line(f"browsers: {', '.join(sorted(browsers))}")


@pytest.fixture(scope="session", autouse=True)
def compiled(made_once):
    """Kernels that a process compiles itself may differ in the last bits."""

    def compile_all(folder):
        scene, model = write_blobs(folder / "scene"), folder / "model"
        train = f"{scene} -o {model} --iterations 2,2,2 --frames 0:2 --sync off --device cpu"
        encode = f"{model} -o {folder}/package --preset fast --measure-pictures 1"
        for command, words in (("train", train), ("encode", encode)):
            code = f"import sys; from airgs_codec.cli.{command} import main; sys.exit(main(sys.argv[1:]))"
            subprocess.run([sys.executable, "-c", code, *words.split()], check=True, capture_output=True)

    made_once("kernels", compile_all)


@pytest.fixture(scope="session")
def made_once(tmp_path_factory) -> Callable[[str, Callable[[Path], object]], Path]:
    """A function that gives the folder of a name, filled by the first process of the run that asks for it.

    Processes of pytest-xdist share it, so that what takes long is made once for all of them, and only read then.
    """
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"
    shared.mkdir(exist_ok=True)

    def get(name: str, make: Callable[[Path], object]) -> Path:
        folder = shared / name
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not folder.exists():
                begun = shared / f"{name}.begun"
                make(begun)
                begun.rename(folder)
        return folder

    return get


def read_only(made_once, ending, makers):
    """Yields what gives the folder of a name, made once for all; sees in the end that nothing wrote into any."""
    given = {}

    def get(name: str) -> Path:
        if name not in given:
            folder = made_once(name + ending, makers[name])
            given[name] = folder, read_files(folder)
        return given[name][0]

    yield get
    for name, (folder, before) in given.items():
        assert read_files(folder) == before, f"a test wrote into the shared {name}{ending}"


@pytest.fixture(scope="session")
def package_of(made_once):
    """A function that gives the folder of a package in `tests.support.packages`, encoded once for all. Only read it."""
    yield from read_only(made_once, ".airgs", PACKAGES)


@pytest.fixture(scope="session")
def demo_package(package_of):
    """The folder of the embedded scene as a package with measured quality. Never written to: see `demo_copy`."""
    return package_of("fox")


@pytest.fixture
def demo_copy(demo_package, tmp_path):
    """A copy of the embedded scene's package that a test may write to."""
    return shutil.copytree(demo_package, tmp_path / "demo.airgs")


@pytest.fixture(scope="session")
def blobs(made_once):
    """The folder of a small scene to train on. Only read it."""
    return made_once("blobs", write_blobs)


@pytest.fixture(scope="session")
def model_of(made_once, blobs):
    """A function that gives the folder of a model in `tests.support.training`, trained once for all. Only read it."""
    makers = {name: partial(make, blobs) for name, make in MODELS.items()}
    yield from read_only(made_once, ".gaussians", makers)


@pytest.fixture(scope="session")
def bucket():
    """The address of a bucket in a server of object stores, for all tests; each has a prefix of its own."""
    pytest.importorskip("moto", reason="moto, a server for tests, is not installed")
    from tests.support.servers import object_store

    with pytest.MonkeyPatch.context() as patch, object_store("scenes") as environment:
        for name, value in environment.items():
            patch.setenv(name, value)
        yield "s3://scenes"
