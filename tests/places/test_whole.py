"""Files are whole or not there, whatever goes wrong while they are written."""

import json
from pathlib import Path

import pytest

from airgs_codec.places import whole
from tests.faces import ConfigError


def test_a_file_takes_its_place_only_when_it_is_whole(tmp_path):
    path = tmp_path / "a.bin"
    whole.write_bytes(path, b"old")
    with pytest.raises(RuntimeError), whole.atomic_path(path) as temporary:
        temporary.write_bytes(b"half")
        assert path.read_bytes() == b"old"
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"] and path.read_bytes() == b"old"
    whole.write_bytes(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"] and path.read_bytes() == b"new"


def test_the_bytes_are_synchronised_before_the_file_has_its_name(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(whole.os, "fsync", lambda _: seen.append((tmp_path / "a.bin").exists()))
    whole.write_bytes(tmp_path / "a.bin", b"new")
    assert seen == [False]


def test_json_has_null_for_what_is_no_number(tmp_path):
    value = {"a": (1.5, float("nan")), "b": [{"c": float("-inf")}], "d": "inf"}
    whole.write_json(tmp_path / "a.json", value)
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [1.5, None], "b": [{"c": None}], "d": "inf"}


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


def test_files_may_be_read_by_whom_the_umask_lets(tmp_path):
    whole.write_bytes(tmp_path / "a.bin", b"new")
    (tmp_path / "b.bin").write_bytes(b"plain")
    assert (tmp_path / "a.bin").stat().st_mode == (tmp_path / "b.bin").stat().st_mode


@pytest.mark.parametrize("there", [True, False], ids=["folder", "dangling"])
def test_a_staged_folder_takes_no_links_place(tmp_path, there):
    if there:
        (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match="got a link"), whole.staged_folder(tmp_path / "out", Path.is_dir, "package"):
        raise AssertionError("unreachable")
    work = tmp_path / f".new.airgs-{'0' * 16}"
    work.symlink_to(tmp_path)
    with whole.staged_folder(tmp_path / "new", Path.is_dir, "package") as stage:
        (stage / "a").touch()
    assert (tmp_path / "new" / "a").is_file() and work.is_symlink()


def test_what_others_put_beside_a_staged_folder_stays(tmp_path):
    """Whatever it is called: without the mark of an unfinished folder it is not ours."""
    others = [".new.x.stage", ".new.backup.old", f".new.airgs-{'0' * 16}", ".new.airgs-notes"]
    for name in others:
        (tmp_path / name / "old").mkdir(parents=True)
        (tmp_path / name / "notes.txt").write_text("of somebody")
    (tmp_path / others[2] / "airgs-unfinished").write_text("not the mark")
    for _ in range(2):
        with whole.staged_folder(tmp_path / "new", Path.is_dir, "package") as stage:
            (stage / "a").touch()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*others, "new"])
    assert all((tmp_path / name / "notes.txt").read_text() == "of somebody" for name in others)


def test_what_others_write_meanwhile_is_not_replaced(tmp_path):
    with pytest.raises(ConfigError, match="other files"), whole.staged_folder(tmp_path / "new", is_ours, "package"):
        (tmp_path / "new").mkdir()
        (tmp_path / "new" / "notes.txt").write_text("of somebody")
    assert [path.name for path in tmp_path.iterdir()] == ["new"]
    assert (tmp_path / "new" / "notes.txt").read_text() == "of somebody"


def is_ours(folder):
    return False
