"""Seconds, memory and bytes over the number of Gaussians and of frames: made scenes, encoded twice and decoded.

    python -m tools.bench_scale -o FOLDER [--rows 10000,100000,1000000] [--frames 30,300,3000] [--few 2000]

Scenes of each number of rows have the first number of `--frames`; scenes of each number of frames have `--few` rows.
Every encode and every decode is a process of its own. `cold` encodes from nothing, `warm` once more with the jobs that
the first one kept. Writes FOLDER/scale-time.csv and the section "Time and memory" of FOLDER/scale.md, with a power law
fitted to each step by least squares.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from airgs_codec._files import write_bytes
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.jobs.store import WorkFolder
from airgs_codec.jobs.work import Work
from airgs_codec.media.h264 import library_versions
from airgs_codec.package.store import open_package
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import write_ply
from airgs_codec.scene.sequence import open_sequence

SETTINGS = EncodeSettings(
    calibrate="none",
    measure_pictures=0,
    preset="veryfast",
    group_frames=30,
    keep_all=True,
    levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0)),
)
HEADING = "## Time and memory"
CSV_NAME, PAGE_NAME = "scale-time.csv", "scale.md"


@dataclass(frozen=True, slots=True)
class Measured:
    """One process."""

    rows: int
    frames: int
    step: str  # of STEPS
    seconds: float
    cpu_seconds: float  # of all its threads: what other work on the machine changes little
    peak_mb: float  # most memory that the process had, 10^6 bytes
    frame_bytes: float  # of the top rung


def measure_scene(rows: int, frames: int) -> Iterator[Measured]:
    """Make a scene and take every step with it."""
    with tempfile.TemporaryDirectory() as folder:
        make_scene(rows, frames, Path(folder) / "scene")
        for step in STEPS:
            words = [sys.executable, "-m", "tools.bench_scale", "--step", step, folder]
            figures = json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
            yield Measured(rows, frames, step, *figures)


def make_scene(rows: int, frames: int, folder: Path) -> None:
    """A ball of Gaussians of which a tenth swings."""
    random = np.random.default_rng(0)
    means = random.normal(size=(rows, 3))
    size = math.log(1.5 / rows ** (1 / 3))
    columns = [random.normal(size=(rows, 4)), size + 0.3 * random.normal(size=(rows, 3))]
    columns += [2 * random.normal(size=rows), 0.5 * random.normal(size=(rows, 3)), np.zeros((rows, 0, 3))]
    moves = (np.arange(rows) % 10 == 0)[:, None] * np.array([0.1, 0.02, 0.0])
    folder.mkdir()
    for t in range(frames):
        moved = [means + math.sin(0.6 * t) * moves, *columns]
        write_ply(folder / f"{t:06d}.ply", Gaussians(*(np.asarray(c, np.float32) for c in moved)))


def _encode(folder: Path, target: str) -> None:
    encode(open_sequence(folder / "scene"), folder / target, SETTINGS, work=Work(WorkFolder(folder / "work")))


def _decode(folder: Path) -> None:
    package = open_package(folder / "cold")
    for _ in decode_frames(package, 0, package.manifest.frames):
        pass


STEPS: dict[str, Callable[[Path], None]] = {
    "cold": lambda folder: _encode(folder, "cold"),
    "warm": lambda folder: _encode(folder, "warm"),
    "decode": _decode,
}


def take_step(step: str, folder: Path) -> tuple[float, float, float, float]:
    """Seconds, those of the CPU, the most memory of this process in 10^6 bytes, and bytes a frame of the top rung."""
    began, worked = time.perf_counter(), time.process_time()
    STEPS[step](folder)
    seconds, cpu = time.perf_counter() - began, time.process_time() - worked
    m = open_package(folder / "cold").manifest
    return seconds, cpu, peak_bytes() / 1e6, m.bytes_of(m.rung_files(0, 0)) / m.frames


def peak_bytes() -> int:
    """Most memory this process had (Linux; getrusage would begin with what its parent had)."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])


