"""Milliseconds of decoding a frame of a million Gaussians, part by part, against what two cores may take for it.

    python -m tools.bench_million FOLDER [--fox SEQUENCE] [--rows 1000000] [--frames 30] [--swing 0.05] [--repeat 5]

Two scenes of one group each, made and encoded in FOLDER with the settings of `tools.bench_scale` unless they are there
already: a ball of which every Gaussian swings by itself, and, with `--fox`, a ring of copies of the first twelve frames
of a sequence (`tools.make_wide_scene`). Prints a table with medians of all repeats. What is decoded alone is a part of
what comes after it.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from airgs_codec.decoder.decode import decode_canonical, decode_frames, decode_segment
from airgs_codec.encoder.publish import encode
from airgs_codec.media.h264 import decode_pictures, open_segment
from airgs_codec.package.store import Package, open_package
from airgs_codec.scene.ply import read_ply, write_ply
from airgs_codec.scene.sequence import open_sequence
from tools.bench_scale import SETTINGS, make_scene
from tools.make_wide_scene import make_scene as make_ring

ASKED_MS = 60  # a frame
LOOPED = 12  # frames of the sequence that copies in the ring show


def make_swinging(rows: int, frames: int, swing: float, folder: Path) -> None:
    """A ball of Gaussians with the standard deviation 1, each of which swings by `swing` in a phase of its own."""
    make_scene(rows, 1, folder)
    first = read_ply(folder / "000000.ply")
    phases = np.random.default_rng(1).uniform(0, 6.28, (rows, 1))
    for t in range(frames):
        means = first.means + swing * np.sin(phases + 0.4 * t)
        write_ply(folder / f"{t:06d}.ply", replace(first, means=means.astype(np.float32)))


def scenes(args: argparse.Namespace) -> dict[str, Callable[[Path], None]]:
    """What makes each scene in a folder."""
    made: dict[str, Callable[[Path], None]] = {
        f"all swing by {args.swing}": lambda folder: make_swinging(args.rows, args.frames, args.swing, folder)
    }
    if args.fox:
        sequence = open_sequence(args.fox)
        copies = max(1, round(args.rows / len(sequence.load([0]).frames[0])))
        made["ring of foxes"] = lambda folder: make_ring(sequence, folder, (0, LOOPED), copies, args.frames)
    return made


def prepared(folder: Path, make: Callable[[Path], None]) -> Package:
    """The package of a scene, which is made where it is not there."""
    if not (folder / "package").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "scene").is_dir():
            make(folder / "scene")
        encode(open_sequence(folder / "scene"), folder / "package", SETTINGS)
    return open_package(folder / "package")


def parts(package: Package) -> dict[str, Callable[[], None]]:
    """Ways to decode parts of the top rung of a package, and all of it."""
    m = package.manifest
    bases = [decode_canonical(package, group, 0) for group in range(len(m.groups))]

    def key_video() -> None:
        for group, table in enumerate(m.groups):
            for k, unit in enumerate(table.units):
                for path in m.key_files(group, k, 0)[1:] if unit.count else []:
                    _decode_video(package, path, unit.qualities[0].pages)

    def state_video() -> None:
        for index in range(len(m.segments)):
            for path in m.state_files(index, 0):
                _decode_video(package, path, m.groups[m.group_of(index)].tiles[0].levels[0].pages)

    def keys() -> None:
        for group in range(len(m.groups)):
            decode_canonical(package, group, 0)

    def states() -> None:
        for index, segment in enumerate(m.segments):
            places = range(segment.stop - segment.start)
            _exhaust(decode_segment(package, index, bases[m.group_of(index)], 0, places))

    return {
        "H.264 of keys": key_video,
        "keys": keys,
        "H.264 of states": state_video,
        "states": states,
        "all": lambda: _exhaust(decode_frames(package, 0, m.frames)),
    }


def _decode_video(package: Package, path: str, pages: int) -> None:
    _exhaust(decode_pictures(open_segment(package.read(path), path).samples, path, pages))


def _exhaust(values: Iterator[object]) -> None:
    for _ in values:
        pass


def measure(work: Callable[[], None], repeat: int) -> tuple[float, float]:
    """Median milliseconds of the clock and of the CPU, after one run to warm up."""
    work()
    wall, cpu = [], []
    for _ in range(repeat):
        began, worked = time.perf_counter(), time.process_time()
        work()
        wall.append(1e3 * (time.perf_counter() - began))
        cpu.append(1e3 * (time.process_time() - worked))
    return statistics.median(wall), statistics.median(cpu)


def main(argv: Sequence[str] | None = None) -> None:
    """Make what is missing, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fox", type=Path)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--swing", type=float, default=0.05)
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args(argv)
    print(f"| scene | rows | with states | bytes a frame | part | ms a frame (at most {ASKED_MS}) | CPU ms a frame |")
    print("|---|---:|---:|---:|---|---:|---:|")
    for name, make in scenes(args).items():
        package = prepared(args.folder / name.replace(" ", "-"), make)
        m = package.manifest
        group, size = m.groups[0], m.bytes_of(m.rung_files(0, 0)) / m.frames
        for part, work in parts(package).items():
            wall, cpu = (value / m.frames for value in measure(work, args.repeat))
            scene = f"{name} | {group.count:,d} | {group.tiles[0].levels[0].rows:,d} | {size:,.0f}"
            print(f"| {scene} | {part} | {wall:.1f} | {cpu:.1f} |", flush=True)


if __name__ == "__main__":
    main()
