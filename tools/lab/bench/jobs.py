"""What sharing work costs and gains: processes on the cores of this machine, and engines with jobs that only wait.

encode: a made sequence, encoded by one process with one thread, by two such processes, and as `airgs-encode` does it by
default, one process with a thread for each core; and that the packages are the same. wait: so many jobs of so many
seconds for two workers, over the seconds that they would take if handing them out took no time.
"""

from __future__ import annotations

import filecmp
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.jobs.dask_engine import DaskEngine
from airgs_codec.jobs.engines import Engine, InProcess, Processes
from airgs_codec.jobs.job import Job
from airgs_codec.jobs.work import Work
from airgs_codec.places.results import open_store
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Section, Table, expect_names, rows_of, seconds_of, setting
from tools.lab.made import make_scene

WORKERS = 2
ONE, TWO, DEFAULT = "one process, one thread", "two processes, one thread each", "one process, threads"
SETTINGS = EncodeSettings(calibrate="none", group_frames=10, measure_pictures=4)
PARTS = ("encode", "wait")


@dataclass(frozen=True, slots=True)
class Options:
    """How much work."""

    frames: int = setting(120, "frames of the sequence")
    rows: int = setting(20_000, "its Gaussians")
    jobs: int = setting(60, "jobs that wait")
    seconds: float = setting(5.0, "how long each waits")
    only: tuple[str, ...] = setting(PARTS, "parts")


@dataclass(frozen=True, slots=True)
class Timed:
    """Seconds by the clock of one way to do one piece of work."""

    work: str
    way: str
    seconds: float
    ideal: float  # of the same work if sharing cost nothing


def run(options: Options, lab: Lab) -> Page:
    """The parts that are asked for."""
    expect_names("--only", options.only, PARTS)
    found: list[Timed] = []
    if "encode" in options.only:
        found += encodes(options.rows, options.frames)
    if "wait" in options.only:
        found += waits(options.jobs, options.seconds)
    rows = [row | {"of the ideal": row["ideal"] / row["seconds"]} for row in rows_of(found)]
    answer = "; ".join(f"{row['work']} by {row['way']}: {row['of the ideal']:.2f} of the ideal" for row in rows)
    return Page([Section(f"{answer}.", tables=[Table("jobs", rows)])])


def encodes(rows: int, frames: int) -> Iterator[Timed]:
    """The same sequence in three ways; the ideal of all but the first is a half of what that takes."""
    work = f"{frames} frames of {rows:,}"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_scene(rows, frames, folder / "scene")
        warm = replace(SETTINGS, threads=1)
        encode(open_sequence(folder / "scene"), folder / "warm", warm)  # compiles, and reads files into memory
        alone = _seconds(folder, "one", 1, lambda: Processes(1, 1))
        yield Timed(work, ONE, alone, alone)
        yield Timed(work, TWO, _seconds(folder, "two", 1, lambda: Processes(WORKERS, 1)), alone / WORKERS)
        cores = os.cpu_count() or 1
        yield Timed(work, DEFAULT, _seconds(folder, "default", cores, InProcess), alone / cores)
        files = [p.relative_to(folder / "one") for p in (folder / "one").rglob("*") if p.is_file()]
        for other in ("two", "default"):
            differ = filecmp.cmpfiles(folder / "one", folder / other, files, shallow=False)[1:]
            assert not any(differ), f"{other}: other bytes than those of one process"


def _seconds(folder: Path, name: str, threads: int, engine: Callable[[], Engine]) -> float:
    """Seconds of an encode, the start of its processes included."""

    def work() -> None:
        made = engine()
        try:
            settings, work = replace(SETTINGS, threads=threads), Work(open_store(folder / f"{name}.work"), made)
            encode(open_sequence(folder / "scene"), folder / name, settings, work=work)
        finally:
            made.close()

    return seconds_of(work)[0].wall


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
                work = Work(open_store(Path(name)), engine)
                work.run([_wait(-1 - n, 0.0) for n in range(WORKERS)])  # imports
                took, _ = seconds_of(partial(work.run, [_wait(n, seconds) for n in range(count)]))
                yield Timed(f"{count} jobs of {seconds:g} s", way, took.wall, ideal)
            finally:
                engine.close()


def _wait(number: int, seconds: float) -> Job:
    return Job("wait", str(number), f"wait {number}", _pause, (seconds,))


def _pause(seconds: float) -> None:
    time.sleep(seconds)
