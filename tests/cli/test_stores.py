"""Every command takes the address of an object store where it takes the folder of a package."""

import itertools
import json
import re
import shutil

import pytest

from tests import faces
from tests.support.mutations import read_files
from tests.support.page import put_page
from tests.support.paths import VALID
from tests.support.scenes import moving_frames, write_sequence
from tests.support.servers import put_folder

ENCODE = ["--x264-preset", "ultrafast", "--calibrate", "none", "--measure-pictures", "0"]


@pytest.fixture
def place(bucket, request):
    return f"{bucket}/{request.node.name}/scene.airgs"


@pytest.fixture
def scene(tmp_path):
    return write_sequence(tmp_path / "scene", moving_frames(40, 4))


@pytest.fixture(scope="session")
def package(bucket):
    """An address with a package, which no test changes."""
    address = f"{bucket}/moving"
    with faces.staged_package(faces.place_at(address)) as stage:
        shutil.copytree(VALID / "moving", stage, dirs_exist_ok=True)
    return address


def contents(address):
    files = faces.place_at(address)
    return {name: files.open(name)[1]() for name in files.paths()}


def test_a_package_is_encoded_there_and_replaced(place, scene, capsys):
    assert faces.airgs_encode([str(scene), "-o", place, *ENCODE, "--group-frames", "2"]) == 0
    assert f"{place}: " in capsys.readouterr().out and len(faces.open_package(place).manifest.groups) == 2
    assert faces.airgs_encode([str(scene), "-o", place, *ENCODE, "--group-frames", "4"]) == 0
    assert len(faces.open_package(place).manifest.groups) == 1 and faces.validate(place) == []
    assert faces.airgs_manifest(["rungs", place, str(scene), "--frames", "0", "--draws", "1", "--json"]) == 0
    assert faces.airgs_manifest(["compare", str(scene), place, "--frames", "0", "--json"]) == 0


def test_a_page_is_exported_as_from_the_folder(package, tmp_path, monkeypatch):
    put_page(tmp_path / "page", monkeypatch)
    for place, out in ((package, "there"), (VALID / "moving", "here")):
        assert faces.airgs_manifest(["export-page", str(place), "-o", str(tmp_path / out)]) == 0
    assert read_files(tmp_path / "there") == read_files(tmp_path / "here")


def test_reading_is_as_from_the_folder(package, tmp_path, capsys):
    trace, study = ["--trace", "const:5"], ["--policies", "throughput", "--offsets", "1", "--jobs", "1", "--json"]
    commands = [
        lambda place, out: faces.airgs_manifest(["inspect", place, "--json"]),
        lambda place, out: faces.airgs_manifest(["validate", place]),
        lambda place, out: faces.airgs_decode([place, "-o", str(out / "frames"), "--frames", "1:3"]),
        lambda place, out: faces.airgs_play([place, *trace, "--json"]),
        lambda place, out: faces.airgs_play([place, "--compare", "--traces", "const:5", *study]),
    ]
    said = {}
    for place in (package, str(VALID / "moving")):
        out = tmp_path / place.partition(":")[0].strip("/").replace("/", "-")
        out.mkdir()
        assert [command(place, out) for command in commands] == [0] * len(commands)
        words = re.sub(r'("solve_\w+": )[^,\n]+', r"\1…", capsys.readouterr().out)  # seconds of a solver
        said[place] = words.replace(str(out), ""), read_files(out)
    assert said[package] == said[str(VALID / "moving")]


def test_a_growing_package_is_readable_after_every_group(place, scene, monkeypatch):
    from airgs_codec.cli import encode as module

    ticks = itertools.count()
    monkeypatch.setattr(module, "frames_may_come", lambda idle: lambda frames: next(ticks) < 1)
    seen, report = [], module.report_groups

    def watched(groups, target, as_json):
        def each():
            for published in groups:
                m = faces.open_package(target).manifest
                seen.append((m.live, len(m.groups), faces.validate(target)))
                yield published

        report(each(), target, as_json)

    monkeypatch.setattr(module, "report_groups", watched)
    assert faces.airgs_encode([str(scene), "-o", place, *ENCODE, "--follow", "--group-frames", "1"]) == 0
    m = faces.open_package(place).manifest
    assert [count for _, count, _ in seen] == list(range(1, len(m.groups) + 1)) and len(seen) > 1
    assert all(live and not findings for live, _, findings in seen)
    assert not m.live and faces.validate(place) == []


@pytest.mark.parametrize(
    ("address", "environment", "expected"),
    [
        ("s3://nowhere/scene", {}, "bucket does not exist"),
        ("s3://scenes/nothing", {}, "expected a package"),
        ("az://container/x", {}, "no credentials"),
        ("ftp://host/x", {}, "expected a folder or an address of s3://"),
    ],
)
def test_what_cannot_be_read_is_one_line(bucket, monkeypatch, capsys, address, environment, expected):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert faces.airgs_manifest(["inspect", address]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and address in error and expected in error


def test_a_bucket_that_is_not_there_is_told_before_the_work(bucket, scene, capsys):
    assert faces.airgs_encode([str(scene), "-o", "s3://nowhere/scene", *ENCODE]) == 2
    assert "bucket does not exist" in capsys.readouterr().err


def test_a_changed_object_is_refused(place, capsys):
    with faces.staged_package(faces.place_at(place)) as stage:
        shutil.copytree(VALID / "moving", stage, dirs_exist_ok=True)
    files = faces.place_at(place)
    name = next(name for name in files.paths() if name.startswith("state/"))
    files.write(name, b"of another package")
    files.write("state/L0/999.m4s", b"of nobody")
    assert faces.airgs_manifest(["validate", place, "--json"]) == 1
    reasons = {finding["reason"] for finding in json.loads(capsys.readouterr().out)}
    assert {"size_mismatch", "foreign_file"} <= reasons


def test_a_sequence_is_encoded_from_there(place, scene, tmp_path, capsys):
    (scene / "ATTRIBUTION.txt").write_text("Somebody")
    source = put_folder(scene, f"{place}/scene")
    assert faces.airgs_encode([source, *ENCODE]) == 0
    assert faces.airgs_encode([str(scene), "-o", str(tmp_path / "here.airgs"), *ENCODE]) == 0
    there, here = contents(f"{source}.airgs"), read_files(tmp_path / "here.airgs")
    assert there == here and faces.open_package(f"{source}.airgs").manifest.attribution == "Somebody"
    capsys.readouterr()
    frame = ["--frames", "0", "--draws", "1", "--json"]
    assert faces.airgs_manifest(["rungs", f"{source}.airgs", source, *frame]) == 0
    assert faces.airgs_manifest(["compare", source, f"{source}.airgs", "--frames", "0", "--json"]) == 0
    assert faces.airgs_encode([source, "--follow"]) == 2
    assert f"expected a folder of this machine, got {source}" in capsys.readouterr().err
