"""How close do found cameras come to the true ones?

    python -m tools.bench_viewpoints SCENE[=CAMERAS] ... [--sheets FOLDER]

Looks for the viewpoints of each scene, a folder of .ply frames, in its first, middle and last frame. Where true cameras
are given, each camera of one rig is compared with the nearest of the other, both ways: the distance between them in
distances to what is seen, and the angle; medians and worst. Seconds are of the processor, on one thread; kernels are
compiled before, if they have to be. `--sheets` writes a contact sheet of each scene.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from airgs_codec._report import table
from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.viewpoint_score import Sample
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.cli.common import run_command
from airgs_codec.inspect.contact_sheet import write_contact_sheet
from airgs_codec.render import Camera, look_at, read_cameras, render
from airgs_codec.scene.sequence import open_sequence

FRAMES = 3
ROWS = 4000  # that tell how far away is what a camera sees
HALF = 35.0  # degrees that are as far as half the distance to what is seen
WARM = look_at(np.zeros(3), np.ones(3), np.array([0.0, 1.0, 0.0]), size=32, fov_y=1.0, name="warm")
HEAD = ["scene", "rows", "cpu s", "sure", "true to found", "worst", "found to true", "worst"]


def compare(rig: Sequence[Camera], other: Sequence[Camera], sample: Sample) -> list[str]:
    """Median and worst of what lies between the cameras of a rig and the nearest of another."""
    pairs = np.array([_nearest(camera, other, sample.look(camera).distance) for camera in rig])
    return [f"{away:.2f}, {angle:.0f} deg" for away, angle in (np.median(pairs, axis=0), pairs.max(axis=0))]


def _nearest(camera: Camera, rig: Sequence[Camera], away: float) -> tuple[float, float]:
    """Distance, in units of `away`, and degrees from a camera to the nearest of a rig."""
    shifts = [float(np.linalg.norm(camera.position - other.position)) / away for other in rig]
    cosines = [camera.world_to_camera[2, :3] @ other.world_to_camera[2, :3] for other in rig]
    turns = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return min(zip(shifts, turns.tolist(), strict=True), key=lambda pair: np.hypot(2 * pair[0], pair[1] / HALF))


def measure(scene: str, sheets: Path | None) -> tuple[list[str], str]:
    """The row of one SCENE[=CAMERAS], and the story of what was found."""
    folder, _, cameras = scene.partition("=")
    sequence = open_sequence(folder)
    frames = [sequence.read(i) for i in evenly_spaced(len(sequence), FRAMES)]
    start = time.process_time()
    found = find_viewpoints(frames)
    seconds = time.process_time() - start
    middle = sequence.load([len(sequence) // 2]).frames[0]
    name = Path(folder).resolve().name
    row = [name, str(len(middle)), f"{seconds:.1f}", "yes" if found.confident else "no"]
    if cameras:
        rig, sample = read_cameras(Path(cameras)), Sample.of(middle, ROWS)
        row += compare(rig, found.cameras, sample) + compare(found.cameras, rig, sample)
    if sheets:
        sheets.mkdir(parents=True, exist_ok=True)
        write_contact_sheet(sheets / f"{name}.png", middle, found.cameras, [f"{score:.2f}" for score in found.scores])
    return row + ["-"] * (len(HEAD) - len(row)), found.story


def _run(args: argparse.Namespace) -> int:
    render(open_sequence(args.scenes[0].partition("=")[0]).load([0]).frames[0], WARM)
    measured = [measure(scene, args.sheets) for scene in args.scenes]
    print(*table(HEAD, [row for row, _ in measured]), *(f"{row[0]}: {story}" for row, story in measured), sep="\n")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Measure what the arguments name; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", metavar="SCENE[=CAMERAS]")
    parser.add_argument("--sheets", type=Path, metavar="FOLDER")
    args = parser.parse_args(argv)
    return run_command("bench_viewpoints", lambda: _run(args))


if __name__ == "__main__":
    sys.exit(main())
