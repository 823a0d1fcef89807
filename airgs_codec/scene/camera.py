"""Pinhole cameras, as OpenCV has them: x to the right, y down, z forward, world-to-camera matrices.

The centre of the first pixel is at (0.5, 0.5). `scene.cameras` reads them from files; here they are made all around a
scene that comes without any.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airgs_codec._arguments import brief, described
from airgs_codec.errors import SceneError
from airgs_codec.scene.gaussians import LARGEST, Doubles, Gaussians

Background = tuple[float, float, float]  # r, g, b, 0..1
Size = tuple[int, int]  # width, height in pixels
BLACK: Background = (0.0, 0.0, 0.0)
MOST_PIXELS = 32_768  # along a side of a picture
ROTATION_TOLERANCE = 1e-2  # for what files round; axes of another length or not at right angles are something else
NEAR_SHARE = 1 / 400  # of the distance to what is seen: near plane of cameras that have none
MOST_NEAR = 1 / 3  # of it: near plane of cameras whose files have one in units of their own, at most
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # turns y and z of a camera around; its own inverse
FIELDS = 0.1, 179.0  # degrees from top to bottom that a camera may see, as packages have it
UP = np.array([0.0, -1.0, 0.0])  # by default: structure from motion mostly leaves it so
FIELD_OF_VIEW = np.radians(50)  # of both axes
ELEVATIONS = np.radians([10.0, 35.0])  # above the horizon; neighbouring cameras take turns
COVERED = 0.98  # of all weight lies within a view, at least
MARGIN = 1.25  # around that
WIDTHS = 4  # of a Gaussian that is seen alone, from which it is seen
LEAST_WEIGHT = 1e-6  # of a Gaussian, so that a weighted median exists; of a distance, so that no ring has radius 0
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
    world_to_camera: Doubles  # (4, 4) rigid: rotation and translation
    split: str = "train"  # "train", or "test" for a held-out camera
    near: float = 0.0  # world units along the view axis, from which Gaussians are drawn; 0: see `with_near_planes`
    background: Background = BLACK  # what is seen behind the scene

    __repr__ = brief

    @staticmethod
    def look_at(
        position: ArrayLike,
        target: ArrayLike,
        up: ArrayLike = UP,
        *,
        size: Size,
        fov_y: float = 50.0,
        name: str = "view",
    ) -> Camera:
        """Return a camera of `size` (width, height) pixels at `position` (3,) that looks at `target` (3,), world units.

        `up` (3,) points up in the picture, by default (0, -1, 0), as structure from motion mostly leaves it; `fov_y` is
        the vertical field of view in degrees. Raises SceneError for what is no camera.
        """
        at, to, above = (_numbers(*given, (3,)) for given in (("position", position), ("target", target), ("up", up)))
        if np.array_equal(at, to) or not above.any():
            raise SceneError(f"camera {name}: expected a target elsewhere and a way up, got {at}, {to} and {above}")
        matrix = look_at(at, to, above, size=1, fov_y=1, name=name).world_to_camera
        return Camera.from_matrix(world_to_camera=matrix, size=size, fov_y=fov_y, name=name)

    @staticmethod
    def from_matrix(
        *,
        camera_to_world: ArrayLike | None = None,
        world_to_camera: ArrayLike | None = None,
        size: Size,
        fov_y: float | None = None,
        intrinsics: ArrayLike | None = None,
        name: str = "view",
    ) -> Camera:
        """Return a camera of `size` (width, height) pixels from one of two matrices and one of two lenses.

        Its axes are OpenCV's: x to the right, y down, z forward. For a pose of OpenGL, Blender or NeRF, whose y is up
        and z backward, give `pose @ np.diag([1, -1, -1, 1])`. `fov_y` is the vertical field of view in degrees, of
        square pixels about the middle; `intrinsics` (3, 3) are fx, 0, cx; 0, fy, cy; 0, 0, 1 in pixels. Raises
        SceneError for what is no camera.
        """
        if (camera_to_world is None) == (world_to_camera is None) or (fov_y is None) == (intrinsics is None):
            choice = "expected camera_to_world or world_to_camera, and fov_y or intrinsics"
            raise SceneError(f"camera {name}: {choice}, got both or none")
        width, height = _numbers("size", size, (2,)).astype(int).tolist()
        if intrinsics is None:
            half = np.radians(float(_numbers("fov_y", fov_y, ()))) / 2
            focal = float(height / 2 / np.tan(half)) if 0 < half < np.pi / 2 else 0.0
            intrinsics = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
        (fx, _, cx), (_, fy, cy), _ = _numbers("intrinsics", intrinsics, (3, 3)).tolist()
        given = "camera_to_world" if world_to_camera is None else "world_to_camera"
        rows = _numbers(given, camera_to_world if world_to_camera is None else world_to_camera, (4, 4), (3, 4))
        matrix = np.concatenate([rows, np.eye(4)[len(rows) :]])
        try:
            matrix = np.linalg.inv(matrix) if world_to_camera is None else matrix
            camera = Camera(name, width, height, fx, fy, cx, cy, matrix)
            check_camera(camera)
        except ValueError as error:  # a matrix without an inverse, too
            raise SceneError(f"{given}, size, fov_y, intrinsics: {error}") from None
        return camera

    @property
    def position(self) -> Doubles:
        """Return the centre (3,) of the camera in world units."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    @property
    def held_out(self) -> bool:
        """Return whether nothing may be fitted to what this camera sees, so that quality can be measured on it."""
        return self.split == "test"


