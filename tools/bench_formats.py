"""What a round trip through each splat format costs: PSNR, bytes, seconds, memory. Makes the tables of docs/formats.md.

    python -m tools.bench_formats [SCENE] [--rows N] [--repeat N] [--update PAGE]

Frame 0 of SCENE (default: tests/data/fox), as the format holds it, is written and read again; PSNR is of all pictures
by the scene's held-out cameras together, against the frame as it was. Clips hold all frames of SCENE, and are timed
with them. Files of one frame are timed with copies of that frame beside each other, --rows Gaussians (default:
200,000): the median of --repeat runs, each in a process of its own, whose largest resident memory (with that of the
library's process, where it has one) counts the interpreter, too. Writing is timed once. --update writes the tables
between the markers of a page.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from airgs_codec._files import atomic_path
from airgs_codec.inspect.compare import compared_views
from airgs_codec.inspect.sides import open_side
from airgs_codec.inspect.two import Comparison, compare_two
from airgs_codec.scene.formats.clips import CLIP_FORMATS
from airgs_codec.scene.formats.table import FORMATS, Format
from airgs_codec.scene.formats.write import choose_target, write_frames
from airgs_codec.scene.formats.write_clips import CLIP_WRITERS, ClipWriter
from airgs_codec.scene.gaussians import Gaussians, join_rows
from airgs_codec.scene.ply import read_ply, write_ply
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

SCENE = Path(__file__).parent.parent / "tests/data/fox"
BEGIN, END = "<!-- tools.bench_formats: begin -->\n", "<!-- tools.bench_formats: end -->\n"
NOISE = 0.02  # in the units of each attribute: writers cluster equal rows, which no scene has
GAP = 1.5  # between copies of a frame, of its extent


def copies(frame: Gaussians, rows: int) -> Gaussians:
    """So many Gaussians: a frame again and again, side by side in a cube, all attributes with a little noise."""
    count = -(-rows // len(frame))
    side = round(count ** (1 / 3) + 0.5)
    step = GAP * np.ptp(frame.means, axis=0)
    places = np.stack(np.unravel_index(np.arange(count), (side + 1,) * 3), axis=1) * step
    moved = [replace(frame, means=(frame.means + place).astype(np.float32)) for place in places]
    joined = join_rows(moved).take(slice(rows))
    random = np.random.default_rng(0)
    columns = [getattr(joined, field.name) for field in fields(Gaussians)]
    return Gaussians(*(c + np.float32(NOISE) * random.standard_normal(c.shape, np.float32) for c in columns))


def one_run(action: str, source: Path, target: Path) -> None:
    """In a process of its own: write a .ply to the format of another name, or read a file; prints seconds and MB."""
    frame = read_ply(source) if action == "write" else None
    began = time.perf_counter()
    if frame is None:
        open_sequence(target).read(0)
    else:
        write_frames(choose_target(str(target), None, 1), [(0, frame)], Fraction(1))
    seconds = time.perf_counter() - began
    peaks = [resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(json.dumps({"seconds": seconds, "peak_mb": sum(peaks) / 1e3}))


def time_runs(action: str, source: Path, target: Path, repeat: int) -> tuple[float, float]:
    """Median seconds, and MB, of so many runs."""
    command = [sys.executable, "-m", "tools.bench_formats", "--one", action, str(source), str(target)]
    runs = [json.loads(subprocess.run(command, capture_output=True, check=True).stdout) for _ in range(repeat)]
    return statistics.median(r["seconds"] for r in runs), max(r["peak_mb"] for r in runs)


def round_trip(scene: Path, sequence: GaussianSequence, written: Path) -> Comparison:
    """A written file against the scene, by its held-out cameras."""
    cameras = compared_views(sequence.cameras, None)
    other = open_side(str(written))
    return compare_two(open_side(str(scene)), other, range(other.frames), cameras)


def facts(form: Format | ClipWriter) -> list[str]:
    """The cells that the code knows without measuring."""
    holds = form.holds
    degrees = f"0 to {holds.sh_degree}" if holds.sh_degree else "none"
    return [form.name, degrees, "kept" if holds.keeps_rows else "lost", holds.rounding or "nothing"]


def frame_row(form: Format, scene: Path, large: Path, repeat: int) -> str:
    """A line of the table of formats that hold one frame."""
    sequence = open_sequence(scene)
    with tempfile.TemporaryDirectory() as folder:
        small, big = Path(folder) / f"small.{form.key}", Path(folder) / f"big.{form.key}"
        write_frames(choose_target(str(small), None, 1), [(0, sequence.load([0]).frames[0])], Fraction(1))
        quality = round_trip(scene, sequence, small).quality
        write_s, _ = time_runs("write", large, big, 1)
        read_s, peak_mb = time_runs("read", large, big, repeat)
        cells = [
            *facts(form),
            f"{quality.psnr:.1f} dB",
            f"{small.stat().st_size / 1e3:.0f} kB",
            f"{big.stat().st_size / 1e6:.1f} MB",
            f"{write_s:.2f} s",
            f"{read_s:.2f} s, {peak_mb:.0f} MB",
        ]
    return f"| {' | '.join(cells)} |"


def frames_table(scene: Path, rows: int, repeat: int) -> str:
    """The table of formats that hold one frame."""
    first = open_sequence(scene).load([0]).frames[0]
    head = [
        "format",
        "SH",
        "order of rows",
        "rounds",
        "PSNR",
        f"{len(first):,} Gaussians",
        f"{rows:,}",
        "write",
        "read",
    ]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    with tempfile.TemporaryDirectory() as folder:
        large = Path(folder) / "large.ply"
        write_ply(large, copies(first, rows))
        lines += [frame_row(form, scene, large, repeat) for form in FORMATS]
    return "\n".join(lines)


def clip_row(form: ClipWriter, scene: Path) -> str:
    """A line of the table of formats that hold many frames."""
    sequence = open_sequence(scene)
    count = len(sequence)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"clip.{form.key}"
        frames = [(i, sequence.load([i]).frames[0]) for i in range(count)]
        began = time.perf_counter()
        write_frames(choose_target(str(path), None, count), frames, sequence.fps)
        written = time.perf_counter()
        again = open_sequence(path)
        for i in range(count):
            again.read(i)
        read_s, write_s = time.perf_counter() - written, written - began
        quality = round_trip(scene, sequence, path).quality
        size = f"{path.stat().st_size / count / 1e3:.0f} kB a frame"
        cells = [f"{quality.psnr:.1f} dB", size, f"{write_s / count:.2f} s", f"{read_s / count:.2f} s"]
    return f"| {' | '.join([*facts(form), *cells])} |"


def clips_table(scene: Path) -> str:
    """The table of formats that hold many frames."""
    count = len(open_sequence(scene))
    head = ["clip", "SH", "order of rows", "rounds", "PSNR", f"{count} frames", "write a frame", "read a frame"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    written = {form.name for form in CLIP_WRITERS}
    others = [form.name for form in CLIP_FORMATS if form.name not in written]
    rows = [clip_row(form, scene) for form in CLIP_WRITERS] + [f"| {name} | not written |" for name in others]
    return "\n".join(lines + rows)


def update(page: Path, tables: str) -> None:
    """Put the tables between the markers of a page. Raises ValueError where it does not have them."""
    text = page.read_text(encoding="utf-8")
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    if BEGIN not in text or END not in text:
        raise ValueError(f"{page}: expected the lines {BEGIN!r} and {END!r}")
    with atomic_path(page) as temporary:
        temporary.write_text(f"{before}{BEGIN}\n{tables}\n\n{END}{after}", encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> None:
    """Measure all formats, print the tables, and put them into a page."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench_formats", description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", type=Path, default=SCENE)
    parser.add_argument("--rows", type=int, default=200_000, metavar="N")
    parser.add_argument("--repeat", type=int, default=3, metavar="N")
    parser.add_argument("--update", type=Path, metavar="PAGE")
    parser.add_argument("--one", nargs=3, metavar=("ACTION", "SOURCE", "TARGET"), help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.one:
        one_run(args.one[0], Path(args.one[1]), Path(args.one[2]))
        return
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    tables = "\n\n".join(
        [frames_table(args.scene, args.rows, args.repeat), clips_table(args.scene), f"Measured on {machine}."]
    )
    print(tables)
    if args.update:
        update(args.update, tables)


if __name__ == "__main__":
    main()
