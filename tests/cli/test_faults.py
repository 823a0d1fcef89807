"""Full disks, targets that cannot be written, bombs: one line, exit code 2, and what was there stays."""

import errno
import os
import resource
import shutil
import signal
import stat
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.faces import (
    Folder,
    FormatError,
    airgs_decode,
    airgs_encode,
    airgs_manifest,
    airgs_play,
    airgs_train,
    decode,
    open_package,
    staged_package,
    validate,
)
from tests.makers.refusals import TABLE
from tests.support.mutations import on_disk, reindexed, set_value
from tests.support.paths import FOX, FOX_VIEWS, VALID
from tests.support.scenes import moving_frames, write_sequence

MOVING = VALID / "moving"
ENCODE = ["--x264-preset", "ultrafast", "--calibrate", "none", "--measure-pictures", "0"]


def command(module, *words, limit=None, check=False):
    """One of our commands as a process that may write files of at most `limit` bytes."""

    def limited():
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    code = f"import sys; from airgs_codec.cli.{module} import main; sys.exit(main(sys.argv[1:]))"
    words = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(words, capture_output=True, text=True, preexec_fn=limited, check=check)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("faults") / "scene", moving_frames(3000, 3))


@pytest.fixture(scope="module")
def encoded(scene):
    path = scene.parent / "encoded.airgs"
    command("encode", scene, "-o", path, *ENCODE, check=True)
    return path


@pytest.fixture
def target(encoded, tmp_path):
    """A package where a command will write; nothing else is in its folder."""
    return shutil.copytree(encoded, tmp_path / "out.airgs")


def test_a_full_disk_leaves_the_old_package(scene, target, tmp_path):
    before = {p: p.read_bytes() for p in target.rglob("*") if p.is_file()}
    done = command("encode", scene, "-o", target, *ENCODE, "--quality", "high", limit=4000)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "airgs-encode: /" in done.stderr and ("too large" in done.stderr or "disk full" in done.stderr)
    assert {p: p.read_bytes() for p in target.rglob("*") if p.is_file()} == before
    assert validate(target) == []
    assert [p.name for p in tmp_path.iterdir()] == ["out.airgs"]  # nothing half-written beside it


@pytest.mark.parametrize("target", ["/proc/out.airgs", "/dev/null/out.airgs"])
def test_a_target_that_cannot_be_written(scene, target):
    done = command("encode", scene, "-o", target, *ENCODE)
    assert done.returncode == 2 and done.stderr.startswith("airgs-encode: ") and done.stderr.count("\n") == 1


@pytest.mark.parametrize("fault", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_a_disk_that_takes_nothing_is_named(fault, target, tmp_path, monkeypatch, capsys):
    def fails(*_):
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr(os, "fsync", fails)
    runs = {target / "airgs.json": (airgs_manifest, ["set-view", target, "--up", "-y"])}
    runs[tmp_path / "a.ply"] = airgs_decode, [target, "--frames", "0", "-o", tmp_path / "a.ply"]
    runs[tmp_path / "frames"] = airgs_decode, [target, "-o", f"{tmp_path}/frames/"]
    for path, (main, words) in runs.items():
        assert main([*map(str, words)]) == 2
        assert capsys.readouterr().err.endswith(f": {path}: {os.strerror(fault)}\n")
    assert validate(target) == [] and [path.name for path in tmp_path.iterdir()] == ["out.airgs"]


@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
@pytest.mark.parametrize("name", ["a.ply", "a.splat", "sequence.json", "--audio", "--views", "--transform", "--trace"])
def test_what_would_be_read_without_an_end_is_refused_before_it_is_opened(
    kind, name, encoded, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    scene = write_sequence(tmp_path / "scene", moving_frames(20, 1))
    path = Path("odd.json") if name.startswith("--") else scene / name
    for frame in scene.glob("*.ply") if path.suffix in (".ply", ".splat") else ():
        frame.unlink()
    if kind == "device":
        path.symlink_to("/dev/zero")
    else:
        os.mknod(path, stat.S_IFIFO if kind == "pipe" else stat.S_IFSOCK)
    option = [name, str(path)] if name.startswith("--") else []
    main, words = (airgs_play, [encoded]) if name == "--trace" else (airgs_encode, [scene, "-o", "out.airgs"])
    assert main([*map(str, words), *option]) == 2
    told = capsys.readouterr().err
    assert f"{path}: " in told and f"expected a plain file, got a {kind}" in told and told.count("\n") == 1


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("count",), 1 << 24),
        (("tiers", 0, "count"), 1 << 24),
        (("stop",), 10**6),
        (("levels", 0, "width"), 16384),
        (("tiers", 0, "qualities", 0, "width"), 16384),
    ],
)
def test_absurd_counts_are_refused_with_little_memory(tmp_path, where, value):
    bomb = on_disk(shutil.copytree(MOVING, tmp_path / "bomb.airgs"), set_value(where, value, TABLE), reindexed)
    with pytest.raises(FormatError):
        decode(open_package(bomb), 0)


def test_a_kill_in_the_middle_leaves_the_old_package(scene, target, tmp_path):
    """`python -m tests.long.faults` does it many times."""
    code = "import sys; from airgs_codec.cli.encode import main; sys.exit(main(sys.argv[1:]))"
    process = subprocess.Popen([sys.executable, "-c", code, str(FOX), "-o", str(target)], stdout=subprocess.DEVNULL)
    while process.poll() is None and not list(tmp_path.glob(".out.airgs.airgs-*/new")):
        os.sched_yield()
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert validate(target) == [] and open_package(target).manifest.frames == 3
    with staged_package(Folder(target)):  # another run at work
        done = command("encode", scene, "-o", target, *ENCODE)
        assert done.returncode == 2 and "got another run that is making this package" in done.stderr
        assert len(list(tmp_path.glob(".out.airgs.airgs-*"))) == 1  # its folder stays, that of the killed run is gone
    assert not list(tmp_path.glob(".out.airgs.*"))


@pytest.mark.parametrize("option", ["--report", "--video", "--plot"])
def test_a_picture_or_report_that_cannot_be_written_is_said_before_the_work(option, scene, encoded, tmp_path, capsys):
    nowhere, output = "/proc/nowhere/x" + ".mp4" * (option == "--video"), tmp_path / "out.airgs"
    runs = {
        "--report": [(airgs_encode, [scene, "-o", output]), (airgs_train, [FOX_VIEWS, "-o", output])],
        "--video": [(airgs_play, [encoded, "--trace", "none"])],  # a trace that is not there would be said first
        "--plot": [(airgs_manifest, ["inspect", encoded])],
    }
    for main, words in runs[option]:
        assert main([*map(str, words), option, nowhere]) == 2
        assert "expected a folder that can be written" in capsys.readouterr().err
        assert not output.exists()


def test_a_disk_without_room_is_said_before_the_work(scene, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1000))
    assert airgs_encode([str(scene), "-o", str(tmp_path / "out.airgs")]) == 2
    assert "GB of room" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_a_film_that_has_no_folder_is_said_before_the_work(encoded, tmp_path, capsys):
    assert airgs_play([str(encoded), "--trace", "none", "--video", str(tmp_path / "nowhere/film.mp4")]) == 2
    assert "expected a folder that can be written" in capsys.readouterr().err
