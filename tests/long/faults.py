"""Faults beside the work: a disk that is full, SIGINT, kill -9, a clock that jumps, a store that fails.

    python -m tests.long.faults [--rounds 20] [--seed 0]

After each the command has said one line and ended with 2 (130 after SIGINT), or has done its work; what was there is
whole, nothing half-written lies beside it, and the same command does its work when the fault is over. Trainings that
are killed and resumed until they end have the frames and the record of an unbroken one. Prints a line a fault; exit 1
if it was otherwise. A full disk is a small tmpfs, which only root can mount.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

from airgs_codec.encoder import live
from airgs_codec.package import publish
from airgs_codec.places.place import PLAIN, Place
from airgs_codec.play import http, player
from tests.faces import (
    EncodeSettings,
    Folder,
    GrowingFolder,
    SessionSettings,
    Store,
    TransportError,
    Work,
    encode,
    open_sequence,
    play,
    validate,
)
from tests.support.faulty import Weather, faultily_serving
from tests.support.growing import Growing
from tests.support.mutations import Files, read_files
from tests.support.paths import FOX_VIEWS
from tests.support.scenes import moving_frames, write_sequence

OPTIONS = ["--x264-preset", "ultrafast", "--calibrate", "none", "--measure-pictures", "0"]
SETTINGS = EncodeSettings(
    preset="ultrafast", calibrate="none", measure_pictures=0, decide_pictures=1, group_frames=2, threads=1
)
PLACES = ("target", "--work", "TMPDIR", "XDG_CACHE_HOME")  # what lies on the disk that is full


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
    wrong += [str(finding) for finding in (validate(target) if target.exists() else [])]
    wrong += [f"left {path.name}" for path in beside]
    return "; ".join(wrong)


def fill_disks(rounds: int, chance: random.Random, scene: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Encodes with the target, the store of work, temporary files or the cache on a disk of too few bytes."""
    if os.geteuid():
        return
    for number in range(rounds):
        disk, what = folder / "disk", PLACES[number % len(PLACES)]
        with mounted(disk):
            (target := (disk if what == "target" else folder) / "out.airgs").parent.mkdir(exist_ok=True)
            more = ["--work", str(disk / "work")] if what == "--work" else []
            environment = {what: str(disk)} if what.isupper() else {}
            assert begin(scene, target).wait() == 0
            size = shutil.disk_usage(disk).used // 1024 + chance.randrange(150)
            resize(disk, f"{size}k")
            process = begin(scene, target, *more, "--quality", "high", **environment)
            said = process.communicate()[1]
            beside = [path for path in target.parent.iterdir() if path not in (target, disk, disk / "work")]
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


