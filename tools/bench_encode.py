"""Seconds and peak memory of encoding a sequence and longer ones made of it by playing it forth and back.

    python -m tools.bench_encode SEQUENCE [--views transforms.json] [--frames 30,60,120]

Each length is a process of its own, with calibration not kept from before. Prints a table, and how both grow.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from airgs_codec.media.h264 import library_versions
from airgs_codec.scene.sequence import open_sequence

STAGES = ("training views", "calibration", "encoding", "measuring")


def forth_and_back(source: Path, target: Path, frames: int) -> None:
    """A sequence of links: 0 1 2 … n-1 n-2 … 1 0 1 …"""
    paths = open_sequence(source).paths
    turn = [*range(len(paths)), *range(len(paths) - 2, 0, -1)]
    for number, frame in enumerate(itertools.islice(itertools.cycle(turn), frames)):
        (target / f"{number:06d}.ply").symlink_to(paths[frame].resolve())


def measure(scene: Path, views: Path | None) -> tuple[dict[str, float], float]:
    """Seconds of every stage, and peak memory in MB."""
    with tempfile.TemporaryDirectory() as cache:
        words = [sys.executable, "-c", "import sys; from airgs_codec.cli.encode import main; sys.exit(main())"]
        words += [str(scene), "-o", str(Path(cache) / "package"), "--json", *(["--views", str(views)] if views else [])]
        done = subprocess.run(
            words, check=True, capture_output=True, text=True, env=os.environ | {"XDG_CACHE_HOME": cache}
        )
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # of the largest child so far
    return json.loads(done.stdout)["seconds"], peak / 1024


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--views", type=Path, help="default: SEQUENCE/transforms.json")
    parser.add_argument("--frames", default="30,60,120", help="lengths, ascending (default: 30,60,120)")
    args = parser.parse_args()
    views = args.views or args.sequence / "transforms.json"
    rows = []
    print(f"{'frames':>7}  {'  '.join(f'{s:>14}' for s in STAGES)}  {'s a frame':>9}  {'peak MB':>8}")
    for frames in (int(part) for part in args.frames.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            forth_and_back(args.sequence, Path(folder), frames)
            seconds, peak = measure(Path(folder), views if views.exists() else None)
        total = sum(seconds.values())
        rows.append((frames, total, peak))
        cells = "  ".join(f"{seconds[stage]:14.1f}" for stage in STAGES)
        print(f"{frames:7d}  {cells}  {total / frames:9.3f}  {peak:8.0f}", flush=True)
    for (a, time_a, peak_a), (b, time_b, peak_b) in itertools.pairwise(rows):
        more = b - a
        print(f"{a} to {b} frames: {(time_b - time_a) / more:.3f} s and {(peak_b - peak_a) / more:.1f} MB a frame more")
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, {library_versions()}")


if __name__ == "__main__":
    main()
