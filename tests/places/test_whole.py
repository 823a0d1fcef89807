"""Files and folders are whole or not there, whatever goes wrong, whenever a run is killed; two runs share."""

import gc
import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

from airgs_codec.places import whole
from tests import faces
from tests.support.paths import VALID

MOVING = str(VALID / "moving")
STEPS = ("open", "write", "fsync", "mkdir", "rename", "replace", "unlink", "rmdir")


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def staged(folder, is_ours=Path.is_dir):
    return whole.staged_folder(folder, is_ours, "package")


def test_a_file_takes_its_place_only_when_it_is_whole_and_json_has_null_for_no_number(tmp_path, monkeypatch):
    path, seen = tmp_path / "a.bin", []
    whole.write_bytes(path, b"old")
    with pytest.raises(RuntimeError), whole.atomic_path(path) as temporary:
        temporary.write_bytes(b"half")
        assert path.read_bytes() == b"old"
        raise RuntimeError
    assert names_in(tmp_path) == ["a.bin"] and path.read_bytes() == b"old"
    whole.write_bytes(path, b"new")
    assert names_in(tmp_path) == ["a.bin"] and path.read_bytes() == b"new"
    (tmp_path / "b.bin").write_bytes(b"plain")
    assert path.stat().st_mode == (tmp_path / "b.bin").stat().st_mode, "read by whom the umask lets"
    monkeypatch.setattr(whole.os, "fsync", lambda _: seen.append((tmp_path / "c.bin").exists()))
    whole.write_bytes(tmp_path / "c.bin", b"new")
    assert seen == [False], "bytes are synchronised before the file has its name"
    whole.write_json(path, {"a": (1.5, float("nan")), "b": [{"c": float("-inf")}], "d": "inf"})
    assert json.loads(path.read_text()) == {"a": [1.5, None], "b": [{"c": None}], "d": "inf"}


def test_links_are_replaced_and_never_written_through(tmp_path, monkeypatch):
    """Neither one at the name of the file, nor one that takes the place of the temporary file."""
    precious, path = tmp_path / "precious", tmp_path / "out" / "a.bin"
    path.parent.mkdir()
    precious.write_bytes(b"years of work")
    path.symlink_to(precious)
    whole.write_bytes(path, b"new")
    assert path.read_bytes() == b"new" and not path.is_symlink() and precious.read_bytes() == b"years of work"
    monkeypatch.setattr(whole.secrets, "token_hex", lambda count: "guessed")
    planted = tmp_path / "out" / ".a.bin.guessed.part"
    planted.symlink_to(precious)
    with pytest.raises(FileExistsError):
        whole.write_bytes(path, b"newer")
    assert precious.read_bytes() == b"years of work" and path.read_bytes() == b"new" and planted.is_symlink()
    planted.unlink()
    with pytest.raises(OSError), whole.atomic_path(path) as temporary:
        temporary.unlink()
        temporary.symlink_to(precious)
    assert precious.read_bytes() == b"years of work" and not path.is_symlink()
    assert [p.name for p in path.parent.iterdir()] == ["a.bin"]


def test_a_staged_folder_takes_no_links_place_and_what_others_put_beside_it_or_write_meanwhile_stays(tmp_path):
    """Whatever it is called: without the mark of an unfinished folder it is not ours."""
    others = [".new.x.stage", ".new.backup.old", f".new.airgs-{'1' * 16}", ".new.airgs-notes"]
    for name in others:
        (tmp_path / name / "old").mkdir(parents=True)
        (tmp_path / name / "notes.txt").write_text("of somebody")
    (tmp_path / others[2] / "airgs-unfinished").write_text("not the mark")
    links = {"out": tmp_path / others[0], "dangling": tmp_path / "nowhere", f".new.airgs-{'0' * 16}": tmp_path}
    for name, to in links.items():
        (tmp_path / name).symlink_to(to)
    for name in ("out", "dangling"):
        with pytest.raises(faces.ConfigError, match="got a link"), staged(tmp_path / name):
            raise AssertionError("unreachable")
    for _ in range(2):
        with staged(tmp_path / "new") as stage:
            (stage / "a").touch()
    assert (tmp_path / "new" / "a").is_file() and names_in(tmp_path) == sorted([*others, *links, "new"])
    with pytest.raises(faces.ConfigError, match="other files"), staged(tmp_path / "late", lambda folder: False):
        shutil.copytree(tmp_path / others[0], tmp_path / "late")
    assert names_in(tmp_path) == sorted([*others, *links, "new", "late"])
    assert all((tmp_path / name / "notes.txt").read_text() == "of somebody" for name in (*others, "late"))
    assert all((tmp_path / name).readlink() == to for name, to in links.items())