def interrupt(rounds: int, chance: random.Random, scene: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """SIGINT at any moment of an encode after its imports, in which Python ends with a traceback; kill -9 at any."""
    target = folder / "interrupted" / "out.airgs"
    target.parent.mkdir()
    began = time.perf_counter()
    assert begin(scene, target).wait() == 0
    whole = time.perf_counter() - began
    began = time.perf_counter()
    assert begin(scene, target, "--quality", "none").wait() == 2  # after the imports
    idle = time.perf_counter() - began
    for number in range(2 * rounds):
        sent = (signal.SIGINT, signal.SIGKILL)[number % 2]
        into = target if number % 5 else target.with_name("fresh.airgs")
        after = chance.uniform(idle if sent == signal.SIGINT else 0.1, 1.1 * whole)
        process = begin(scene, into, *(["--jobs", "2"] if number % 3 == 2 else []))
        time.sleep(after)
        process.send_signal(sent)
        said = process.communicate()[1]
        beside = [path for path in target.parent.iterdir() if path.suffix != ".airgs" and sent == signal.SIGINT]
        yield (
            f"{sent.name} after {after:.2f} s of {whole:.2f}: {process.returncode}, {said.strip()[-100:]}",
            judge(process.returncode, said, (0, 130, -sent), into, beside),
        )
        process = begin(scene, into)
        yield "once more", judge(process.wait(), process.communicate()[1], (0,), into)


def kill_trainings(rounds: int, chance: random.Random, scene: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """kill -9 at any moment of trainings of the embedded views, which are resumed until they end."""
    began, kills, run = time.perf_counter(), 0, 0
    assert begin(FOX_VIEWS, folder / "unbroken", command="train").wait() == 0
    whole, expected = time.perf_counter() - began, trained(folder / "unbroken")
    while kills < rounds:
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
        """See `time.time`."""
        if self.chance.random() < (0.5 if self.back else 0.1):
            self.jumped_s += self.chance.uniform(-3600 if self.back else 0, 3600)
        return time.time() + self.jumped_s

    def now(self, zone: object) -> datetime:
        """See `datetime.now`."""
        return datetime.now(zone) + timedelta(seconds=self.time() - time.time())  # type: ignore[arg-type]

    def module(self) -> SimpleNamespace:
        """What stands in for the module `time`."""
        return SimpleNamespace(time=self.time, monotonic=self.time, sleep=lambda seconds: None)


def jump(rounds: int, chance: random.Random, scene: Path, folder: Path) -> Iterator[tuple[str, str]]:
    for number in range(rounds):
        target, clock, wrong = folder / f"jumped{number}", Clock(chance, back=True), ""
        dates = SimpleNamespace(now=clock.now, fromtimestamp=datetime.fromtimestamp)
        with patch.multiple(live, time=clock.module(), datetime=dates), patch.object(publish, "datetime", dates):
            for _ in live.follow(GrowingFolder(scene), target, SETTINGS, more=lambda count: False):
                wrong = wrong or judge(0, "", (0,), target)
        yield f"publisher, {clock.jumped_s:.0f} s", wrong or judge(0, "", (0,), target)
        growing, clock = Growing(folder / f"growing{number}", *range(50, 66), 0), Clock(chance, back=False)
        with (
            patch.object(http, "time", clock.module()),
            patch.object(player, "POLL_S", 0.0),
            faultily_serving(growing.folder, Weather(0.0)) as port,
            http.HttpDownloader(f"http://127.0.0.1:{port}", http.HttpSettings(as_fast=True), growing.received) as link,
        ):
            log = play(link.open(), link, "fixed:0", SessionSettings(startup_s=0.0, resume_s=0.0, decode_frame_s=0.0))
        shown = [s.segment for s in log.shown]
        lost = "" if shown and not log.lost and shown == sorted(shown) else f"showed {shown}, lost {log.lost}"
        yield f"player, {clock.jumped_s:.0f} s", lost


@dataclass(eq=False)
class Failing(Place):
    """A place of which one call fails, and all that follow."""

    inner: Place
    calls: int  # until then
    name: str = "store"

    def _call(self) -> Place:
        self.calls -= 1
        if self.calls < 0:
            raise TransportError("store: it does not answer")
        return self.inner

    def open(self, path: str) -> tuple[int, Callable[[], bytes]] | None:
        """See `Place.open`."""
        found = self._call().open(path)
        if found is None:
            return None
        size, read = found

        def read_it() -> bytes:
            self._call()
            return read()

        return size, read_it

    def sizes(self) -> dict[str, int]:
        """See `Place.sizes`."""
        return self._call().sizes()

    def write(self, path: str, data: bytes, headers: Mapping[str, str] = PLAIN) -> None:
        """See `Place.write`."""
        self._call().write(path, data, headers)

    def delete(self, paths: Iterable[str]) -> None:
        """See `Place.delete`."""
        self._call().delete(paths)


def fail(rounds: int, chance: random.Random, scene: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Encodes whose store, and a live publisher whose package, fails at any call."""
    sequence, target = open_sequence(scene), folder / "failed" / "out.airgs"
    encode(sequence, target, SETTINGS)
    expected = read_files(target)
    for number in range(rounds):
        store, said = Failing(Folder(folder / f"store{number}"), chance.randrange(40)), "nothing failed"
        try:
            encode(sequence, target, SETTINGS, work=Work(Store(store)))
        except TransportError as error:
            said = str(error)
        beside = [path for path in target.parent.iterdir() if path != target]
        wrong = judge(0, "", (0,), target, beside)
        encode(sequence, folder / "again", SETTINGS, work=Work(Store(store.inner)))
        same = read_files(folder / "again") == read_files(target) == expected
        yield f"store, {store.calls} calls left: {said}", wrong or ("" if same else "other bytes")
        grown, said = folder / f"grown{number}", "nothing failed"
        place = Failing(Folder(grown), chance.randrange(20))
        with (
            patch.object(live, "place_at", lambda path: Folder(path)),
            patch.object(live, "GrowingPackage", growing_at(place)),
        ):
            try:
                list(live.follow(GrowingFolder(scene), grown, SETTINGS, more=lambda count: False))
            except TransportError as error:
                said = str(error)
        wrong = judge_growing(grown)
        list(live.follow(GrowingFolder(scene), grown, SETTINGS, more=lambda count: False))
        yield f"package that grows, {place.calls} calls left: {said}", wrong or judge(0, "", (0,), grown)


def growing_at(place: Place) -> Callable[..., publish.GrowingPackage]:
    """What makes a package that grows at a place, whatever place is asked for."""
    return lambda files, *rest: publish.GrowingPackage(place, *rest)


def judge_growing(target: Path) -> str:
    """What is wrong with a package whose publisher could not write any more; manifest.mpd may be a group ahead."""
    ahead = ("foreign_file", "mpd_mismatch")
    return "; ".join(str(finding) for finding in validate(target) if finding.reason not in ahead)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    findings = 0
    for faults in (fill_disks, interrupt, kill_trainings, jump, fail):
        with tempfile.TemporaryDirectory() as name:
            folder, chance = Path(name), random.Random(args.seed)
            scene = write_sequence(folder / "scene", moving_frames(500, 6))
            (folder / faults.__name__).mkdir()
            with patch.dict(os.environ, {"XDG_CACHE_HOME": f"{name}/cache"}):
                for what, wrong in faults(args.rounds, chance, scene, folder / faults.__name__):
                    findings += bool(wrong)
                    print(f"{what}{': ' * bool(wrong)}{wrong}", flush=True)
    print(f"{findings} findings")
    sys.exit(bool(findings))


if __name__ == "__main__":
    main()