def check_camera(c: Camera) -> None:
    """Raise ValueError for a camera without a size, a focal length or a pose."""
    numbers = np.array([c.fx, c.fy, c.cx, c.cy, *c.world_to_camera.ravel()])
    if not np.isfinite(numbers).all():
        raise ValueError(f"camera {c.name} has numbers that are not finite")
    if not (1 <= c.width <= MOST_PIXELS and 1 <= c.height <= MOST_PIXELS):
        raise ValueError(f"camera {c.name} has size {c.width}x{c.height}, not of 1 to {MOST_PIXELS} pixels")
    if c.fx <= 0 or c.fy <= 0:
        raise ValueError(f"camera {c.name} has focal lengths {c.fx:g} and {c.fy:g}, not above 0")
    if not FIELDS[0] <= (angle := np.degrees(2 * np.arctan(c.height / 2 / c.fy))) <= FIELDS[1]:
        raise ValueError(f"camera {c.name} sees {angle:.6g} degrees from top to bottom, not {FIELDS[0]} to {FIELDS[1]}")
    if not 0 <= c.near < np.inf:
        raise ValueError(f"camera {c.name} has near {c.near}")
    axes = c.world_to_camera[:3, :3]
    if np.abs(axes @ axes.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(axes) < 0:
        raise ValueError(f"camera {c.name} has a matrix that is not a rotation and a translation")


def _numbers(name: str, value: ArrayLike | None, *shapes: tuple[int, ...]) -> Doubles:
    """Return finite numbers of one of some shapes. Raises SceneError for anything else."""
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if found.shape not in shapes or not np.isfinite(found).all():
        expected = f"expected finite numbers of shape {' or '.join(map(str, shapes))}"
        raise SceneError(f"{name}: {expected}, got {described(value)}")
    return found


def look_at(position: Doubles, target: Doubles, up: Doubles, *, size: int, fov_y: float, name: str) -> Camera:
    """Return a square camera at `position` (3,) that looks at `target` (3,); `fov_y` in radians, `size` in pixels."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # looking along `up`, right would be 0 / 0: any right vector will do
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    focal = size / 2 / np.tan(fov_y / 2)
    return Camera(name, size, size, focal, focal, size / 2, size / 2, rigid(rotation, -rotation @ position))


def rigid(turn: Doubles, shift: ArrayLike) -> Doubles:
    """Return the (4, 4) matrix that turns by (3, 3), then shifts by (3,)."""
    return np.vstack([np.column_stack([turn, shift]), [0.0, 0.0, 0.0, 1.0]])


def resized(camera: Camera, share: float) -> Camera:
    """Return the camera with `share` of the pixels on either side, at least 8; unchanged for a share of 1 or more."""
    size = (max(8, round(share * side)) for side in (camera.width, camera.height))
    return with_pixels(camera, *size) if share < 1 else camera


def with_pixels(camera: Camera, width: int, height: int) -> Camera:
    """Return the camera with another number of pixels, which sees the same."""
    x, y = width / camera.width, height / camera.height
    fx, fy, cx, cy = camera.fx * x, camera.fy * y, camera.cx * x, camera.cy * y
    return replace(camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)


def placed(camera: Camera, shift: Doubles, scale: float, turn: Doubles | None = None) -> Camera:
    """Return the camera that sees the same of a scene which was turned (3, 3), shifted (3,), and then scaled."""
    axes, centre = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    axes = axes if turn is None else axes @ turn.T
    return replace(camera, world_to_camera=rigid(axes, scale * (centre - axes @ shift)), near=scale * camera.near)


def cameras_from(origin: ArrayLike, cameras: Iterable[Camera]) -> tuple[Camera, ...]:
    """Return the cameras in coordinates from an origin (3,)."""
    shift = -np.asarray(origin, np.float64)
    return tuple(placed(camera, shift, 1.0) for camera in cameras) if shift.any() else tuple(cameras)


def with_near_planes(cameras: Sequence[Camera], gaussians: Gaussians) -> list[Camera]:
    """Return the cameras with near planes: NEAR_SHARE of the `scene_scale`, or their own up to MOST_NEAR of it."""
    return at_scale(cameras, scene_scale(cameras, gaussians.means.astype(np.float64), gaussians.opacities()))


def at_scale(cameras: Sequence[Camera], scale: float) -> list[Camera]:
    return [replace(c, near=min(c.near, MOST_NEAR * scale) if c.near else NEAR_SHARE * scale) for c in cameras]


def rig_scale(cameras: Sequence[Camera], points: NDArray[Any] | None) -> float:
    """Return the `scene_scale` of points (P, 3); without any, the distance to where cameras look, or between them."""
    if points is not None and len(points):
        return scene_scale(cameras, points, np.ones(len(points)))
    places = np.stack([camera.position for camera in cameras])
    radius = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    return max(float(np.median(np.linalg.norm(places - looked_at(cameras), axis=1))), radius) or 1.0


def looked_at(cameras: Sequence[Camera]) -> Doubles:
    """Return the point (3,) nearest to all optical axes, by least squares."""
    total, right = 1e-6 * np.eye(3), np.zeros(3)  # parallel axes meet nowhere: the system would be singular
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.world_to_camera[2, :3], camera.world_to_camera[2, :3])
        total += across
        right += across @ camera.position
    return np.asarray(np.linalg.solve(total, right), np.float64)


def scene_scale(cameras: Sequence[Camera], means: NDArray[Any], weights: NDArray[Any]) -> float:
    """Return the median distance from cameras to what they see, above 0: the weighted median depth of points (N, 3).

    Where no camera sees any, it is the extent of the points; without one, 1.
    """
    finite = np.isfinite(means).all(axis=1) & (weights > 0)
    means, weights = means[finite].astype(np.float64), weights[finite].astype(np.float64)
    looks = [in_picture(camera, means) for camera in cameras]
    seen = [weighted_quantile(depths[inside], weights[inside], 0.5) for inside, depths in looks if inside.any()]
    return float(np.median(seen)) if seen else extent_of(means, weights)[1]


def in_picture(c: Camera, points: Doubles) -> tuple[NDArray[np.bool_], Doubles]:
    """Return whether a camera has finite points (N, 3) in its picture, (N,), and their depths (N,)."""
    x, y, z = c.world_to_camera[:3, :3] @ points.T + c.world_to_camera[:3, 3:]
    across, down = np.abs(c.fx * x + (c.cx - c.width / 2) * z), np.abs(c.fy * y + (c.cy - c.height / 2) * z)
    return (z > 0) & (across <= c.width / 2 * z) & (down <= c.height / 2 * z), z


def extent_of(means: NDArray[Any], weights: NDArray[Any]) -> tuple[Doubles, float]:
    """Return the middle (3,) of weighted points (N, 3), and the distance that holds COVERED of the weight, or 1."""
    if not len(means):
        return np.zeros(3), 1.0
    middle = np.array([weighted_quantile(values, weights, 0.5) for values in means.T])
    return middle, weighted_quantile(np.linalg.norm(means - middle, axis=1), weights, COVERED) or 1.0


def training_views(cameras: Sequence[Camera]) -> list[Camera]:
    """Return the cameras that encoding and training may use: all but held-out ones, or all if every one is held out."""
    return [c for c in cameras if not c.held_out] or list(cameras)


def orbit_views(gaussians: Gaussians, count: int = 8, size: int = 256, up: Doubles = UP) -> list[Camera]:
    """Return `count` square cameras of `size` pixels on a ring around the scene, which is upright along `up` (3,).

    They look at the middle of the scene, each from as far away as shows 98 % of the opacity with a margin. Rows that
    are not finite are ignored.
    """
    turns = 2 * np.pi * np.arange(count) / max(count, 1)
    rises = np.resize(ELEVATIONS, count)
    around = np.stack([np.sin(rises), np.cos(turns) * np.cos(rises), np.sin(turns) * np.cos(rises)], axis=1)
    return _views_from(gaussians, around, up, size)


def dome_views(
    gaussians: Gaussians, count: int, size: int, up: Doubles, rises: tuple[float, float] = (-np.pi / 2, np.pi / 2)
) -> list[Camera]:
    """Return cameras as `orbit_views` does, spread evenly between two elevations, radians above the horizon."""
    return _views_from(gaussians, spiral(count, *np.sin(rises).tolist()), up, size)


def _views_from(gaussians: Gaussians, sides: Doubles, up: Doubles, size: int) -> list[Camera]:
    """Return cameras from (C, 3) sides of the scene, unit length; the first coordinate is along `up`."""
    across = np.linalg.svd(np.asarray(up, np.float64)[:, None])[0].T[1:]  # the first is `up` or its opposite
    sides = sides @ np.stack([up / np.linalg.norm(up), *across])
    return [side_view(gaussians, side, up, size, f"orbit{i:02d}") for i, side in enumerate(sides)]


def spiral(count: int, lowest: float = -1.0, highest: float = 1.0) -> Doubles:
    """Return (count, 3) unit vectors, evenly over the sphere whose first coordinate is in these bounds."""
    rises = highest - (highest - lowest) * (np.arange(count) + 0.5) / max(count, 1)
    turns, across = GOLDEN_ANGLE * np.arange(count), np.sqrt(1 - rises**2)
    return np.stack([rises, across * np.cos(turns), across * np.sin(turns)], axis=1)


def side_view(
    gaussians: Gaussians, side: Doubles, up: Doubles, size: int, name: str, weights: Doubles | None = None
) -> Camera:
    """Return a square camera that sees the scene from a unit vector (3,); `weights` (N,) default to opacity."""
    weights = gaussians.opacities().astype(np.float64) if weights is None else weights
    finite = np.isfinite(gaussians.means).all(axis=1) & np.isfinite(weights)
    means, weights = gaussians.means[finite].astype(np.float64), weights[finite] + LEAST_WEIGHT
    if not len(means):
        means, weights = np.zeros((1, 3)), np.ones(1)
    ends = (1 - COVERED) / 2, (1 + COVERED) / 2
    centre = np.array([sum(weighted_quantile(values, weights, end) for end in ends) / 2 for values in means.T])
    offsets = means - centre
    ahead = look_at(side, np.zeros(3), up, size=size, fov_y=FIELD_OF_VIEW, name=name)
    x, y, z = ahead.world_to_camera[:3, :3] @ offsets.T
    wanted = MARGIN / np.tan(FIELD_OF_VIEW / 2) * np.maximum(np.abs(x), np.abs(y)) - z
    radius = weighted_quantile(np.linalg.norm(offsets, axis=1), weights, COVERED)
    # A view from no distance has no direction, nor has one whose distance float32 loses next to its centre; a
    # single Gaussian is seen from without.
    sizes = gaussians.log_scales.max(axis=1)
    width = float(np.exp(np.median(np.append(sizes[np.isfinite(sizes)], -LARGEST)).clip(-LARGEST, LARGEST)))
    least = max(MARGIN * radius, WIDTHS * width, float(np.abs(centre).max()) * LEAST_WEIGHT)
    away = max(weighted_quantile(wanted, weights, COVERED), least)
    camera = look_at(centre + away * side, centre, up, size=size, fov_y=FIELD_OF_VIEW, name=name)
    return replace(camera, near=NEAR_SHARE * away)


def weighted_quantile(values: Doubles, weights: Doubles, share: float) -> float:
    """Return the least value that `share` of the weight does not exceed."""
    total = np.cumsum(weights[order := np.argsort(values)])
    return float(values[order[np.searchsorted(total, share * total[-1])]])
