"""Faults beside the work: a disk that is full, SIGINT, kill -9, a clock that jumps, a store that fails.

After each the command has said one line and ended with 2 (130 after SIGINT), or has done its work; what was there is
whole, nothing half-written lies beside it, and the same command does its work when the fault is over. Trainings that
are killed and resumed until they end have the frames and the record of an unbroken one. A full disk is a small tmpfs,
which only root can mount. Each function takes how often, a seed and a folder, and gives what it did and what was wrong.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from tests import faces
from tests.support.faulty import Weather, faultily_serving
from tests.support.growing import Growing
from tests.support.mutations import Files, read_files
from tests.support.paths import FOX_VIEWS
from tests.support.scenes import moving_frames, write_sequence

OPTIONS = ["--x264-preset", "ultrafast", "--calibrate", "none", "--measure-pictures", "0"]
SETTINGS = faces.EncodeSettings(
    preset="ultrafast", calibrate="none", measure_pictures=0, decide_pictures=1, group_frames=2, threads=1
)
PLACES = ("target", "--work", "TMPDIR", "XDG_CACHE_HOME")  # what lies on the disk that is full
Told = Iterator[tuple[str, str]]


def begin(scene: Path, target: Path, *more: str, command: str = "encode", **environment: str) -> subprocess.Popen[str]:
    code = f"import sys; from airgs_codec.cli.{command} import main; sys.exit(main(sys.argv[1:]))"
    options = OPTIONS if command == "encode" else ["--json", "--iterations", "120,60,30", "--budget", "1500"]
    words = [sys.executable, "-c", code, str(scene), "-o", str(target), *options, *more]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    reset = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # which a shell ignores for what is in the background
    return subprocess.Popen(words, **pipes, preexec_fn=reset, text=True, env=os.environ | environment)  # type: ignore[call-overload]


def judge(code: int, said: str, allowed: Iterable[int], target: Path, beside: Iterable[Path] = ()) -> str:
    wrong = [] if code in allowed else [f"exit code {code}"]
    wrong += [f"said {said!r}"] if code > 0 and said.count("\n") != 1 else []
    wrong += [str(finding) for finding in (faces.validate(target) if target.exists() else [])]
    wrong += [f"left {path.name}" for path in beside]
    return "; ".join(wrong)


def scene_in(folder: Path) -> Path:
    return write_sequence(folder / "scene", moving_frames(500, 6))


def fill_disks(times: int, seed: int, folder: Path) -> Told:
    """Encodes with the target, the store of work, temporary files or the cache on a disk of too few bytes."""
    chance, scene, disk = random.Random(seed), scene_in(folder), folder / "disk"
    for number in range(0 if os.geteuid() else times):
        what = PLACES[number % len(PLACES)]
        with mounted(disk):
            target = (disk if what == "target" else folder / "beside") / "out.airgs"
            target.parent.mkdir(exist_ok=True)
            more = ["--work", str(disk / "work")] if what == "--work" else []
            environment = {what: str(disk)} if what.isupper() else {}
            assert begin(scene, target).wait() == 0
            size = shutil.disk_usage(disk).used // 1024 + chance.randrange(150)
            resize(disk, f"{size}k")
            process = begin(scene, target, *more, "--quality", "high", **environment)
            said = process.communicate()[1]
            beside = [path for path in target.parent.iterdir() if path not in (target, disk / "work")]
            wrong = judge(process.returncode, said, (0, 2), target, [] if what.isupper() else beside)
            resize(disk, "64m")
            if not wrong and begin(scene, target, *more, **environment).wait():
                wrong = "cannot be done again"
            yield f"{what} on a disk of {size} kB: {process.returncode}, {said.strip()[-100:]}", wrong


@contextmanager
def mounted(disk: Path) -> Iterator[None]:
    disk.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", disk], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", disk], check=True)


def resize(disk: Path, size: str) -> None:
    subprocess.run(["mount", "-o", f"remount,size={size}", disk], check=True)


def interrupt(times: int, seed: int, folder: Path) -> Told:
    """SIGINT at any moment of an encode after its imports, in which Python ends with a traceback; kill -9 at any."""
    chance, scene, target = random.Random(seed), scene_in(folder), folder / "out" / "out.airgs"
    target.parent.mkdir()
    took = []
    for more, code in (([], 0), (["--quality", "none"], 2)):  # the whole encode, and its imports
        began = time.perf_counter()
        assert begin(scene, target, *more).wait() == code
        took.append(time.perf_counter() - began)
    for number in range(times):
        sent = (signal.SIGINT, signal.SIGKILL)[number % 2]
        into = target if number % 5 else target.with_name("fresh.airgs")
        after = chance.uniform(took[1] if sent == signal.SIGINT else 0.1, 1.1 * took[0])
        process = begin(scene, into, *(["--jobs", "2"] if number % 3 == 2 else []))
        time.sleep(after)
        process.send_signal(sent)
        said = process.communicate()[1]
        beside = [path for path in target.parent.iterdir() if path.suffix != ".airgs" and sent == signal.SIGINT]
        yield (
            f"{sent.name} after {after:.2f} s of {took[0]:.2f}: {process.returncode}, {said.strip()[-100:]}",
            judge(process.returncode, said, (0, 130, -sent), into, beside),
        )
        process = begin(scene, into)
        yield "once more", judge(process.wait(), process.communicate()[1], (0,), into)


def kill_trainings(times: int, seed: int, folder: Path) -> Told:
    """kill -9 at any moment of trainings of the embedded views, which are resumed until they end."""
    chance, began, kills, run = random.Random(seed), time.perf_counter(), 0, 0
    assert begin(FOX_VIEWS, folder / "unbroken", command="train").wait() == 0
    whole, expected = time.perf_counter() - began, trained(folder / "unbroken")
    while kills < times:
        run, code = run + 1, -signal.SIGKILL
        while code == -signal.SIGKILL:
            process = begin(FOX_VIEWS, folder / f"run{run}", "--resume", command="train")
            with suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=chance.uniform(0.1, 0.8 * whole))
            process.kill()
            kills += (code := process.wait()) == -signal.SIGKILL
        same = code == 0 and trained(folder / f"run{run}") == expected
        yield f"training {run}, {kills} kills so far", "" if same else f"exit code {code}, or another end"


def trained(model: Path) -> tuple[Files, dict[str, object]]:
    """The frames and the record that a training ends with, without the seconds, which are the machine's."""
    found = {name: data for name, data in read_files(model).items() if name.endswith(".ply")}
    record = json.loads((model / "training.json").read_text())
    for frame in record["frames"]:
        del frame["seconds"]
    return found, record


