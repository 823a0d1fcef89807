"""Reader of CMU Panoptic as Dynamic 3D Gaussians has it (Luiten et al. 2024): train_meta.json, ims/, seg/.

`fn`, `k`, `w2c` and `cam_id` are lists over frames of lists over cameras: a file under ims/, a (3, 3) matrix, an OpenCV
world-to-camera matrix and the number of the camera. Masks of what moves are in seg/.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.sequence import DEFAULT_FPS
from airgs_codec.train.data.json_file import read_object
from airgs_codec.train.data.multiview import MultiviewScene, PictureFile, Shot

NAME = "train_meta.json"
# Metres. The cameras hang in the wall of a dome: what lies nearer is the wall that others see, and their own housing.
NEAR = 0.8


def has_panoptic(folder: Path) -> bool:
    """Whether the folder has a train_meta.json."""
    return (folder / NAME).is_file()


def read_panoptic(folder: Path) -> MultiviewScene:
    """The scene of a train_meta.json. Raises SceneError."""
    path = folder / NAME
    data = read_object(path)
    try:
        size = (int(data["w"]), int(data["h"]))
        frames = tuple(
            tuple(_shot(folder, size, *shot) for shot in zip(*moment, strict=True))
            for moment in zip(data["fn"], data["k"], data["w2c"], data["cam_id"], strict=True)
        )
        fps = Fraction(str(data.get("fps", DEFAULT_FPS)))
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise SceneError(
            f"{path}: expected fn, k, w2c and cam_id a frame and camera, got {type(error).__name__}: {error}"
        ) from error
    if not frames:
        raise SceneError(f"{path}: expected at least one frame, got none")
    return MultiviewScene(folder, fps, frames)


def _shot(folder: Path, size: tuple[int, int], file: str, k: Any, w2c: Any, camera_id: int) -> Shot:
    m, view = np.asarray(k, np.float64).reshape(3, 3), np.asarray(w2c, np.float64).reshape(4, 4)
    camera = Camera(f"cam{camera_id:02d}", *size, m[0, 0], m[1, 1], m[0, 2], m[1, 2], view, near=NEAR)
    mask = folder / "seg" / Path(file).with_suffix(".png")
    return Shot(camera, PictureFile(folder / "ims" / file), None, mask if mask.is_file() else None)
