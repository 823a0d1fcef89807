"""The floor that an object stands on, if it has one.

N rows, n of them looked at. A floor is a plane with all else on one side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.viewpoint_score import flatness
from airgs_codec.scene.camera import spiral
from airgs_codec.scene.gaussians import Gaussians, to_matrices

Vectors = NDArray[np.float64]

ROWS = 10_000  # looked at
TRIED = 400  # directions all around; neighbours are 10 degrees apart
CONE = np.cos(np.radians(15))  # rows lie in a plane when their normals differ less from its own
THICKNESS = 0.03  # of a floor, in extents of the scene
FLOOR_SHARE = 0.15  # of the area of all rows lies in a floor, at least
ROUGH = 2.0  # thicknesses about a floor in which rows are on no side of it
SIDES = 3.0  # times as much lies above a floor as below it, at least


def find_floor(gaussians: Gaussians) -> Vectors | None:
    """The direction (3,) that is up where rows stand on a floor, of length 1; None without a floor.

    The thin axis of a flat row is the normal of the surface that it lies in. `gaussians` are repaired.
    """
    rows = np.random.default_rng(0).permutation(len(gaussians))[:ROWS]
    g = gaussians.take(np.sort(rows))
    areas = g.areas()
    areas = np.minimum(areas, np.quantile(areas, 0.99))  # a haze is no floor
    total = max(float(areas.sum()), np.finfo(np.float64).tiny)
    normals, weights = normals_of(g), areas * flatness(g)
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


def normals_of(gaussians: Gaussians) -> Vectors:
    """(N, 3) the thin axes of rows, of length 1 and either sign."""
    thin = np.argmin(gaussians.log_scales, axis=1)
    return to_matrices(gaussians.quaternions)[np.arange(len(gaussians)), :, thin].astype(np.float64)


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
    finest = 4 * np.spacing(max(abs(low), abs(high), np.finfo(np.float32).tiny))  # the edges differ
    step = max(THICKNESS * (high - low) / 2, finest)
    edges = np.arange(low - 2 * step, high + 3 * step, step)
    halves = np.histogram(values, edges, weights=weights)[0]
    best = int(np.argmax(halves[:-1] + halves[1:]))
    return float(edges[best]), float(edges[best + 2])