@dataclass
class Clock:
    """Stands in for the modules `time` and `datetime`: each look may be later by up to an hour, or earlier."""

    chance: random.Random
    back: bool  # whether it may go back, which a monotonic clock never does
    jumped_s: float = 0.0

    def time(self) -> float:
        if self.chance.random() < (0.5 if self.back else 0.1):
            self.jumped_s += self.chance.uniform(-3600 if self.back else 0, 3600)
        return time.time() + self.jumped_s

    def now(self, zone: object) -> datetime:
        return datetime.now(zone) + timedelta(seconds=self.time() - time.time())  # type: ignore[arg-type]

    def module(self) -> SimpleNamespace:
        return SimpleNamespace(time=self.time, monotonic=self.time, sleep=lambda seconds: None)


def jump(times: int, seed: int, folder: Path) -> Told:
    chance, scene = random.Random(seed), scene_in(folder)
    for number in range(times):
        target, clock, wrong = folder / f"jumped{number}", Clock(chance, back=True), ""
        dates = SimpleNamespace(now=clock.now, fromtimestamp=datetime.fromtimestamp)
        clocks = patch.multiple("airgs_codec.encoder.live", time=clock.module(), datetime=dates)
        with clocks, patch("airgs_codec.package.publish.datetime", dates):
            for _ in publish(scene, target):
                wrong = wrong or judge(0, "", (0,), target)
        yield f"publisher, {clock.jumped_s:.0f} s", wrong or judge(0, "", (0,), target)
        growing, clock = Growing(folder / f"growing{number}", *range(50, 66), 0), Clock(chance, back=False)
        rules = faces.SessionSettings(startup_s=0.0, resume_s=0.0, decode_frame_s=0.0)
        settings = faces.HttpSettings(as_fast=True)
        with (
            patch("airgs_codec.play.http.time", clock.module()),
            patch("airgs_codec.play.player.POLL_S", 0.0),
            faultily_serving(growing.folder, Weather(0.0)) as port,
            faces.HttpDownloader(f"http://127.0.0.1:{port}", settings, growing.received) as link,
        ):
            log = faces.play(link.open(), link, "fixed:0", rules)
        shown = [s.segment for s in log.shown]
        lost = "" if shown and not log.lost and shown == sorted(shown) else f"showed {shown}, lost {log.lost}"
        yield f"player, {clock.jumped_s:.0f} s", lost


def publish(scene: Path, target: Path) -> Iterator[object]:
    return faces.follow(faces.GrowingFolder(scene), target, SETTINGS, more=lambda count: False)


@contextmanager
def failing(folder: Path, calls: int) -> Iterator[list[str]]:
    """A folder of which one call fails, behind so many others, and all that follow; gives what is said of it."""
    done = count()
    said: list[str] = []

    def wrapped(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(place: faces.Folder, *arguments: Any) -> Any:
            if place.path == folder and next(done) >= calls:
                raise faces.TransportError("store: it does not answer")
            return method(place, *arguments)

        return call

    broken: dict[str, Any] = {
        name: wrapped(getattr(faces.Folder, name)) for name in ("open", "sizes", "write", "delete")
    }
    with patch.multiple(faces.Folder, **broken):
        try:
            yield said
        except faces.TransportError as error:
            said.append(str(error))


def fail(times: int, seed: int, folder: Path) -> Told:
    """Encodes whose store, and a live publisher whose package, fails at any call."""
    chance, scene, target = random.Random(seed), scene_in(folder), folder / "failed" / "out.airgs"
    sequence = faces.open_sequence(scene)
    faces.encode(sequence, target, SETTINGS)
    expected = read_files(target)
    for number in range(times):
        store, calls = folder / f"store{number}", chance.randrange(40)
        with failing(store, calls) as said:
            faces.encode(sequence, target, SETTINGS, work=store)
        beside = [path for path in target.parent.iterdir() if path != target]
        wrong = judge(0, "", (0,), target, beside)
        faces.encode(sequence, folder / "again", SETTINGS, work=store)
        same = read_files(folder / "again") == read_files(target) == expected
        yield f"store, after {calls} calls: {said}", wrong or ("" if same else "other bytes")
        grown, calls = folder / f"grown{number}", chance.randrange(20)
        with failing(grown, calls) as said:
            list(publish(scene, grown))
        found = faces.validate(grown) if grown.exists() else []
        ahead = ("foreign_file", "mpd_mismatch")  # manifest.mpd may be a group ahead of what could be written
        wrong = "; ".join(str(finding) for finding in found if finding.reason not in ahead)
        list(publish(scene, grown))
        yield f"package that grows, after {calls} calls: {said}", wrong or judge(0, "", (0,), grown)
