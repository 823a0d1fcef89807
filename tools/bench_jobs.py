"""What sharing work costs and gains: processes on the cores of this machine, and engines with jobs that only wait.

    python -m tools.bench_jobs -o OUT [--frames 120] [--rows 20000] [--jobs 60] [--seconds 5] [--only encode,wait]

encode: a made sequence, encoded by one process with one thread, by two such processes, and as `airgs-encode` does it by
default, one process with a thread for each core; and that the packages are the same. wait: so many jobs of so many
seconds for two workers, over the seconds that they would take if handing them out took no time. Writes OUT/jobs.csv and
prints the table.
"""

from __future__ import annotations

import argparse
import csv
import filecmp
import math
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from airgs_codec.cli.common import run_command
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.jobs.dask_engine import DaskEngine
from airgs_codec.jobs.engines import Engine, InProcess, Processes
from airgs_codec.jobs.job import Job
from airgs_codec.jobs.store import WorkFolder
from airgs_codec.jobs.work import Work
from airgs_codec.scene.sequence import open_sequence
from tools.bench_scale import make_scene

WORKERS = 2
ONE, TWO, DEFAULT = "one process, one thread", "two processes, one thread each", "one process, threads"
SETTINGS = EncodeSettings(calibrate="none", group_frames=10, measure_pictures=4)
PARTS = ("encode", "wait")


@dataclass(frozen=True, slots=True)
class Timed:
    """Seconds by the clock of one way to do one piece of work."""

    work: str
    way: str
    seconds: float
    ideal: float  # of the same work if sharing cost nothing


def main(words: Sequence[str] | None = None) -> int:
    """Run it; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--jobs", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--only", default=",".join(PARTS))
    args = parser.parse_args(words)
    return run_command("bench_jobs", lambda: _bench(args))


def _bench(args: argparse.Namespace) -> int:
    args.output.mkdir(parents=True, exist_ok=True)
    rows: list[Timed] = []
    if "encode" in args.only.split(","):
        rows += encodes(args.rows, args.frames)
    if "wait" in args.only.split(","):
        rows += waits(args.jobs, args.seconds)
    with (args.output / "jobs.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    print(f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}")
    for row in rows:
        print(f"{row.work:32} {row.way:32} {row.seconds:8.1f} s, {row.ideal / row.seconds:6.2f} of the ideal")
    return 0


def encodes(rows: int, frames: int) -> Iterator[Timed]:
    """The same sequence in three ways; the ideal of all but the first is a half of what that takes."""
    work = f"{frames} frames of {rows:,}"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_scene(rows, frames, folder / "scene")
        warm = replace(SETTINGS, threads=1)
        encode(open_sequence(folder / "scene"), folder / "warm", warm)  # compiles, and reads files into memory
        alone = _timed(folder, "one", 1, lambda: Processes(1, 1))
        yield Timed(work, ONE, alone, alone)
        yield Timed(work, TWO, _timed(folder, "two", 1, lambda: Processes(WORKERS, 1)), alone / WORKERS)
        cores = os.cpu_count() or 1
        yield Timed(work, DEFAULT, _timed(folder, "default", cores, InProcess), alone / cores)
        files = [p.relative_to(folder / "one") for p in (folder / "one").rglob("*") if p.is_file()]
        for other in ("two", "default"):
            differ = filecmp.cmpfiles(folder / "one", folder / other, files, shallow=False)[1:]
            assert not any(differ), f"{other}: other bytes than those of one process"


def _timed(folder: Path, name: str, threads: int, engine: Callable[[], Engine]) -> float:
    """Seconds of an encode, the start of its processes included."""
    begun, made = time.perf_counter(), engine()
    try:
        work = Work(WorkFolder(folder / f"{name}.work"), made)
        settings = replace(SETTINGS, threads=threads)
        encode(open_sequence(folder / "scene"), folder / name, settings, work=work)
    finally:
        made.close()
    return time.perf_counter() - begun


def waits(count: int, seconds: float) -> Iterator[Timed]:
    """Jobs that only wait, on engines of two workers that are there already."""
    ideal = math.ceil(count / WORKERS) * seconds
    ways: list[tuple[str, Callable[[], Engine]]] = [
        ("two processes", lambda: Processes(WORKERS)),
        ("Dask, two workers", lambda: DaskEngine.local(WORKERS)),
    ]
    for way, make in ways:
        with tempfile.TemporaryDirectory() as name:
            engine = make()
            try:
                work = Work(WorkFolder(Path(name)), engine)
                work.run([_wait(-1 - n, 0.0) for n in range(WORKERS)])  # imports
                begun = time.perf_counter()
                work.run([_wait(n, seconds) for n in range(count)])
                yield Timed(f"{count} jobs of {seconds:g} s", way, time.perf_counter() - begun, ideal)
            finally:
                engine.close()


def _wait(number: int, seconds: float) -> Job:
    return Job("wait", str(number), f"wait {number}", time.sleep, (seconds,))


if __name__ == "__main__":
    sys.exit(main())
