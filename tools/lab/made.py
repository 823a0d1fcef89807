"""What experiments play and measure: packages of scenes, and scenes that are made, with many Gaussians or frames."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from airgs_codec.encoder.publish import encode
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.places.results import digest
from airgs_codec.scene.camera import OPENGL_TO_OPENCV, Camera
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence
from tools.lab.results import code_digest, content


def encoded(scene: str, folder: Path) -> Path:
    """The package that airgs-encode makes of SCENE[=VIEWS], in a folder, unless it is there; or SCENE, if it is one.

    The name of a package says of what, and by which code it was made. Raises AirgsError.
    """
    place, _, views = scene.partition("=")
    if (Path(place) / JSON_NAME).is_file():
        return Path(place)
    made_of = digest(code_digest(), *(content(Path(path)) for path in (place, views) if path))
    package = folder / f"{name_of(scene)}-{made_of[:8]}.airgs"
    if not package.is_dir():
        encode(open_sequence(place, views=views or None), package)
    return package


def name_of(scene: str) -> str:
    """What tables call SCENE[=VIEWS]: its file or folder, without its ending."""
    return Path(scene.partition("=")[0]).stem


def make_scene(rows: int, frames: int, folder: Path) -> None:
    """Write frames of a ball of Gaussians to a new folder, a tenth of which swing."""
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


def camera_entry(camera: Camera, picture: str, time: int) -> dict[str, object]:
    pose = np.linalg.inv(camera.world_to_camera) @ OPENGL_TO_OPENCV
    return {
        "file_path": picture, "camera": camera.name, "split": camera.split, "time_index": time,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height,
        "transform_matrix": pose.tolist(),
    }  # fmt: skip
