"""A loop out of a longer sequence: its end turns into what was before its beginning; with cameras in front of it.

    python -m tools.make_loop SEQUENCE -o SCENE --frames A:B --position X,Y,Z --focus X,Y,Z [--blend 12] [--arc 70]

Row n is the same Gaussian in all frames, y is up. Choose A and B so that frames A and B look alike: the last frames
before B are mixed with those before A, whose share grows, so that the first frame follows the last as it follows frame
A - 1. The cameras stand on an arc of so many degrees about the focus, with the given position in its middle, at three
heights; every fourth is held out. An ATTRIBUTION.txt of SEQUENCE goes along.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.cli.options import parse_frames
from airgs_codec.cli.terminal import Bar, run_command
from airgs_codec.errors import ConfigError
from airgs_codec.scene.beside import ATTRIBUTION_NAME, Settings, read_attribution, write_settings
from airgs_codec.scene.camera import Camera, look_at
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab.made import camera_entry

TURNS, HEIGHTS = 9, (-8.0, 0.0, 10.0)  # cameras on the arc, and degrees above the middle of it
SIZE, FOV_Y = (960, 540), np.radians(32)
UP = np.array([0.0, 1.0, 0.0])


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--frames", type=parse_frames, required=True, metavar="A:B")
    parser.add_argument("--position", type=parse_point, required=True, metavar="X,Y,Z")
    parser.add_argument("--focus", type=parse_point, required=True, metavar="X,Y,Z")
    parser.add_argument("--blend", type=int, default=12, metavar="FRAMES")
    parser.add_argument("--arc", type=float, default=70.0, metavar="DEGREES")
    args = parser.parse_args(words)

    def run() -> int:
        make_loop(open_sequence(args.sequence), args.output, args.frames, args.blend)
        cameras = cameras_on_arc(args.position, args.focus, args.arc)
        entries = {
            "camera_model": "OPENCV",
            "frames": [camera_entry(camera, f"{camera.name}.png", 0) for camera in cameras],
        }
        (args.output / "transforms.json").write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
        return 0

    return run_command("make_loop", run)


def parse_point(text: str) -> NDArray[np.float64]:
    """X,Y,Z. Raises ValueError."""
    return np.array([float(number) for number in text.split(",", 2)])


def make_loop(sequence: GaussianSequence, folder: Path, span: tuple[int, int | None], blend: int) -> None:
    """Write frames [start, stop) to a new folder, the last of them mixed. Raises ConfigError for a bad span."""
    start, stop = span[0], len(sequence) if span[1] is None else span[1]
    if not blend <= start < stop - blend <= len(sequence) - blend:
        raise ConfigError(f"--frames: expected A:B from {blend} to {len(sequence)}, got {start}:{stop}")
    folder.mkdir(parents=True)
    bar = Bar()
    for place, number in enumerate(range(start, stop)):
        share = (number - (stop - blend) + 1) / (blend + 1)
        frame = sequence.read(number)
        mixed = mix(frame, sequence.read(number - stop + start), share) if share > 0 else frame
        write_ply(folder / f"{place:06d}.ply", mixed)
        bar("frames", place + 1, stop - start)
    bar.close()
    write_settings(folder, Settings(sequence.fps, (0,), origin=sequence.origin))
    if credit := read_attribution(sequence.folder):
        (folder / ATTRIBUTION_NAME).write_text(credit + "\n", encoding="utf-8")


def mix(a: Gaussians, b: Gaussians, share: float) -> Gaussians:
    """`share` of the second frame and the rest of the first; turns take the shorter way."""
    same = np.sign(np.sum(a.quaternions * b.quaternions, axis=1, keepdims=True))
    turned = a.quaternions * (1 - share) + b.quaternions * np.where(same == 0, 1, same) * share

    mixed = {f.name: getattr(a, f.name) * (1 - share) + getattr(b, f.name) * share for f in fields(Gaussians)}
    mixed["quaternions"] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return Gaussians(**{name: np.asarray(values, np.float32) for name, values in mixed.items()})


def cameras_on_arc(position: NDArray[np.float64], focus: NDArray[np.float64], degrees: float) -> list[Camera]:
    """Cameras that look at a focus, `position` in their middle."""
    offset = position - focus
    distance, level = np.linalg.norm(offset), np.hypot(offset[0], offset[2])
    turn, height = np.arctan2(offset[0], offset[2]), np.arctan2(offset[1], level)
    cameras: list[Camera] = []
    for rise in np.radians(HEIGHTS) + height:
        for side in np.radians(np.linspace(-degrees / 2, degrees / 2, TURNS)) + turn:
            away = np.array([np.sin(side) * np.cos(rise), np.sin(rise), np.cos(side) * np.cos(rise)])
            name = f"arc{len(cameras):02d}"
            square = look_at(focus + distance * away, focus, UP, size=SIZE[1], fov_y=FOV_Y, name=name)
            split = "test" if len(cameras) % 4 == 1 else "train"
            cameras.append(replace(square, width=SIZE[0], cx=SIZE[0] / 2, split=split))
    return cameras


if __name__ == "__main__":
    sys.exit(main())
