"""Files are whole or not there, whatever goes wrong while they are written."""

import json

import pytest

from airgs_codec import _files


def test_a_file_takes_its_place_only_when_it_is_whole(tmp_path):
    path = tmp_path / "a.bin"
    _files.write_bytes(path, b"old")
    with pytest.raises(RuntimeError), _files.atomic_path(path) as temporary:
        temporary.write_bytes(b"half")
        assert path.read_bytes() == b"old"
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"] and path.read_bytes() == b"old"
    _files.write_bytes(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"] and path.read_bytes() == b"new"


def test_the_bytes_are_synchronised_before_the_file_has_its_name(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(_files.os, "fsync", lambda _: seen.append((tmp_path / "a.bin").exists()))
    _files.write_bytes(tmp_path / "a.bin", b"new")
    assert seen == [False]


def test_json_has_null_for_what_is_no_number(tmp_path):
    value = {"a": (1.5, float("nan")), "b": [{"c": float("-inf")}], "d": "inf"}
    _files.write_json(tmp_path / "a.json", value)
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [1.5, None], "b": [{"c": None}], "d": "inf"}
