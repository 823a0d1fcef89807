"""An encode on a Dask cluster whose workers, scheduler and store fail at random: the same bytes in the end.

    python -m tools.soak_farm -o OUT [--groups 50] [--kills 50] [--workers 2] [--seed 0]

A made sequence is encoded by one process, and by a cluster of this machine in which, every few seconds, a worker or the
scheduler is killed (SIGKILL), or a result in the store is cut short or deleted; writes to the store are slow at random,
and some fail as on a full disk. What ends is begun again: workers and the scheduler by a supervisor, the encode as its
user would repeat it. Failures go on until there were as many as asked for; then the encode may finish. Writes
OUT/soak.json and OUT/jobs.html; exit status 1 where the packages differ.
"""

from __future__ import annotations

import argparse
import errno
import filecmp
import json
import os
import pickle
import random
import shutil
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from airgs_codec._files import write_json
from airgs_codec.cli.common import Bar, run_command
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError
from airgs_codec.jobs.dask_engine import DaskEngine
from airgs_codec.jobs.report import write_report
from airgs_codec.jobs.store import WorkFolder
from airgs_codec.jobs.work import Work
from airgs_codec.scene.sequence import open_sequence
from tools.bench_scale import make_scene

GROUP_FRAMES, ROWS = 4, 2_000
SETTINGS = EncodeSettings(
    calibrate="none", group_frames=GROUP_FRAMES, measure_pictures=1, decide_pictures=4, preset="veryfast", threads=1
)
PAUSE_S = 1.5  # between two failures
SLOW, SLOW_S, FULL = 0.05, 0.5, 0.01  # share of writes that take longer, how much, and share that fail
FAULTS = ("worker", "worker", "worker", "scheduler", "cut", "deleted")


@dataclass(frozen=True, slots=True)
class FaultyFolder(WorkFolder):
    """A store whose writes are slow or fail at random."""

    def write(self, entry: str, data: bytes) -> None:
        """Put an entry. Raises OSError as on a full disk, now and then."""
        chance = random.random()
        if chance < FULL:
            raise OSError(errno.ENOSPC, "No space left on device (made up)", str(self.path))
        if chance < FULL + SLOW:
            time.sleep(SLOW_S)
        WorkFolder.write(self, entry, data)


class Cluster:
    """A scheduler and workers, processes of their own that come back when they die."""

    def __init__(self, workers: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._names = ["scheduler", *(f"worker {number}" for number in range(workers))]

    def keep(self) -> None:
        """Start what is not running."""
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
        """Kill the scheduler or one of the workers."""
        self._running[rng.choice([name for name in self._names if name.startswith(kind)])].kill()

    def close(self) -> None:
        """End all of them."""
        for process in self._running.values():
            process.kill()
            process.wait()


def main(words: Sequence[str] | None = None) -> int:
    """Run it; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument(
        "--groups", type=int, default=50, help="of four frames, each of four jobs or five (default: 50)"
    )
    parser.add_argument("--kills", type=int, default=50, help="failures that are made (default: 50)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="of the failures (default: 0)")
    parser.add_argument("--step", metavar="ADDRESS", help=argparse.SUPPRESS)
    args = parser.parse_args(words)
    work = _step if args.step else _soak
    return run_command("soak_farm", lambda: work(args))


def _step(args: argparse.Namespace) -> int:
    """The encode, as its user would begin it again and again."""
    engine = DaskEngine.at(args.step)
    try:
        work = Work(FaultyFolder(args.output / "work"), engine)
        report = encode(open_sequence(args.output / "scene"), args.output / "farm.airgs", SETTINGS, work=work)
    finally:
        engine.close()
    (args.output / "records.pickle").write_bytes(pickle.dumps(report.records))
    return 0


def _soak(args: argparse.Namespace) -> int:
    out, rng = args.output, random.Random(args.seed)
    if out.exists():
        raise ConfigError(f"{out}: expected a new folder, got one that is there")
    out.mkdir(parents=True)
    make_scene(ROWS, GROUP_FRAMES * args.groups, out / "scene")
    begun = time.perf_counter()
    encode(open_sequence(out / "scene"), out / "one.airgs", SETTINGS)
    alone_s, begun = time.perf_counter() - begun, time.perf_counter()
    cluster, bar = Cluster(args.workers), Bar()
    made: Counter[str] = Counter()
    runs = 0
    try:
        while True:
            cluster.keep()
            words = [sys.executable, "-m", "tools.soak_farm", "-o", str(out), "--step", cluster.address]
            with (out / "runs.log").open("ab") as log:
                command = subprocess.Popen(words, stdout=log, stderr=log)
            runs += 1
            while command.poll() is None:
                time.sleep(PAUSE_S)
                if made.total() < args.kills:
                    _fail(rng.choice(FAULTS), cluster, out / "work", rng, made)
                    bar("failures", made.total(), args.kills)
                cluster.keep()
            if command.returncode == 0 and made.total() >= args.kills:
                break
            if command.returncode == 0:  # finished too early: the package is wanted again, of a store that has suffered
                shutil.rmtree(out / "farm.airgs")
                _fail("deleted", cluster, out / "work", rng, made)
    finally:
        cluster.close()
        bar.close()
    return _report(args, made, runs, (alone_s, time.perf_counter() - begun))


def _fail(fault: str, cluster: Cluster, work: Path, rng: random.Random, made: Counter[str]) -> None:
    """One failure; nothing where there is nothing yet to damage."""
    if fault in ("worker", "scheduler"):
        cluster.kill(fault, rng)
    else:
        entries = sorted(path for path in work.rglob("*") if path.is_file() and not path.name.startswith("."))
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


def _report(args: argparse.Namespace, made: Counter[str], runs: int, seconds: tuple[float, float]) -> int:
    out = args.output
    same = _same(out / "one.airgs", out / "farm.airgs")
    records = pickle.loads((out / "records.pickle").read_bytes())
    write_report(out / "jobs.html", records)
    found = {
        "jobs": len(records), "failures": dict(made), "commands": runs, "same_bytes": same,
        "seconds_of_one_process": round(seconds[0], 1), "seconds": round(seconds[1], 1),
    }  # fmt: skip
    write_json(out / "soak.json", found)
    print(json.dumps(found, indent=1))
    return 0 if same else 1


def _same(one: Path, other: Path) -> bool:
    """Whether two folders have the same files with the same bytes."""
    files = [sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file()) for folder in (one, other)]
    return files[0] == files[1] and not any(filecmp.cmpfiles(one, other, files[0], shallow=False)[1:])


if __name__ == "__main__":
    sys.exit(main())
