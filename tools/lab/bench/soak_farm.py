"""An encode on a Dask cluster whose workers, scheduler and store fail at random: the same bytes in the end.

A made sequence is encoded by one process, and by a cluster of this machine in which, every few seconds, a worker or the
scheduler is killed (SIGKILL), or a result in the store is cut short or deleted; writes to the store are slow at random,
and some fail as on a full disk. What ends is begun again: workers and the scheduler by a supervisor, the encode as its
user would repeat it. Failures go on until there were as many as asked for; then the encode may finish. The folder gets
runs.log, too; exit status 1 where the packages differ.
"""

from __future__ import annotations

import errno
import filecmp
import os
import random
import shutil
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from airgs_codec.cli.terminal import run_command
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError
from airgs_codec.jobs.executors import DaskCluster
from airgs_codec.places import results
from airgs_codec.places.place import PLAIN, Folder
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Section, Table, seconds_of, setting
from tools.lab.made import make_scene

GROUP_FRAMES, ROWS = 4, 2_000
SETTINGS = EncodeSettings(
    calibrate="none", group_frames=GROUP_FRAMES, measure_pictures=1, decide_pictures=4, preset="veryfast", threads=1
)
PAUSE_S = 1.5  # between two failures
SLOW, SLOW_S, FULL = 0.05, 0.5, 0.01  # share of writes that take longer, how much, and share that fail
FAULTS = ("worker", "worker", "worker", "scheduler", "cut", "deleted")
COMMAND = "import sys; from tools.lab.bench.soak_farm import encode_at; sys.exit(encode_at(*sys.argv[1:]))"


@dataclass(frozen=True, slots=True)
class Options:
    groups: int = setting(400, "of four frames, up to eight of which are a job")
    kills: int = setting(50, "failures that are made")
    workers: int = setting(2, "of the cluster")
    seed: int = setting(0, "of the failures")


@dataclass(frozen=True, slots=True)
class FaultyFolder(Folder):
    def write(self, path: str, data: bytes, headers: Mapping[str, str] = PLAIN) -> None:
        """Write a file. Raises OSError as on a full disk, now and then."""
        chance = random.random()
        if chance < FULL:
            raise OSError(errno.ENOSPC, "No space left on device (made up)", str(self.path))
        if chance < FULL + SLOW:
            time.sleep(SLOW_S)
        Folder.write(self, path, data, headers)


class Cluster:
    """A scheduler and workers, processes of their own that come back when they die."""

    def __init__(self, workers: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._names = ["scheduler", *(f"worker {number}" for number in range(workers))]

    def keep(self) -> None:
        for name in self._names:
            if name not in self._running or self._running[name].poll() is not None:
                kind = name.split()[0]
                place = ["--port", self.address.rpartition(":")[2], "--no-dashboard", "--host", "127.0.0.1"]
                if kind == "worker":
                    place = [self.address, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--death-timeout", "10"]
                words = [sys.executable, "-m", "distributed.cli.dask_" + kind, *place]
                quiet = subprocess.DEVNULL
                environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
                self._running[name] = subprocess.Popen(words, stdout=quiet, stderr=quiet, env=environment)

    def kill(self, kind: str, rng: random.Random) -> None:
        self._running[rng.choice([name for name in self._names if name.startswith(kind)])].kill()

    def close(self) -> None:
        for process in self._running.values():
            process.kill()
            process.wait()


def encode_at(address: str, folder: str) -> int:
    """The encode, as its user would begin it again and again, on the cluster at an address; gives its exit status."""

    def work() -> int:
        out = Path(folder)
        with DaskCluster(address) as executor, patch.object(results, "Folder", FaultyFolder):
            encode(open_sequence(out / "scene"), out / "farm.airgs", SETTINGS, executor=executor, work=out / "jobs")
        return 0

    return run_command("encode", work)


def run(options: Options, lab: Lab) -> Page:
    out = lab.folder
    if (out / "scene").exists():
        raise ConfigError(f"{out}: expected a new folder, got one that has been used")
    make_scene(ROWS, GROUP_FRAMES * options.groups, out / "scene")
    alone, _ = seconds_of(lambda: encode(open_sequence(out / "scene"), out / "one.airgs", SETTINGS))
    made: Counter[str] = Counter()
    took, runs = seconds_of(lambda: torment(options, lab, made))
    jobs, same = len(_entries(out / "jobs")), same_files(out / "one.airgs", out / "farm.airgs")
    failures = ", ".join(f"{count} {name}" for name, count in sorted(made.items()))
    row = {"jobs": jobs, "failures": failures, "made": made.total(), "commands": runs, "same bytes": same}
    row |= {"seconds of one process": alone.wall, "seconds of the cluster": took.wall}
    answer = f"After {made.total()} failures the bytes are {'the same' if same else 'NOT the same'}."
    return Page([Section(answer, tables=[Table("soak-farm", [row])])], failed=not same)


def torment(options: Options, lab: Lab, made: Counter[str]) -> int:
    """Let a cluster encode while parts of it fail; gives how often the command was begun."""
    out, rng, cluster, runs = lab.folder, random.Random(options.seed), Cluster(options.workers), 0
    try:
        while True:
            cluster.keep()
            with (out / "runs.log").open("ab") as log:
                words = [sys.executable, "-c", COMMAND, cluster.address, str(out)]
                command = subprocess.Popen(words, stdout=log, stderr=log)
            runs += 1
            while command.poll() is None:
                time.sleep(PAUSE_S)
                if made.total() < options.kills:
                    _fail(rng.choice(FAULTS), cluster, out / "jobs", rng, made)
                    lab.progress("failures", made.total(), options.kills)
                cluster.keep()
            if command.returncode == 0 and made.total() >= options.kills:
                return runs
            if command.returncode == 0:  # finished too early: the package is wanted again, of a store that has suffered
                shutil.rmtree(out / "farm.airgs")
                _fail("deleted", cluster, out / "jobs", rng, made)
    finally:
        cluster.close()


def _fail(fault: str, cluster: Cluster, work: Path, rng: random.Random, made: Counter[str]) -> None:
    if fault in ("worker", "scheduler"):
        cluster.kill(fault, rng)
    else:
        entries = _entries(work)
        if not entries:
            return
        entry = rng.choice(entries)
        try:
            if fault == "deleted":
                entry.unlink()
            else:
                os.truncate(entry, entry.stat().st_size // 2)
        except FileNotFoundError:  # somebody has just replaced it
            return
    made[fault] += 1


def _entries(work: Path) -> list[Path]:
    return sorted(path for path in work.rglob("*") if path.is_file() and not path.name.startswith("."))


def same_files(one: Path, other: Path) -> bool:
    """Return whether two folders have the same files with the same bytes."""
    files = [sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file()) for folder in (one, other)]
    return files[0] == files[1] and not any(filecmp.cmpfiles(one, other, files[0], shallow=False)[1:])
