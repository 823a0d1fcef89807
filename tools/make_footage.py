"""Multi-view pictures of a Gaussian sequence: a scene to train on where only a model of it may be had.

    python -m tools.make_footage SEQUENCE -o FOLDER

Writes transforms.json, a PNG for every frame and camera, whose splits are kept, and points3d.npy: the means of some
opaque Gaussians of the first frame, moved by NOISE of their distance to the nearest camera, as triangulated points are
off. What is trained on such pictures is judged against a model, not against the world.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.cli.options import parse_frames
from airgs_codec.errors import SceneError
from airgs_codec.media.image import to_bytes, write_png
from airgs_codec.progress import Progress
from airgs_codec.render import render
from airgs_codec.scene.camera import Camera, resized
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.trainer.fit.points import project
from tools.lab import Lab, Page, Section, required, setting
from tools.lab.command import run_alone
from tools.lab.experiments import Experiment
from tools.lab.made import camera_entry

TOOL = Experiment("footage", "What do cameras see of a Gaussian sequence?", "tools.make_footage", "minutes")
OPAQUE = 0.5  # opacity from which a Gaussian may lend its mean to the points
NOISE = 2e-3


@dataclass(frozen=True, slots=True)
class Options:
    sequence: Path = required("a Gaussian sequence")
    views: Path | None = setting(None, "its cameras, where they do not lie beside it")
    frames: str | None = setting(None, "A:B, frames A to B - 1; all of them where not told")
    max_size: int = setting(160, "longest side of a picture in pixels")
    points: int = setting(2_500, "means that are written, at most")


def run(options: Options, lab: Lab) -> Page:
    sequence = open_sequence(options.sequence, views=options.views)
    cameras = [resized(c, options.max_size / max(c.width, c.height)) for c in sequence.cameras]
    numbers = range(len(sequence))[slice(*parse_frames(options.frames))]
    folder = lab.folder / "footage"
    write_scene(replace(sequence, cameras=tuple(cameras)), folder, numbers, options.points, lab.progress)
    return Page([Section(f"{len(numbers)} frames from {len(cameras)} cameras are in {folder}.")])


def write_scene(
    sequence: GaussianSequence, folder: Path, numbers: Sequence[int], points: int, progress: Progress
) -> None:
    """The pictures from its cameras, the cameras and points of some frames. Raises SceneError without cameras."""
    cameras = sequence.cameras
    if not cameras:
        raise SceneError(f"{sequence.folder}: expected cameras beside the sequence or with --views, got none")
    folder.mkdir(parents=True)
    entries = []
    for time, number in enumerate(numbers):
        shown = sequence.load([number]).frames[0]
        if time == 0:
            np.save(folder / "points3d.npy", some_points(shown, cameras, points))
        for camera in cameras:
            name = f"{camera.name}/{time:04d}.png"
            (folder / camera.name).mkdir(exist_ok=True)
            write_png(folder / name, to_bytes(render(shown, camera).rgb))
            entries.append(camera_entry(camera, name, time))
        progress("frames rendered", time + 1, len(numbers))
    data = {"camera_model": "OPENCV", "fps": float(sequence.fps), "frames": entries}
    (folder / "transforms.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def some_points(shown: Gaussians, cameras: Sequence[Camera], most: int) -> NDArray[np.float32]:
    """(at most `most`, 3) means of opaque Gaussians that a camera has in its picture, with noise."""
    means = shown.means.astype(np.float64)
    opaque = shown.opacities() > OPAQUE
    seen = np.zeros(len(means), bool)
    for camera in cameras:
        seen[project(camera, means)[2]] = True
    rows = np.flatnonzero(opaque & seen)
    random = np.random.default_rng(0)
    rows = rows[np.sort(random.permutation(len(rows))[:most])]
    away = np.min([np.linalg.norm(means[rows] - camera.position, axis=1) for camera in cameras], axis=0)
    return (means[rows] + NOISE * away[:, None] * random.normal(size=(len(rows), 3))).astype(np.float32)


main = partial(run_alone, TOOL)

if __name__ == "__main__":
    sys.exit(main())
