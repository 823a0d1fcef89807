"""What sharing the work of an encode gains: a made sequence in one process with one thread, in two such processes, and
as `airgs-encode` does it by default, one process with a thread for each core; and that the packages are the same.
"""

from __future__ import annotations

import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.jobs.executors import prepare_worker
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Section, Table, seconds_of, setting
from tools.lab.bench.soak_farm import same_files
from tools.lab.made import make_scene

WORKERS = 2
ONE, TWO, DEFAULT = "one process with one thread", "two such processes", "one process with a thread for each core"
SETTINGS = EncodeSettings(calibrate="none", group_frames=10, measure_pictures=4)


@dataclass(frozen=True, slots=True)
class Options:
    frames: int = setting(120, "frames of the sequence")
    rows: int = setting(20_000, "its Gaussians")


def run(options: Options, lab: Lab) -> Page:
    took = encodes(options.rows, options.frames)
    rows = [{"way": way, "seconds": seconds} for way, seconds in took.items()]
    how = f"{options.frames} frames of {options.rows:,} Gaussians in groups of {SETTINGS.group_frames}."
    return Page([Section("", tables=[Table("jobs", rows, {"way": ("way", ""), "seconds": ("seconds", ".1f")})])], how)


def encodes(rows: int, frames: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_scene(rows, frames, folder / "scene")
        encode(open_sequence(folder / "scene"), folder / "warm", replace(SETTINGS, threads=1))  # compiles, reads files
        took = {
            ONE: _seconds(folder, "one", 1, processes=1),
            DEFAULT: _seconds(folder, "default", os.cpu_count() or 1),
            TWO: _seconds(folder, "two", 1, processes=WORKERS),
        }
        for other in ("two", "default"):
            assert same_files(folder / "one", folder / other), f"{other}: other bytes than those of one process"
    return took


def _seconds(folder: Path, name: str, threads: int, processes: int = 0) -> float:
    """Seconds of an encode by so many processes of one thread each; 0: this one."""

    def work() -> None:
        with ExitStack() as stack:
            context, of_each = get_context("spawn"), (os.getpid(), 1)
            made = ProcessPoolExecutor(processes, context, prepare_worker, of_each) if processes else None
            executor = made and stack.enter_context(made)
            encode(
                open_sequence(folder / "scene"), folder / name, replace(SETTINGS, threads=threads), executor=executor
            )

    return seconds_of(work)[0].wall
