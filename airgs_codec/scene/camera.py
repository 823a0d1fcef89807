"""Pinhole cameras, as OpenCV has them: x to the right, y down, z forward, world-to-camera matrices.

The centre of the first pixel is at (0.5, 0.5). `scene.cameras` reads them from files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Background = tuple[float, float, float]  # r, g, b, 0..1
BLACK: Background = (0.0, 0.0, 0.0)
NEAR = 0.01  # world units, as gsplat has it
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # turns y and z of a camera around; its own inverse


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A pinhole camera: a point (x, y, z) in camera space is seen at the pixel (fx x / z + cx, fy y / z + cy)."""

    name: str
    width: int  # pixels
    height: int  # pixels
    fx: float  # pixels
    fy: float  # pixels
    cx: float  # pixels
    cy: float  # pixels
    world_to_camera: NDArray[np.float64]  # (4, 4) rigid: rotation and translation
    split: str = "train"  # "train", or "test" for a held-out camera
    near: float = NEAR  # world units along the view axis; Gaussians whose mean is nearer are not drawn
    background: Background = BLACK  # what is seen behind the scene

    @property
    def position(self) -> NDArray[np.float64]:
        """(3,) the centre of the camera in world units."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    @property
    def held_out(self) -> bool:
        """Whether nothing may be fitted to what this camera sees, so that quality can be measured on it."""
        return self.split == "test"


def look_at(
    position: NDArray[np.float64],
    target: NDArray[np.float64],
    up: NDArray[np.float64],
    *,
    size: int,
    fov_y: float,
    name: str,
) -> Camera:
    """A square camera of `size` x `size` pixels at `position` (3,) that looks at `target` (3,), world units.

    `up` (3,) points up in the picture; `fov_y` is the field of view in radians.
    """
    forward = (target - position) / np.linalg.norm(target - position)
    right = _cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # looking along `up`, right would be 0 / 0: any right vector will do
        right = _cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    rotation = np.array([right, _cross(forward, right), forward])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ position
    focal = size / 2 / np.tan(fov_y / 2)
    return Camera(name, size, size, focal, focal, size / 2, size / 2, matrix)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The cross product of two vectors (3,), as numpy's, which takes ten times as long for a single one."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def resized(camera: Camera, share: float) -> Camera:
    """The camera with `share` of the pixels on either side, at least 8; a share of 1 or more changes nothing."""
    if share >= 1:
        return camera
    return with_pixels(camera, *(max(8, round(share * side)) for side in (camera.width, camera.height)))


def with_pixels(camera: Camera, width: int, height: int) -> Camera:
    """The camera with so many pixels on either side; it sees the same."""
    x, y = width / camera.width, height / camera.height
    fx, fy, cx, cy = camera.fx * x, camera.fy * y, camera.cx * x, camera.cy * y
    return replace(camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)


def training_views(cameras: Sequence[Camera]) -> list[Camera]:
    """The cameras that encoding and training may look at: all but held-out ones, or all if every one is held out."""
    return [c for c in cameras if not c.held_out] or list(cameras)
