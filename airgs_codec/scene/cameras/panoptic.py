"""CMU Panoptic as Dynamic 3D Gaussians has it (Luiten et al. 2024): train_meta.json, and test_meta.json for held-out.

`fn`, `k`, `w2c` and `cam_id` are lists over frames of lists over cameras: a file under ims/, a (3, 3) matrix, an OpenCV
world-to-camera matrix and the number of the camera; `w` and `h` are the size of every picture.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.scene.camera import Camera
from airgs_codec.scene.cameras.posed import Posed, expect_any
from airgs_codec.scene.files import expecting, read_object

NAME = "train_meta.json"
TEST_NAME = "test_meta.json"
# Metres. The cameras hang in the wall of a dome: what lies nearer is the wall that others see, and their own housing.
NEAR = 0.8


def fits(data: Any) -> bool:
    """Return whether JSON data is such a file."""
    return isinstance(data, dict) and {"k", "w2c", "cam_id"} <= {*data}


def read(path: Path) -> list[Posed]:
    """One for each frame and camera, frame by frame.

    Cameras of a test_meta.json are held out; that beside a train_meta.json is read with it. Raises SceneError.
    """
    test = path.with_name(TEST_NAME)
    if path.name == TEST_NAME:
        return _read(path, "test")
    return _read(path, "train") + (_read(test, "test") if test.is_file() else [])


def _read(path: Path, split: str) -> list[Posed]:
    data = read_object(path)
    with expecting(path, "fn, k, w2c and cam_id of frames and cameras"):
        size = (int(data["w"]), int(data["h"]))
        moments = zip(data["fn"], data["k"], data["w2c"], data["cam_id"], strict=True)
        if not all(map(len, data["fn"])):
            raise ValueError("a frame has no pictures")
        posed = [
            _posed(size, time, split, shot) for time, moment in enumerate(moments) for shot in zip(*moment, strict=True)
        ]
    return expect_any(posed, path, "at least one frame")


def _posed(size: tuple[int, int], time: int, split: str, shot: tuple[str, Any, Any, int]) -> Posed:
    file, k, w2c, number = shot
    if not file:
        raise ValueError("a picture without a name")
    m, view = np.asarray(k, np.float64).reshape(3, 3), np.asarray(w2c, np.float64).reshape(4, 4)
    camera = Camera(f"cam{number:02d}", *size, m[0, 0], m[1, 1], m[0, 2], m[1, 2], view, split, NEAR)
    return Posed(camera, str(file), time=time, fixed=True)
