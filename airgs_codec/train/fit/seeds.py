"""New Gaussians where something has appeared: on the visual hull of what the views cannot explain.

Densification only refines what is there; an object in empty space has no Gaussian near it to clone (21.7 dB against
33.9 with seeds on a test scene). A point belongs to the hull if almost every view that sees it disagrees there.

P points, V views, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.media.image import box_mean
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.pictures import View
from airgs_codec.train.data.plates import Masks
from airgs_codec.train.fit.parameters import from_points
from airgs_codec.train.fit.projection import project

CANDIDATES = 200_000  # points that are drawn to find the hull, and drawn again inside it
RESIDUAL = 0.06  # mean absolute difference of colours over 3 x 3 pixels, from which a view disagrees
AGREE = 0.85  # share of the views that see a point of the hull, which disagree there
SEEN = 0.5  # share of all views that see a point of the hull
FEWEST = 50  # points of a hull; below that it is noise, and densification has to do
OPACITY = 0.5  # of a seed
VISIBLE = 0.1  # opacity of a Gaussian that counts as being there
CLEAR = 3.0  # median spacings of what is there: nearer to it, it can move or change its colour itself
TIGHT = 0.7  # radius of a seed, over the distance to the nearest ones: they lie on a surface


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Points that views see."""

    positions: NDArray[np.float64]  # (P, 3) world units
    colours: NDArray[np.float64]  # (P, 3) mean over the views that see a point, 0..1
    disagreement: NDArray[np.float64]  # (P,) variance over these views, summed over colours


def find_wrong(g: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> Masks:
    """The pixels of views where the pictures of `g` differ from them."""
    loaded = renderer.load(g)
    return Masks(box_mean(np.abs(loaded.draw(v.camera).rgb - v.target.rgb).mean(axis=2), 3) > RESIDUAL for v in views)


def residual_seeds(
    g: Gaussians,
    views: Sequence[View],
    wrong: Sequence[NDArray[np.bool_]],
    most: int,
    largest: float,
    rng: np.random.Generator,
) -> Gaussians | None:
    """Up to `most` Gaussians beside `g` where its pictures are `wrong` (H, W); None where nothing has appeared.

    `largest`: their largest radius in world units.
    """
    coarse = _hull(_away_from_visible(rng.uniform(*_box(g), (CANDIDATES, 3)), g), views, wrong)
    if len(coarse) < FEWEST or most < 1:
        return None
    low, high = coarse.min(axis=0), coarse.max(axis=0)
    margin = 0.05 * (high - low)
    drawn = rng.uniform(low - margin, high + margin, (CANDIDATES, 3))
    hull = _hull(_away_from_visible(drawn, g), views, wrong)
    if len(hull) < FEWEST:
        return None
    surface = _surface(hull, views)
    chosen = _one_per_cell(surface, most)
    positions, colours = (a[chosen].astype(np.float32) for a in (surface.positions, surface.colours))
    seeds = from_points(positions, colours, g.sh_degree, OPACITY, largest)
    sizes = np.minimum(seeds.log_scales, np.median(seeds.log_scales))  # one that lies apart is no larger than others
    return replace(seeds, log_scales=sizes + np.float32(np.log(TIGHT)))


def _hull(
    points: NDArray[np.float64], views: Sequence[View], wrong: Sequence[NDArray[np.bool_]]
) -> NDArray[np.float64]:
    """The points (P, 3) at which almost every view that sees them is in its mask `wrong` (H, W)."""
    seen, agree = np.zeros(len(points)), np.zeros(len(points))
    for view, mask in zip(views, wrong, strict=True):
        rows, columns, inside = project(view.camera, points)
        seen[inside] += 1
        agree[inside] += mask[rows, columns]
    return points[(seen >= SEEN * len(views)) & (agree >= AGREE * seen)]


def _away_from_visible(points: NDArray[np.float64], g: Gaussians) -> NDArray[np.float64]:
    """The points (P, 3) that are not next to a Gaussian that can be seen."""
    there = g.means[g.opacities() > VISIBLE].astype(np.float64)
    if len(there) < 2:
        return points
    tree = cKDTree(there)
    clear = CLEAR * float(np.median(tree.query(there, k=2)[0][:, 1]))
    return points[tree.query(points, distance_upper_bound=clear)[0] > clear]


def _surface(hull: NDArray[np.float64], views: Sequence[View]) -> _Surface:
    """The points of a hull (P, 3) that at least three views see first.

    A point is seen by a view if no other lies clearly before it in its pixel. Hulls are larger than what is in them:
    where the surface is not that of the object, views see different things behind it.
    """
    size = hull.max(axis=0) - hull.min(axis=0)
    tolerance = 2 * (float(np.prod(size)) / len(hull)) ** (1 / 3)  # twice the points' spacing
    seen, sums, squares = np.zeros(len(hull)), np.zeros((len(hull), 3)), np.zeros((len(hull), 3))
    for view in views:
        rows, columns, inside = project(view.camera, hull)
        depth = hull[inside] @ view.camera.world_to_camera[2, :3] + view.camera.world_to_camera[2, 3]
        nearest = np.full((view.camera.height, view.camera.width), np.inf)
        np.minimum.at(nearest, (rows, columns), depth)
        first = depth <= nearest[rows, columns] + tolerance
        colour = view.target.rgb[rows[first], columns[first]].astype(np.float64)
        seen[inside[first]] += 1
        sums[inside[first]] += colour
        squares[inside[first]] += colour**2
    outside = np.flatnonzero(seen >= min(3, len(views)))
    mean = sums[outside] / seen[outside, None]
    return _Surface(hull[outside], mean, (squares[outside] / seen[outside, None] - mean**2).sum(axis=1))


def _one_per_cell(surface: _Surface, most: int) -> NDArray[np.intp]:
    """At most `most` of the points, one in each cell of a grid: the one on whose colour views agree best."""
    points = surface.positions
    best = np.argsort(surface.disagreement, kind="stable")
    size = float((points.max(axis=0) - points.min(axis=0)).max()) if len(points) else 0.0
    for cells in range(round(most**0.5) + 2, 0, -1):
        if size == 0.0:
            return best[:most]
        cell = np.floor((points[best] - points.min(axis=0)) / (size / cells)).astype(np.int64)
        _, first = np.unique(cell, axis=0, return_index=True)
        if len(first) <= most:
            return np.sort(best[first])
    return best[:most]


def _box(g: Gaussians) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (3,) of the box that holds all but the farthest hundredths, and a fifth more on every side."""
    visible = g.means[g.opacities() > VISIBLE].astype(np.float64)
    low, high = np.quantile(visible if len(visible) else g.means, [0.01, 0.99], axis=0)
    return low - 0.2 * (high - low), high + 0.2 * (high - low)
