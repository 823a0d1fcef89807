"""Pinhole cameras in the OpenCV convention: x right, y down, z forward, pixel centres at +0.5."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.errors import SceneError

MOST_MEASURED_VIEWS = 4
NEAR = 0.01  # world units, as gsplat has it
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # nerfstudio cameras look along -z with y up


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A pinhole camera: x_pixel = fx * x / z + cx for a point (x, y, z) in camera space."""

    name: str
    width: int  # pixels
    height: int  # pixels
    fx: float  # pixels
    fy: float  # pixels
    cx: float  # pixels
    cy: float  # pixels
    world_to_camera: NDArray[np.float64]  # (4, 4)
    split: str = "train"  # "train" or "test" (held out)
    near: float = NEAR  # world units along the view axis; Gaussians whose mean is nearer are not drawn

    @property
    def position(self) -> NDArray[np.float64]:
        """(3,) camera centre in world units."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]


def look_at(
    position: NDArray[np.float64],
    target: NDArray[np.float64],
    up: NDArray[np.float64],
    *,
    size: int,
    fov_y: float,
    name: str,
    split: str = "train",
) -> Camera:
    """A square camera of `size` pixels at `position` that looks at `target`; fov_y in radians."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # looking along `up`: any right vector will do
        right = np.cross(forward, np.roll(up, 1))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ position
    focal = size / 2 / np.tan(fov_y / 2)
    return Camera(name, size, size, focal, focal, size / 2, size / 2, matrix, split)


def read_cameras(path: Path) -> list[Camera]:
    """The distinct cameras of a nerfstudio transforms.json (OpenGL camera-to-world matrices).

    Entries with the same `camera` name count once (a dynamic scene lists one entry a camera and frame);
    entries without it are all kept. `split` defaults to "train".

    Raises SceneError when the file is not a transforms.json.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        cameras: dict[str, Camera] = {}
        for number, frame in enumerate(data["frames"]):
            name = str(frame.get("camera", f"view{number:03d}"))
            if name not in cameras:
                cameras[name] = camera_from_transforms(name, data, frame)
    except OSError as error:
        raise SceneError(f"{path}: cannot read cameras: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, np.linalg.LinAlgError) as error:
        raise SceneError(
            f"{path}: expected a nerfstudio transforms.json, got {type(error).__name__}: {error}"
        ) from error
    if not cameras:
        raise SceneError(f"{path}: expected at least one camera under 'frames', got none")
    return list(cameras.values())


def measured_views(cameras: Sequence[Camera]) -> list[Camera]:
    """The cameras that quality is measured on: held-out ones if there are any, else all.

    At most MOST_MEASURED_VIEWS of them, evenly spaced.
    """
    chosen = [c for c in cameras if c.split == "test"] or list(cameras)
    return [chosen[i] for i in evenly_spaced(len(chosen), MOST_MEASURED_VIEWS)]


def camera_from_transforms(name: str, shared: dict[str, Any], frame: dict[str, Any]) -> Camera:
    """The camera of an entry under `frames`, which takes what it lacks from the file's own fields.

    Raises KeyError, TypeError, ValueError or LinAlgError for an entry that is none.
    """

    def value(key: str) -> float:
        return float(frame[key] if key in frame else shared[key])

    camera_to_world = np.asarray(frame["transform_matrix"], np.float64).reshape(4, 4)
    matrix: NDArray[np.float64] = np.linalg.inv(camera_to_world @ OPENGL_TO_OPENCV).astype(np.float64)
    if not np.isfinite(matrix).all():
        raise ValueError(f"camera {name} has a matrix that is not finite")
    width, height = int(value("w")), int(value("h"))
    if width < 1 or height < 1:
        raise ValueError(f"camera {name} has size {width}x{height}")
    intrinsics = (value("fl_x"), value("fl_y"), value("cx"), value("cy"))
    near = float(frame.get("near", shared.get("near", NEAR)))
    if not 0 < near < np.inf:
        raise ValueError(f"camera {name} has near {near}")
    return Camera(name, width, height, *intrinsics, matrix, str(frame.get("split", "train")), near)
