"""Seconds, memory and bytes over the number of Gaussians: synthetic scenes of ten frames, encoded and decoded.

    python -m tools.bench_scale [--counts 10000,100000,1000000]

Every encode and every decode is a process of its own.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.publish import encode as encode_package
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.package.store import open_package
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import write_ply
from airgs_codec.scene.sequence import open_sequence

COUNTS = (10_000, 100_000, 1_000_000)
FRAMES = 10


def measure_scale(counts: Sequence[int]) -> Iterator[tuple[int, str, float, int, str]]:
    """(Gaussians, encode or decode, seconds, bytes, what memory it took) of all frames."""
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            make_scene(count, Path(folder) / "scene")
            for step in STEPS:
                words = [sys.executable, "-m", "tools.bench_scale", "--step", step, folder]
                got = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
                yield count, step, got["seconds"], got["bytes"], got["note"]


def make_scene(count: int, folder: Path) -> None:
    """A ball of Gaussians of which a tenth swings."""
    random = np.random.default_rng(0)
    means = random.normal(size=(count, 3))
    size = math.log(1.5 / count ** (1 / 3))
    columns = [random.normal(size=(count, 4)), size + 0.3 * random.normal(size=(count, 3))]
    columns += [2 * random.normal(size=count), 0.5 * random.normal(size=(count, 3)), np.zeros((count, 0, 3))]
    moves = (np.arange(count) % 10 == 0)[:, None] * np.array([0.1, 0.02, 0.0])
    folder.mkdir()
    for t in range(FRAMES):
        moved = [means + math.sin(0.6 * t) * moves, *columns]
        write_ply(folder / f"{t:06d}.ply", Gaussians(*(np.asarray(c, np.float32) for c in moved)))


def encode(folder: Path) -> tuple[int, str]:
    """Bytes of the top rung."""
    settings = EncodeSettings(
        calibrate="none", measure_pictures=0, preset="veryfast", levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0))
    )
    sequence = open_sequence(folder / "scene")
    m = encode_package(sequence, folder / "out", settings).manifest
    return m.bytes_of(m.rung_files(0, 0)), ""


def decode(folder: Path) -> tuple[int, str]:
    """Bytes of a decoded segment, and what memory it took above the canonical space."""
    package = open_package(folder / "out")
    base, size = decode_canonical(package, 0, 0), 0
    before = peak_bytes()
    for index, s in enumerate(package.manifest.segments):
        for frame in decode_segment(package, index, base, 0, range(s.stop - s.start)):
            size = sum(getattr(frame, name).nbytes for name in frame.__slots__) * (s.stop - s.start)
    above = peak_bytes() - before
    return size, f"{above / 1e6:.1f} MB over the canonical space, {above / size:.2f} x one decoded segment; "


STEPS = {"encode": encode, "decode": decode}


def peak_bytes() -> int:
    """Most memory this process had (Linux; getrusage would begin with what its parent had)."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--counts", default=",".join(map(str, COUNTS)))
    parser.add_argument("--step", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.step:
        began = time.perf_counter()
        size, note = STEPS[args.step[0]](Path(args.step[1]))
        seconds = time.perf_counter() - began
        print(json.dumps({"seconds": seconds, "bytes": size, "note": f"{note}{peak_bytes() / 1e6:.0f} MB at most"}))
        return
    for count, step, seconds, size, note in measure_scale([int(n) for n in args.counts.split(",")]):
        print(f"{count:9,d} {step}  {seconds / FRAMES:8.4f} s and {size / FRAMES:10.0f} B a frame, {note}", flush=True)


if __name__ == "__main__":
    main()
