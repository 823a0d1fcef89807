"""Full disks, targets that cannot be written, bombs: one line, exit code 2, and what was there stays."""

import errno
import os
import resource
import shutil
import signal
import stat
import subprocess
import sys
from functools import partial

import pytest

from tests import faces
from tests.support.mutations import read_files
from tests.support.paths import FOX, VALID
from tests.support.scenes import moving_frames, write_sequence

MOVING = VALID / "moving"
ENCODE = [sys.executable, "-c", "import sys; from airgs_codec.cli.encode import main; sys.exit(main(sys.argv[1:]))"]


@pytest.fixture
def target(tmp_path):
    """A package where a command will write; nothing else is in its folder."""
    return shutil.copytree(MOVING, tmp_path / "out.airgs")


def test_a_full_disk_leaves_the_old_package(target, tmp_path, tmp_path_factory):
    """The process may write files of at most 4000 bytes."""
    scene = write_sequence(tmp_path_factory.mktemp("scene"), moving_frames(3000, 1))
    words = f"{scene} -o {target} --x264-preset ultrafast --calibrate none --measure-pictures 0".split()
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (4000, 4000))
    done = subprocess.run([*ENCODE, *words], capture_output=True, text=True, preexec_fn=limit, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 2  # the first says what to expect
    assert "airgs-encode: /" in done.stderr and ("too large" in done.stderr or "disk full" in done.stderr)
    assert read_files(target) == read_files(MOVING) and faces.validate(target) == []
    assert [p.name for p in tmp_path.iterdir()] == ["out.airgs"]  # nothing half-written beside it


@pytest.mark.parametrize("fault", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_a_disk_that_takes_nothing_is_named(fault, target, tmp_path, monkeypatch, capsys):
    def fails(*_):
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr(os, "fsync", fails)
    runs = {target / "airgs.json": (faces.airgs_manifest, ["set-view", target, "--up", "-y"])}
    runs[tmp_path / "a.ply"] = faces.airgs_decode, [target, "--frames", "0", "-o", tmp_path / "a.ply"]
    runs[tmp_path / "frames"] = faces.airgs_decode, [target, "-o", f"{tmp_path}/frames/"]
    for path, (main, words) in runs.items():
        assert main([*map(str, words)]) == 2
        assert capsys.readouterr().err.endswith(f": {path}: {os.strerror(fault)}\n")
    assert faces.validate(target) == [] and [path.name for path in tmp_path.iterdir()] == ["out.airgs"]


@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
@pytest.mark.parametrize(
    "name", ["a.ply", "a.splat", "sequence.json", "--audio", "--views", "--transform", "--plan", "--trace"]
)
def test_what_would_be_read_without_an_end_is_refused_before_it_is_opened(kind, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scene = write_sequence(tmp_path / "scene", moving_frames(20, 1))
    path = tmp_path / "odd.json" if name.startswith("--") else scene / name
    for frame in scene.glob("*.ply") if path.suffix in (".ply", ".splat") else ():
        frame.unlink()
    if kind == "device":
        path.symlink_to("/dev/zero")
    else:
        os.mknod(path, stat.S_IFIFO if kind == "pipe" else stat.S_IFSOCK)
    option = [name, str(path)] if name.startswith("--") else []
    main, words = faces.airgs_encode, [str(scene), "-o", "out.airgs"]
    if name == "--trace":
        main, words = faces.airgs_play, [str(MOVING)]
    assert main([*words, *option]) == 2
    told = capsys.readouterr().err
    assert f"{path}: " in told and "a pipe, a device or a socket" in told and told.count("\n") == 1


def test_a_kill_in_the_middle_leaves_the_old_package(target, tmp_path, capsys):
    """`python -m tests.long` does it many times."""
    process = subprocess.Popen([*ENCODE, str(FOX), "-o", str(target)], stdout=subprocess.DEVNULL)
    while process.poll() is None and not list(tmp_path.glob(".out.airgs.airgs-*/new")):
        os.sched_yield()
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert faces.validate(target) == [] and read_files(target) == read_files(MOVING)
    with faces.staged_package(faces.Folder(target)):  # another run at work
        assert faces.airgs_encode([str(FOX), "-o", str(target), "--calibrate", "none"]) == 2
        assert "got another run that is making this package" in capsys.readouterr().err
        assert len(list(tmp_path.glob(".out.airgs.airgs-*"))) == 1  # its folder stays, that of the killed run is gone
    assert not list(tmp_path.glob(".out.airgs.*"))