def fit_power(sizes: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """a and k of the power law value = a size^k that fits best: least squares of the logarithms."""
    k, log_a = np.polyfit(np.log(sizes), np.log(values), 1)
    return float(np.exp(log_a)), float(k)


def write_table(found: Sequence[Measured], folder: Path) -> None:
    """Write what was measured as CSV."""
    with (folder / CSV_NAME).open("w", newline="") as file:
        table = csv.DictWriter(file, [f.name for f in fields(Measured)], lineterminator="\n")
        table.writeheader()
        table.writerows(asdict(one) for one in found)


def write_section(found: Sequence[Measured], few: int, command: str, page: Path) -> None:
    """Put the section into a page, in place of the one that is there."""
    section = "\n".join([HEADING, "", *_words(found, few, command)]) + "\n"
    text = page.read_text(encoding="utf-8") if page.is_file() else "# Scale\n"
    pattern = re.compile(rf"^{HEADING}\n.*?(?=^## |\Z)", re.DOTALL | re.MULTILINE)
    if pattern.search(text):
        text = pattern.sub(lambda match: section + "\n" * (match.end() < len(text)), text)
    else:
        text = f"{text.rstrip()}\n\n{section}"
    write_bytes(page, text.encode())


def _words(found: Sequence[Measured], few: int, command: str) -> list[str]:
    versions = ", ".join(f"{name} {version}" for name, version in library_versions().items() if name == "av")
    first = found[0].frames
    lines = [
        "Made scenes: a ball of Gaussians of which a tenth swings, without spherical harmonics past DC. Groups of 30",
        "frames, two levels, x264 preset veryfast, no trial encodes, quality not measured, nothing left out, though",
        "most of a ball is never seen (`--keep-all`). *cold*: encoded from nothing; *warm*: once more with the jobs",
        "that the first encode kept; *decode*: every frame of the top rung. Memory is the most that the process of a",
        "step had, with Python and its libraries; CPU seconds are those of all its threads.",
        f"All figures: [CSV]({CSV_NAME}).",
        "",
        "| Gaussians | frames | step | seconds | CPU seconds | CPU ms a frame | memory, MB | bytes a frame |",
        "|---:|---:|---|---:|---:|---:|---:|---:|",
    ]
    for one in found:
        times = f"{one.seconds:.1f} | {one.cpu_seconds:.1f} | {1e3 * one.cpu_seconds / one.frames:.1f}"
        sizes = f"{one.peak_mb:.0f} | {one.frame_bytes:.0f}"
        lines.append(f"| {one.rows:,d} | {one.frames:,d} | {one.step} | {times} | {sizes} |")
    lines += ["", "CPU seconds as a power law, by least squares of the logarithms; an exponent of 1 is linear:", ""]
    lines += ["| step | over Gaussians | over frames |", "|---|---|---|"]
    for step in STEPS:
        same = [one for one in found if one.step == step]
        rows = fit_words([(one.rows, one.cpu_seconds) for one in same if one.frames == first and one.rows != few])
        frames = fit_words([(one.frames, one.cpu_seconds) for one in same if one.rows == few])
        lines.append(f"| {step} | {rows} | {frames} |")
    machine = f"{platform.machine()}, Python {platform.python_version()}, {versions}"
    return [*lines, "", f"`{command}` ({machine})."]


def fit_words(points: Sequence[tuple[int, float]]) -> str:
    """The power law of sizes and CPU seconds for people."""
    if len(points) < 2:
        return "not measured"
    _, k = fit_power(*zip(*points, strict=True))
    return f"exponent {k:.2f}, {points[0][0]:,d} to {points[-1][0]:,d}"


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("docs"))
    parser.add_argument("--rows", default="10000,100000,1000000")
    parser.add_argument("--frames", default="30,300,3000")
    parser.add_argument("--few", type=int, default=2000)
    parser.add_argument("--step", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.step:
        print(json.dumps(take_step(args.step[0], Path(args.step[1]))))
        return
    rows, frames = ([int(number) for number in text.split(",")] for text in (args.rows, args.frames))
    found: list[Measured] = []
    for scene in [*((count, frames[0]) for count in rows), *((args.few, count) for count in frames)]:
        for one in measure_scene(*scene):
            found.append(one)
            print(one, flush=True)
    words = ["python", "-m", "tools.bench_scale", *(sys.argv[1:] if argv is None else argv)]
    args.out.mkdir(parents=True, exist_ok=True)
    write_table(found, args.out)
    write_section(found, args.few, shlex.join(words), args.out / PAGE_NAME)


if __name__ == "__main__":
    main()
