"""Every command takes the address of an object store where it takes the folder of a package."""

import itertools
import re
import shutil

import pytest

from tests import faces
from tests.support.mutations import read_files
from tests.support.page import put_page
from tests.support.paths import VALID
from tests.support.scenes import moving_frames, write_sequence
from tests.support.servers import put_folder

MOVING = VALID / "moving"
ENCODE = ["--x264-preset", "ultrafast", "--calibrate", "none", "--measure-pictures", "0"]


@pytest.fixture
def place(bucket, request):
    return f"{bucket}/{request.node.name}/scene.airgs"


@pytest.fixture
def scene(tmp_path):
    return write_sequence(tmp_path / "scene", moving_frames(40, 3))


def put_moving(address):
    with faces.staged_package(faces.place_at(address)) as stage:
        shutil.copytree(MOVING, stage, dirs_exist_ok=True)
    return address


@pytest.fixture(scope="session")
def package(bucket):
    return put_moving(f"{bucket}/moving")


def test_a_sequence_is_encoded_from_there_and_replaces_what_is_there(place, scene, tmp_path, capsys):
    (scene / "ATTRIBUTION.txt").write_text("Somebody")
    source = put_folder(scene, f"{place}/scene")
    target = put_moving(f"{source}.airgs")
    assert faces.airgs_encode([source, *ENCODE]) == 0
    assert f"{target}: " in capsys.readouterr().out and faces.validate(target) == []
    assert faces.open_package(target).manifest.attribution == "Somebody"
    assert faces.airgs_encode([str(scene), "-o", str(tmp_path / "here.airgs"), *ENCODE]) == 0
    files = faces.place_at(target)
    assert {name: files.open(name)[1]() for name in files.paths()} == read_files(tmp_path / "here.airgs")
    assert faces.airgs_manifest(["rungs", target, source, "--frames", "0", "--draws", "1", "--json"]) == 0
    assert faces.airgs_manifest(["compare", source, target, "--frames", "0", "--json"]) == 0
    assert faces.airgs_encode([source, "--follow"]) == 2
    assert f"expected a folder of this machine, got {source}" in capsys.readouterr().err


def test_reading_and_exporting_are_as_from_the_folder(package, tmp_path, monkeypatch, capsys):
    put_page(tmp_path / "page", monkeypatch)
    trace, study = ["--trace", "const:5"], ["--policies", "throughput", "--offsets", "1", "--jobs", "1", "--json"]
    said = {}
    for place in (package, str(MOVING)):
        out = tmp_path / place.partition(":")[0].strip("/").replace("/", "-")
        assert faces.airgs_manifest(["inspect", place, "--json"]) == 0
        assert faces.airgs_manifest(["validate", place]) == 0
        assert faces.airgs_decode([place, "-o", str(out / "frames"), "--frames", "1:3"]) == 0
        assert faces.airgs_manifest(["export-page", place, "-o", str(out / "site")]) == 0
        assert faces.airgs_play([place, *trace, "--json"]) == 0
        assert faces.airgs_play([place, "--compare", "--traces", "const:5", *study]) == 0
        words = re.sub(r'("solve_\w+": )[^,\n]+', r"\1…", capsys.readouterr().out)  # seconds of a solver
        said[place] = words.replace(str(out), ""), read_files(out)
    assert said[package] == said[str(MOVING)]


def test_a_growing_package_is_readable_after_every_group(place, scene, monkeypatch):
    ticks, said, seen = itertools.count(), [], []

    def say(text):
        m = faces.open_package(place).manifest
        said.append(text)
        seen.append((m.live, len(m.groups), faces.validate(place)))

    monkeypatch.setattr("airgs_codec.cli.encode.frames_may_come", lambda idle: lambda frames: next(ticks) < 1)
    monkeypatch.setattr("airgs_codec.cli.encode.say", say)
    assert faces.airgs_encode([str(scene), "-o", place, *ENCODE, "--follow", "--group-frames", "1"]) == 0
    assert [line.partition(",")[0] for line in said[:3]] == [f"group {n}: frames {n - 1}-{n - 1}" for n in (1, 2, 3)]
    assert said[3:] == [f"{place}: 3 frames in 3 groups, closed"]
    assert seen == [(True, 1, []), (True, 2, []), (True, 3, []), (False, 3, [])]


@pytest.mark.parametrize(("address", "expected"), [
    ("s3://nowhere/scene", "bucket does not exist"), ("s3://scenes/nothing", "expected a package"),
    ("az://container/x", "no credentials"), ("ftp://host/x", "expected a folder or an address of s3://"),
])  # fmt: skip
def test_what_cannot_be_read_or_written_is_one_line(bucket, scene, capsys, address, expected):
    assert faces.airgs_manifest(["inspect", address]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and address in error and expected in error
    if "nothing" not in address:
        assert faces.airgs_encode([str(scene), "-o", address, *ENCODE]) == 2
        assert expected in capsys.readouterr().err