class Killed(BaseException): ...


def dies(monkeypatch, work, steps):
    """Whether a run is killed before it ends: it does so many steps in files, and then none, not even to clean up."""
    left = iter(range(steps))

    def step(call):
        def counted(*args, **kwargs):
            if next(left, None) is None:
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
    with faces.staged_package(faces.Folder(place)) as stage:
        shutil.copytree(VALID / "one-gaussian", stage, dirs_exist_ok=True)


def give_up(place):
    with suppress(RuntimeError), faces.staged_package(faces.Folder(place)):
        raise RuntimeError


RUNS = {
    "set-view": lambda place: faces.set_view(place, up=(0, -1, 0)),
    "replace": replace_package,
    "frames": lambda place: faces.airgs_decode([MOVING, "-o", f"{place.parent}/frames/", "--frames", "0:2"]),
    "a file": lambda place: faces.airgs_decode([MOVING, "-o", f"{place.parent}/a.splat", "--frames", "1"]),
}


def files_of(folder):
    return {path.relative_to(folder): path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize("name", RUNS)
def test_whatever_the_moment_of_a_kill(tmp_path, monkeypatch, name):
    def prepared(folder):
        return shutil.copytree(VALID / "placed", tmp_path / folder / "placed.airgs")

    gc.collect()  # temporary folders of other tests go before calls are counted
    RUNS[name](prepared("unbroken"))
    expected, before = files_of(tmp_path / "unbroken"), files_of(prepared("before").parent)
    for steps in range(1000):
        place = prepared(f"{steps}")
        if not dies(monkeypatch, lambda place=place: RUNS[name](place), steps):
            break
        assert not place.exists() or faces.validate(place) == []
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


@pytest.mark.parametrize("inside", ["a", ""], ids=["frames", "a file"])
def test_what_a_living_run_writes_is_left_alone(tmp_path, inside):
    """Another run writes to the same place meanwhile and ends: then the first, all of it."""
    write = whole.staged_files if inside else whole.atomic_path
    with write(tmp_path / "out") as first:
        with write(tmp_path / "out") as second:
            (second / inside).write_bytes(b"second")
        (first / inside).write_bytes(b"first")
    assert (tmp_path / "out" / inside).read_bytes() == b"first" and len(files_of(tmp_path)) == 1 + bool(inside)


def test_no_view_is_lost_where_many_are_set_at_once_and_a_second_writer_is_refused(tmp_path, monkeypatch, capsys):
    """While a package is made it may be changed, but not made twice; while one grows, neither."""
    place = shutil.copytree(VALID / "placed", tmp_path / "placed.airgs")
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: faces.set_view(place, view=((1, 1, n), (0, 0, -1)), name=str(n)), range(24)))
    assert {str(n) for n in range(24)} <= {one.name for one in faces.open_package(place).manifest.region.places}
    monkeypatch.setattr(whole, "WAIT_S", 0.0)
    change = ["set-view", str(place), "--up", "-y"]
    with faces.staged_package(faces.Folder(place)) as stage:
        shutil.copytree(VALID / "moving", stage, dirs_exist_ok=True)
        with pytest.raises(faces.ConfigError, match="another run that is making this package"):
            give_up(place)
        assert faces.airgs_manifest(change) == 0
    assert faces.open_package(place).manifest.region == faces.open_package(VALID / "moving").manifest.region
    with whole.written_alone(place):
        with pytest.raises(faces.ConfigError, match="another run that is writing there"):
            give_up(place)
        assert faces.airgs_manifest(change) == 2 and "another run that is writing there" in capsys.readouterr().err
    assert names_in(tmp_path) == [place.name] and faces.validate(place) == []
