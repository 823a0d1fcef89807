"""A wide scene out of a narrow one: copies of a Gaussian sequence in a ring, which viewers see from its middle.

    python -m tools.make_wide_scene SEQUENCE -o SCENE [--frames A:B] [--copies 8] [--length 24]

SEQUENCE stands on a floor, y is up, and frames A:B are one group of tracked rows. Every copy goes to and fro through
them, each begins at another frame. Every second copy stands further away. Writes LENGTH frames, sequence.json with the
rate of SEQUENCE and one group, and transforms.json with cameras in the middle that look outwards, of which the held-out
ones look in directions between those of the others. An ATTRIBUTION.txt of SEQUENCE goes along.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.cli.common import parse_frames
from airgs_codec.cli.terminal import Bar, run_command
from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import ATTRIBUTION_NAME, Settings, read_attribution, write_settings
from airgs_codec.scene.camera import OPENGL_TO_OPENCV, Camera, look_at
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians, join_rows
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

VISIBLE = 0.3  # opacity of Gaussians that say how wide a copy is
SPACING = 1.1  # copies side by side, in their own widths
FURTHER = 1.5  # times as far away as its neighbours is every second copy
EYES = 0.35  # height of the viewer's eyes, as a share of the distance to the nearer copies
STEP = 0.08  # cameras stand so far from the middle, as a share of the same distance
TRAINING, HELD_OUT = 12, 6  # directions
SIZE, FOV_Y = (384, 216), np.radians(45)


def main(words: Sequence[str] | None = None) -> int:
    """Run it; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--frames", type=parse_frames, default=(0, None), metavar="A:B")
    parser.add_argument("--copies", type=int, default=8)
    parser.add_argument("--length", type=int, default=24, metavar="FRAMES")
    args = parser.parse_args(words)

    def run() -> int:
        make_scene(open_sequence(args.sequence), args.output, args.frames, args.copies, args.length)
        return 0

    return run_command("make_wide_scene", run)


def make_scene(
    sequence: GaussianSequence, folder: Path, span: tuple[int, int | None], copies: int, length: int
) -> None:
    """Write the scene to a new folder. Raises SceneError where frames have different numbers of rows."""
    frames = sequence.load(range(len(sequence))[slice(*span)]).frames
    if len({len(frame) for frame in frames}) != 1:
        raise SceneError(f"{sequence.folder}: expected frames of one group, got other numbers of rows")
    places, radius = ring(frames[0], copies)
    folder.mkdir(parents=True)
    bar = Bar()
    for time in range(length):
        parts = [moved(frames[to_and_fro(time, k, copies, len(frames))], place) for k, place in enumerate(places)]
        write_ply(folder / f"{time:06d}.ply", join_rows(parts))
        bar("frames", time + 1, length)
    bar.close()
    write_beside(folder, sequence, cameras_of(radius))


def write_beside(folder: Path, sequence: GaussianSequence, cameras: Sequence[Camera]) -> None:
    """What lies beside frames that were made of those of a sequence: rate, one group, cameras and attribution."""
    write_settings(folder, Settings(sequence.fps, (0,)))
    entries = {"camera_model": "OPENCV", "frames": [entry(camera) for camera in cameras]}
    (folder / "transforms.json").write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    if credit := read_attribution(sequence.folder):
        (folder / ATTRIBUTION_NAME).write_text(credit + "\n", encoding="utf-8")


def ring(frame: Gaussians, copies: int) -> tuple[NDArray[np.float64], float]:
    """(C, 3) places of the copies, and the radius of the ring of the nearer ones, world units."""
    low, high = np.percentile(frame.means[frame.opacities() > VISIBLE], [1, 99], axis=0)
    width = float(max(high[0] - low[0], high[2] - low[2]))
    radius = max(width, SPACING * width * copies / (2 * np.pi))
    angle = 2 * np.pi * np.arange(copies) / copies
    away = np.where(np.arange(copies) % 2, FURTHER, 1.0) * radius
    return np.stack([away * np.cos(angle), np.zeros(copies), away * np.sin(angle)], axis=1), radius


def to_and_fro(time: int, copy: int, copies: int, frames: int) -> int:
    """The frame that a copy shows."""
    cycle = max(1, 2 * (frames - 1))
    at = (time + copy * cycle // copies) % cycle
    return min(at, cycle - at)


def moved(frame: Gaussians, place: NDArray[np.float64]) -> Gaussians:
    """The frame elsewhere: colours depend on directions, which a shift does not change."""
    return replace(frame, means=(frame.means + place).astype(np.float32))


def cameras_of(radius: float) -> list[Camera]:
    """Cameras about the middle of the ring that look outwards and a little down."""
    count = TRAINING + HELD_OUT
    cameras = []
    for number in range(count):
        angle = 2 * np.pi * number / count
        out = np.array([np.cos(angle), 0.0, np.sin(angle)])
        eye = np.array([0.0, EYES * radius, 0.0])
        target = radius * out + np.array([0.0, EYES * radius / 2, 0.0])
        up = np.array([0.0, 1.0, 0.0])
        square = look_at(eye + STEP * radius * out, target, up, size=SIZE[1], fov_y=FOV_Y, name=f"out{number:02d}")
        split = "test" if number % (count // HELD_OUT) == 1 else "train"
        cameras.append(replace(square, width=SIZE[0], cx=SIZE[0] / 2, split=split))
    return cameras


def entry(camera: Camera) -> dict[str, object]:
    """A camera as transforms.json has it."""
    pose = np.linalg.inv(camera.world_to_camera) @ OPENGL_TO_OPENCV
    return {
        "file_path": f"{camera.name}.png", "camera": camera.name, "split": camera.split, "time_index": 0,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height,
        "transform_matrix": pose.tolist(),
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
