"""Multi-view pictures of a Gaussian sequence: a scene to train on where only a model of it may be had.

    python -m tools.render_footage SEQUENCE -o SCENE [--views CAMERAS] [--frames A:B] [--max-size PX] [--points N]

Writes SCENE/transforms.json, a PNG for every frame and camera, whose splits are kept, and points3d.npy: the means of N
opaque Gaussians of the first frame, moved by NOISE of their distance to the nearest camera, as triangulated points are
off. What is trained on such pictures is judged against a model, not against the world.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.cli.common import Bar, parse_frames, run_command
from airgs_codec.errors import SceneError
from airgs_codec.media.image import to_bytes, write_png
from airgs_codec.render import render
from airgs_codec.scene.camera import OPENGL_TO_OPENCV, Camera, resized
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

OPAQUE = 0.5  # opacity from which a Gaussian may lend its mean to the points
NOISE = 2e-3


def main(words: Sequence[str] | None = None) -> int:
    """Run it; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--views", type=Path)
    parser.add_argument("--frames", type=parse_frames, default=(0, None), metavar="A:B")
    parser.add_argument("--max-size", type=int, default=160, help="longest side in pixels (default: 160)")
    parser.add_argument("--points", type=int, default=2_500)
    args = parser.parse_args(words)

    def run() -> int:
        sequence = open_sequence(args.sequence, views=args.views)
        write_scene(sequence, args.output, args.frames, args.max_size, args.points)
        return 0

    return run_command("render_footage", run)


def write_scene(
    sequence: GaussianSequence, folder: Path, frames: tuple[int, int | None], max_size: int, points: int
) -> None:
    """The pictures, cameras and points of frames [A, B) of a sequence. Raises SceneError without cameras."""
    if not sequence.cameras:
        raise SceneError(f"{sequence.folder}: expected cameras beside the sequence or with --views, got none")
    cameras = [resized(c, max_size / max(c.width, c.height)) for c in sequence.cameras]
    numbers = range(len(sequence))[slice(*frames)]
    folder.mkdir(parents=True)
    bar, entries = Bar(), []
    for time, number in enumerate(numbers):
        shown = sequence.load([number]).frames[0]
        if time == 0:
            np.save(folder / "points3d.npy", some_points(shown, cameras, points))
        for camera in cameras:
            name = f"{camera.name}/{time:04d}.png"
            (folder / camera.name).mkdir(exist_ok=True)
            write_png(folder / name, to_bytes(render(shown, camera).rgb))
            entries.append(entry(camera, name, time))
        bar("frames rendered", time + 1, len(numbers))
    bar.close()
    data = {"camera_model": "OPENCV", "fps": float(sequence.fps), "frames": entries}
    (folder / "transforms.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def entry(camera: Camera, picture: str, time: int) -> dict[str, object]:
    """A picture as transforms.json has it."""
    pose = np.linalg.inv(camera.world_to_camera) @ OPENGL_TO_OPENCV
    return {
        "file_path": picture, "camera": camera.name, "split": camera.split, "time_index": time,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height,
        "transform_matrix": pose.tolist(),
    }  # fmt: skip


def some_points(shown: Gaussians, cameras: Sequence[Camera], most: int) -> NDArray[np.float32]:
    """(at most `most`, 3) means of opaque Gaussians that a camera has in its picture, with noise."""
    means = shown.means.astype(np.float64)
    opaque = shown.opacities() > OPAQUE
    seen = np.zeros(len(means), bool)
    for camera in cameras:
        x, y, z = (means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]).T
        front = np.where(z > camera.near, z, np.inf)
        u, v = camera.fx * x / front + camera.cx, camera.fy * y / front + camera.cy
        seen |= (z > camera.near) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    rows = np.flatnonzero(opaque & seen)
    random = np.random.default_rng(0)
    rows = rows[np.sort(random.permutation(len(rows))[:most])]
    away = np.min([np.linalg.norm(means[rows] - camera.position, axis=1) for camera in cameras], axis=0)
    return (means[rows] + NOISE * away[:, None] * random.normal(size=(len(rows), 3))).astype(np.float32)


if __name__ == "__main__":
    sys.exit(main())
