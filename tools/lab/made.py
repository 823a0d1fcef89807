"""What experiments play and measure: packages of scenes, and scenes that are made, with many Gaussians or frames."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from airgs_codec.encoder.publish import encode
from airgs_codec.jobs.job import code_digest, digest
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.scene.beside import Settings, write_settings
from airgs_codec.scene.camera import OPENGL_TO_OPENCV, Camera
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.gaussians import Gaussians, join_rows
from airgs_codec.scene.sequence import open_sequence
from tools.lab.results import content

VISIBLE = 0.3  # opacity of Gaussians that say how wide a copy is
SPACING, FURTHER = 1.1, 1.5  # of copies side by side, in their widths; how much further away every second one is


def encoded(scene: str, folder: Path) -> Path:
    """The package that airgs-encode makes of SCENE[=VIEWS], in a folder, unless it is there; or SCENE, if it is one.

    The name of a package says of what, and by which code it was made. Raises AirgsError.
    """
    place, _, views = scene.partition("=")
    if (Path(place) / JSON_NAME).is_file():
        return Path(place)
    made_of = digest(code_digest(encode), *(content(Path(path)) for path in (place, views) if path))
    package = folder / f"{name_of(scene)}-{made_of[:8]}.airgs"
    if not package.is_dir():
        encode(open_sequence(place, views=views or None), package)
    return package


def name_of(scene: str) -> str:
    """What tables call SCENE[=VIEWS]: its file or folder, without its ending."""
    return Path(scene.partition("=")[0]).stem


def make_scene(rows: int, frames: int, folder: Path) -> None:
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


def make_swinging(rows: int, frames: int, swing: float, folder: Path) -> None:
    """A ball of Gaussians with the standard deviation 1, each of which swings by `swing` in a phase of its own."""
    make_scene(rows, 1, folder)
    first = read_ply(folder / "000000.ply")
    phases = np.random.default_rng(1).uniform(0, 6.28, (rows, 1))
    for t in range(frames):
        means = first.means + swing * np.sin(phases + 0.4 * t)
        write_ply(folder / f"{t:06d}.ply", replace(first, means=means.astype(np.float32)))


def make_ring(source: Path, copies: int, group: int, frames: int, folder: Path) -> None:
    """Copies of the first `group` frames of a sequence on a circle, written to a new folder, y is up.

    Every copy plays to and fro, each from another frame on; every second one stands further away.
    """
    read = open_sequence(source).load(range(group)).frames
    low, high = np.percentile(read[0].means[read[0].opacities() > VISIBLE], [1, 99], axis=0)
    width = float(max(high[0] - low[0], high[2] - low[2]))
    angles = 2 * np.pi * np.arange(copies) / copies
    away = np.where(np.arange(copies) % 2, FURTHER, 1.0) * max(width, SPACING * width * copies / (2 * np.pi))
    places = np.stack([away * np.cos(angles), np.zeros(copies), away * np.sin(angles)], axis=1)
    cycle = max(1, 2 * (group - 1))
    folder.mkdir(parents=True)
    for time in range(frames):
        at = [(time + copy * cycle // copies) % cycle for copy in range(copies)]
        shown = [read[min(t, cycle - t)] for t in at]
        parts = [replace(g, means=(g.means + x).astype(np.float32)) for g, x in zip(shown, places, strict=True)]
        write_ply(folder / f"{time:06d}.ply", join_rows(parts))
    write_settings(folder, Settings(open_sequence(source).fps, (0,)))


def camera_entry(camera: Camera, picture: str, time: int) -> dict[str, object]:
    """A picture as transforms.json has it."""
    pose = np.linalg.inv(camera.world_to_camera) @ OPENGL_TO_OPENCV
    return {
        "file_path": picture, "camera": camera.name, "split": camera.split, "time_index": time,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height,
        "transform_matrix": pose.tolist(),
    }  # fmt: skip
