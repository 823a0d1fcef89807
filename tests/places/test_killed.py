"""Whatever the moment of a kill, what is there is whole, and the next run removes what was left; two runs share."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest

from airgs_codec.places import whole
from tests.faces import (
    ConfigError,
    Folder,
    airgs_decode,
    airgs_manifest,
    open_package,
    set_view,
    staged_package,
    validate,
)
from tests.support.paths import VALID

STEPS = ("open", "write", "fsync", "mkdir", "rename", "replace", "unlink", "rmdir")


class Killed(BaseException):
    pass


def dies(monkeypatch, work, steps):
    """Whether a run is killed before it ends: it does so many steps in files, and then none, not even to clean up."""

    def step(call):
        def counted(*args, **kwargs):
            nonlocal steps
            steps -= 1
            if steps < 0:
                raise Killed
            return call(*args, **kwargs)

        return counted

    with monkeypatch.context() as patched:
        for name in STEPS:
            patched.setattr(os, name, step(getattr(os, name)))
        try:
            work()
        except Killed:
            return True
    return False


def replace_package(place):
    with staged_package(Folder(place)) as stage:
        shutil.copytree(VALID / "one-gaussian", stage, dirs_exist_ok=True)


def give_up(place):
    """A run that cleans up and then fails."""
    with suppress(RuntimeError), staged_package(Folder(place)):
        raise RuntimeError


RUNS = {
    "set-view": lambda place: set_view(place, up=(0, -1, 0)),
    "replace": replace_package,
    "frames": lambda place: airgs_decode([str(VALID / "moving"), "-o", f"{place.parent}/frames/", "--frames", "0:2"]),
    "a file": lambda place: airgs_decode([str(VALID / "moving"), "-o", f"{place.parent}/a.splat", "--frames", "1"]),
}


def files_of(folder):
    return {path.relative_to(folder): path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize("name", RUNS)
def test_whatever_the_moment_of_a_kill(tmp_path, monkeypatch, name):
    def prepared(folder):
        return shutil.copytree(VALID / "placed", tmp_path / folder / "placed.airgs")

    RUNS[name](prepared("unbroken"))
    expected, before = files_of(tmp_path / "unbroken"), files_of(prepared("before").parent)
    for steps in range(1000):
        place = prepared(f"{steps}")
        if not dies(monkeypatch, lambda place=place: RUNS[name](place), steps):
            break
        assert not place.exists() or validate(place) == []
        other = shutil.copytree(place.parent, tmp_path / f"{steps}-gone") / place.name
        shutil.rmtree(other, ignore_errors=True)
        give_up(other)
        assert not other.exists() or files_of(other.parent) == before  # what came back is whole
        if name == "replace":
            give_up(place)
            assert files_of(place.parent) in (before, expected)
        RUNS[name](place)
        assert files_of(place.parent) == expected
    assert 4 < steps < 999


@pytest.mark.parametrize("inside", [False, True], ids=["a file", "frames"])
def test_what_a_living_run_writes_is_left_alone(tmp_path, inside):
    """Another run writes to the same place meanwhile and ends: then the first, all of it."""
    write = whole.staged_files if inside else whole.atomic_path
    with write(tmp_path / "out") as first:
        with write(tmp_path / "out") as second:
            (second / "a" if inside else second).write_bytes(b"second")
        (first / "a" if inside else first).write_bytes(b"first")
    out = tmp_path / "out"
    assert ((out / "a") if inside else out).read_bytes() == b"first"
    assert len(files_of(tmp_path)) == 1 + inside


def test_no_view_is_lost_where_many_are_set_at_once(tmp_path):
    place = shutil.copytree(VALID / "placed", tmp_path / "placed.airgs")
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: set_view(place, view=((1, 1, n), (0, 0, -1)), name=str(n)), range(24)))
    assert {str(n) for n in range(24)} <= {one.name for one in open_package(place).manifest.region.places}


def test_a_second_writer_is_refused_in_one_line(tmp_path, monkeypatch, capsys):
    """While a package is made it may be changed, but not made twice; while one grows, neither."""
    place = shutil.copytree(VALID / "placed", tmp_path / "placed.airgs")
    monkeypatch.setattr(whole, "WAIT_S", 0.0)
    change = ["set-view", str(place), "--up", "-y"]
    with staged_package(Folder(place)) as stage:
        shutil.copytree(VALID / "moving", stage, dirs_exist_ok=True)
        with pytest.raises(ConfigError, match="another run that is making this package"):
            give_up(place)
        assert airgs_manifest(change) == 0
    assert open_package(place).manifest.region == open_package(VALID / "moving").manifest.region
    with whole.written_alone(place):
        with pytest.raises(ConfigError, match="another run that is writing there"):
            give_up(place)
        assert airgs_manifest(change) == 2 and "another run that is writing there" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [place.name] and validate(place) == []
