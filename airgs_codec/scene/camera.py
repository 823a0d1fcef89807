"""Pinhole cameras, as OpenCV has them: x to the right, y down, z forward, world-to-camera matrices.

The centre of the first pixel is at (0.5, 0.5). `scene.cameras` reads them from files; here they are made all around a
scene that comes without any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.gaussians import Gaussians

Background = tuple[float, float, float]  # r, g, b, 0..1
BLACK: Background = (0.0, 0.0, 0.0)
NEAR = 0.01  # world units, as gsplat has it
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # turns y and z of a camera around; its own inverse
UP = np.array([0.0, -1.0, 0.0])  # where nobody tells it: structure from motion mostly leaves it so
FIELD_OF_VIEW = np.radians(50)  # of both axes
ELEVATIONS = np.radians([10.0, 35.0])  # above the horizon; neighbouring cameras take turns
COVERED_OPACITY = 0.9  # of the scene lies within the ring's view
MARGIN = 1.15  # around what the ring sees
LEAST_SHARE = 1e-6  # keeps a weighted median of nothing, and a ring of radius 0, out
GOLDEN_ANGLE = np.pi * (3 - 5**0.5)  # radians; successive turns by it spread evenly over a sphere (Vogel 1979)


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
        """Return whether nothing may be fitted to what this camera sees, so that quality can be measured on it."""
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


def orbit_views(gaussians: Gaussians, count: int = 8, size: int = 256, up: NDArray[np.float64] = UP) -> list[Camera]:
    """`count` square cameras of `size` pixels on a ring around the scene, which is upright along `up` (3,).

    They look at the opacity-weighted median of the means, from far enough away to see 90 % of the opacity. Rows that
    are not finite are passed over.
    """
    turns = 2 * np.pi * np.arange(count) / max(count, 1)
    rises = np.resize(ELEVATIONS, count)
    around = np.stack([np.sin(rises), np.cos(turns) * np.cos(rises), np.sin(turns) * np.cos(rises)], axis=1)
    return _views_from(gaussians, around @ _upright(up), up, size)


def dome_views(
    gaussians: Gaussians, count: int, size: int, up: NDArray[np.float64], lowest: float = -np.pi / 2
) -> list[Camera]:
    """`count` square cameras of `size` pixels, all around the scene or over a dome that is upright along `up` (3,).

    None is lower than `lowest`, in radians above the horizon. Else they are as those of `orbit_views`.
    """
    return _views_from(gaussians, spiral(count, float(np.sin(lowest))) @ _upright(up), up, size)


def _upright(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) rows of length 1: `up`, and two at right angles to it and to each other."""
    axes = np.linalg.svd(np.asarray(up, np.float64)[:, None])[0].T  # the first is `up` or its opposite
    return np.stack([up / np.linalg.norm(up), *axes[1:]])


def spiral(count: int, lowest: float = -1.0) -> NDArray[np.float64]:
    """(count, 3) directions of length 1, evenly over the sphere whose first coordinate is at least `lowest`."""
    rises = 1 - (1 - lowest) * (np.arange(count) + 0.5) / max(count, 1)
    turns, across = GOLDEN_ANGLE * np.arange(count), np.sqrt(1 - rises**2)
    return np.stack([rises, across * np.cos(turns), across * np.sin(turns)], axis=1)


def _views_from(gaussians: Gaussians, sides: NDArray[np.float64], up: NDArray[np.float64], size: int) -> list[Camera]:
    """Cameras that look at the scene from (C, 3) sides of it, unit length, far enough away to see most of it."""
    centre, radius = _extent(gaussians)
    away = MARGIN * radius / np.tan(FIELD_OF_VIEW / 2)
    return [
        look_at(centre + away * side, centre, up, size=size, fov_y=FIELD_OF_VIEW, name=f"orbit{i:02d}")
        for i, side in enumerate(sides)
    ]


def _extent(gaussians: Gaussians) -> tuple[NDArray[np.float64], float]:
    """The opacity-weighted median (3,) of finite means, and the radius around it within which most opacity lies."""
    finite = np.isfinite(gaussians.means).all(axis=1) & np.isfinite(gaussians.opacity_logits)
    means = gaussians.means[finite].astype(np.float64) if finite.any() else np.zeros((1, 3))
    # LEAST_SHARE: opacities that are all 0 have a median, too
    weights = gaussians.opacities()[finite].astype(np.float64) + LEAST_SHARE if finite.any() else np.ones(1)
    centre = np.array([_quantile(means[:, axis], weights, 0.5) for axis in range(3)])
    radius = _quantile(np.linalg.norm(means - centre, axis=1), weights, COVERED_OPACITY)
    # A ring of radius 0 has no direction, nor has one that is lost beside its centre in float32.
    return centre, max(radius, float(np.abs(centre).max()) * LEAST_SHARE, LEAST_SHARE)


def _quantile(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """The least value that `share` of the weight does not exceed."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])
