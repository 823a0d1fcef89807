"""The cloud that the first frame starts from: given, COLMAP's, or triangulated, and random points where it is thin.

P points, V views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.render import Camera
from airgs_codec.train.data.multiview import Points
from airgs_codec.train.data.pictures import View
from airgs_codec.train.fit.projection import project
from airgs_codec.train.fit.triangulate import triangulate

BOX_POINTS = 50  # so many given points tell where the scene is
BOX_MARGIN = 1.15  # size of the box of random points, over that of the given ones


def scene_extent(cameras: Sequence[Camera], points: Points | None = None) -> float:
    """Size of a scene in world units: 1.1 times the largest distance of a camera to their centre, as 3DGS has it.

    It is at least the median distance of the points to that centre. Cameras that stand around a scene are as far from
    each other as from it; those of a narrow rig before it would make steps and sizes too small for what they see. 1
    where all cameras are in one place and there are no points.
    """
    places = np.stack([camera.position for camera in cameras])
    centre = places.mean(axis=0)
    extent = 1.1 * float(np.linalg.norm(places - centre, axis=1).max())
    if points is None or not len(points.positions):
        return extent or 1.0
    return max(extent, float(np.median(np.linalg.norm(points.positions - centre, axis=1)))) or 1.0


def initial_points(given: Points | None, views: Sequence[View], fewest: int, rng: np.random.Generator) -> Points:
    """The given points, or triangulated ones, with random ones beside them up to `fewest`. Every point has a colour.

    Points that are not finite are left out. Raises SceneError when there are neither points nor two views to find them
    in, or no point is left.
    """
    points = given
    if points is None:
        if len(views) < 2:
            raise SceneError("expected a cloud of points or at least two training views, got one view")
        points = triangulate(views)
    finite = np.isfinite(points.positions).all(axis=1)
    colours = None if points.colours is None else points.colours[finite]
    points = replace(points, positions=points.positions[finite], colours=colours)
    if len(points.positions) < fewest:
        points = _with_random(points, fewest - len(points.positions), views, rng)
    if not len(points.positions):
        raise SceneError("expected training views that look at a common place: no point to start from was found")
    if points.colours is None:
        points = replace(points, colours=_seen_colours(points.positions, views))
    return points


def _with_random(points: Points, count: int, views: Sequence[View], rng: np.random.Generator) -> Points:
    """The points and about `count` random ones, in their box or, where they are too few, before the cameras.

    Surfaces without texture have no points of their own; what is placed in empty space fades away.
    """
    cameras = [view.camera for view in views]
    if len(points.positions) >= BOX_POINTS:
        low, high = np.quantile(points.positions, [0.01, 0.99], axis=0)
        centre, reach = (low + high) / 2, BOX_MARGIN * (high - low) / 2
    else:
        centre, reach = looked_at(cameras), np.full(3, scene_extent(cameras))
    drawn = rng.uniform(centre - reach, centre + reach, (2 * count, 3))
    seen = np.zeros(len(drawn))
    for camera in cameras:
        seen[project(camera, drawn)[2]] += 1
    random = drawn[seen >= min(2, len(cameras))][:count].astype(np.float32)
    positions = np.concatenate([points.positions, random])
    colours = None
    if points.colours is not None:
        colours = np.concatenate([points.colours, _seen_colours(random, views)])
    return Points(positions, colours)


def looked_at(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """(3,) the point nearest to all optical axes, by least squares."""
    total, right = 1e-6 * np.eye(3), np.zeros(3)  # parallel axes meet nowhere: the system would be singular
    for camera in cameras:
        forward = camera.world_to_camera[2, :3]
        across = np.eye(3) - np.outer(forward, forward)
        total += across
        right += across @ camera.position
    return np.asarray(np.linalg.solve(total, right), np.float64)


def _seen_colours(positions: NDArray[np.float32], views: Sequence[View]) -> NDArray[np.float32]:
    """(P, 3) median colour over the views whose picture a point falls into, 0.5 where there is none.

    The median is that of the surface as long as the point is hidden from fewer than half of the views.
    """
    colours = np.full((len(views), len(positions), 3), np.nan, np.float32)
    for colour, view in zip(colours, views, strict=True):
        rows, columns, inside = project(view.camera, positions)
        colour[inside] = view.target.rgb[rows, columns]
    seen = ~np.isnan(colours[..., 0]).all(axis=0)
    out = np.full((len(positions), 3), 0.5, np.float32)
    out[seen] = np.nanmedian(colours[:, seen], axis=0)
    return out
