"""The viewing region that cameras and a scene suggest, and the floor that an object stands on, if it has one.

C cameras, P places; N rows, n of them looked at. A floor is a plane with all else on one side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.viewpoint_score import flatness, row_areas, row_axes
from airgs_codec.errors import ConfigError
from airgs_codec.package.tables import MAX_PLACES, Place, Region
from airgs_codec.render import Camera, measure_contribution
from airgs_codec.scene.camera import resized, spiral
from airgs_codec.scene.gaussians import Gaussians

Vectors = NDArray[np.float64]

ROWS = 10_000  # looked at
TRIED = 400  # directions all around; neighbours are 10 degrees apart
CONE = np.cos(np.radians(15))  # rows lie in a plane when their normals differ less from its own
THICKNESS = 0.03  # of a floor, in extents of the scene
FLOOR_SHARE = 0.15  # of the area of all rows lies in a floor, at least
ROUGH = 2.0  # thicknesses about a floor in which rows are on no side of it
SIDES = 3.0  # times as much lies above a floor as below it, at least

RIG_SHARE = 0.25  # of the largest distance between two cameras: the margin, where it is the larger one
DISTANCE_SHARE = 0.1  # of the distance to the content: the other one
MOST_SHARE = 0.25  # of that distance: no viewer walks further towards what he looks at
CLEARANCE_SHARE = 0.5  # of the distance to the nearest content that is visible: no viewer walks into it
NEAREST = 0.02  # share of what a picture shows that may lie nearer than the clearance
TURN = 5.0  # degrees that a viewer may look off the focus
LOOK_PIXELS = 128  # on the longer side, enough to see how far away the content is


def find_floor(gaussians: Gaussians) -> Vectors | None:
    """The direction (3,) that is up where rows stand on a floor, of length 1; None without a floor.

    The thin axis of a flat row is the normal of the surface that it lies in. `gaussians` are repaired.
    """
    rows = np.random.default_rng(0).permutation(len(gaussians))[:ROWS]
    g = gaussians.take(np.sort(rows))
    areas = row_areas(g)
    areas = np.minimum(areas, np.quantile(areas, 0.99))  # a haze is no floor
    total = max(float(areas.sum()), np.finfo(np.float64).tiny)
    normals, weights = _normals(g), areas * flatness(g)
    up = _commonest(normals, weights)
    heights = g.means.astype(np.float64) @ up
    lying = np.abs(normals @ up) > CONE
    low, high = _heaviest_slab(heights[lying], weights[lying], heights)
    floor = float(weights[lying & (heights >= low) & (heights < high)].sum()) / total
    margin = ROUGH * (high - low)
    below, above = float(areas[heights < low - margin].sum()), float(areas[heights >= high + margin].sum())
    if floor < FLOOR_SHARE or max(below, above) < SIDES * min(below, above):
        return None
    return up if above > below else -up


def _normals(g: Gaussians) -> Vectors:
    """(n, 3) thin axes of rows, length 1."""
    thin = np.argmin(g.log_scales, axis=1)
    return np.take_along_axis(row_axes(g), thin[:, None, None], axis=2)[:, :, 0]


def _commonest(normals: Vectors, weights: Vectors) -> Vectors:
    """The direction (3,) along which most of the weight of normals lies, of either sign."""
    tried = spiral(TRIED)
    votes = (np.abs(normals @ tried.T) > CONE).T @ weights
    near = np.abs(normals @ tried[np.argmax(votes)]) > CONE
    axes = np.linalg.eigh((normals[near] * weights[near, None]).T @ normals[near])[1]
    return np.asarray(axes[:, -1])


def _heaviest_slab(values: Vectors, weights: Vectors, heights: Vectors) -> tuple[float, float]:
    """The interval THICKNESS of the extent of `heights` wide with the most weight of `values`."""
    low, high = np.quantile(heights, [0.001, 0.999])
    step = max(THICKNESS * (high - low), np.finfo(np.float32).tiny) / 2
    edges = np.arange(low - 2 * step, high + 3 * step, step)
    halves = np.histogram(values, edges, weights=weights)[0]
    best = int(np.argmax(halves[:-1] + halves[1:]))
    return float(edges[best]), float(edges[best + 2])


@dataclass(frozen=True, slots=True)
class _Look:
    """Distances of one camera to the scene, in world units."""

    camera: Camera
    distance: float  # to the content along the view axis, median over the picture
    clearance: float  # to the nearest content


def region_around(
    cameras: Sequence[Camera], gaussians: Gaussians, *, margin: float | None = None, source: str = "cameras"
) -> Region:
    """The region about the cameras of a scene; `gaussians` are one of its frames, finite.

    Every camera is a place, or MAX_PLACES of them that are far from each other. Its focus is as far away as the median
    of what it sees. A place reaches as far as `margin` (world units): by default a quarter of the largest distance
    between two cameras or a tenth of the median distance to the content, whichever is larger, but at most a quarter of
    that distance; and never further than half-way to the nearest content. Without a margin nobody may turn either.

    Raises ConfigError for a margin that is not 0 or more.
    """
    if margin is not None and not 0 <= margin < np.inf:
        raise ConfigError(f"margin: expected 0 or more world units, got {margin}")
    looks = [_look(camera, gaussians) for camera in _far_apart(cameras, MAX_PLACES)]
    reach = _default_margin(looks) if margin is None else margin
    first = looks[0].camera
    return Region(
        source=source,
        width=first.width,
        height=first.height,
        fov_y=float(np.degrees(2 * np.arctan(first.height / 2 / first.fy))),
        near=min(look.camera.near for look in looks),
        turn=TURN if reach > 0 else 0.0,
        places=[_place(look, reach) for look in looks],
    )


def _default_margin(looks: Sequence[_Look]) -> float:
    positions = np.stack([look.camera.position for look in looks])
    rig = float(np.linalg.norm(positions[:, None] - positions[None], axis=2).max())
    distance = float(np.median([look.distance for look in looks]))
    return min(max(RIG_SHARE * rig, DISTANCE_SHARE * distance), MOST_SHARE * distance)


def _place(look: _Look, margin: float) -> Place:
    rotation, position = look.camera.world_to_camera[:3, :3], look.camera.position
    focus = position + look.distance * rotation[2]
    reach = min(margin, CLEARANCE_SHARE * look.clearance)
    ends = _rounded(position, look.distance), _rounded(focus, look.distance)
    return Place(*ends, _rounded(-rotation[1], 1.0), float(f"{reach:.4g}"))


def _rounded(vector: NDArray[np.float64], size: float) -> list[float]:
    """To a millionth of `size`: nobody stands more exactly, and every viewer fetches them."""
    digits = 6 - int(np.floor(np.log10(size)))
    return [round(float(v), digits) for v in vector]


def _look(camera: Camera, g: Gaussians) -> _Look:
    """Distances to what a camera sees, weighed by what each Gaussian gives to the picture."""
    small = resized(camera, LOOK_PIXELS / max(camera.width, camera.height))
    weight = measure_contribution(g, small).total
    offsets = g.means.astype(np.float64) - camera.position
    away = np.linalg.norm(offsets, axis=1)
    if not weight.any():  # an empty picture: all of the scene counts
        weight = np.ones(len(g))
    depth = np.abs(offsets @ camera.world_to_camera[2, :3])
    distance = max(_quantile(depth, weight, 0.5), camera.near)  # near: of 0 the focus would have no direction
    return _Look(camera, distance, _quantile(away, weight, NEAREST))


def _quantile(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """The least value that `share` of the weight does not exceed."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def _far_apart(cameras: Sequence[Camera], most: int) -> list[Camera]:
    """At most so many cameras, each as far as possible from those before it, in the order in which they were given."""
    if len(cameras) <= most:
        return list(cameras)
    positions = np.stack([camera.position for camera in cameras])
    chosen = [0]
    nearest = np.linalg.norm(positions - positions[0], axis=1)
    while len(chosen) < most:
        nearest[chosen[-1]] = -1  # once each, wherever the others stand
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
    return [cameras[i] for i in sorted(chosen)]
