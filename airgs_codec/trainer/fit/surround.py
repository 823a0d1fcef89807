"""What stands around a rig that looks inwards: walls and floor, as one distance from its middle for each direction.

Few cameras that are far apart share too few features there. A distance is where pictures agree (plane sweep, Collins
1996), decided for all directions together by belief propagation (Felzenszwalb and Huttenlocher 2006): neighbours are
alike. Planes through what was decided make it smooth: on a plane 1 / distance is linear in the direction.

D directions, L distances, K neighbours of a direction, P points, C channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from airgs_codec.media.image import box_mean, resize
from airgs_codec.render import Camera
from airgs_codec.scene.camera import GOLDEN_ANGLE, looked_at
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.fit.points import (
    SPARSE_DEGREES,
    degrees_apart,
    project,
    scene_extent,
    seen_colours,
)

FEWEST = 4  # cameras that can surround a scene
PARTS = 20  # of each side of a picture
COVERED = 0.2  # share of its parts that points fall into, from which they tell all of a scene
CUT, CUT_SHARE = 1 / 255, 0.2  # distance to the background of what is cut out, and share of pictures that it may be
SURROUNDS = 0.6  # length of the mean direction to the cameras, up to which they do
DIRECTIONS, DISTANCES = 4000, 64
RANGE = (0.25, 5.0)  # nearest and farthest distance, over the scene's extent
VIEWS = 12  # that are compared, at most
SIZE = 240  # pixels on the longest side of pictures that are compared
BANDS = ((3, 13), (7, 33))  # pixels: what is compared is finer than the second and coarser than the first
NOISE = 0.03  # deviation of a band that counts as texture
ROUNDS = 30  # of belief propagation
STEP = 0.2  # cost of a neighbour one distance away, where pictures disagree by up to 1
FARTHEST = 16  # distances; a neighbour that is farther away costs no more
NEAREST = 9  # directions that vote together
PLANE = 80  # directions that a plane is fitted to


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """The points that the first frame of a sparse rig starts from."""

    points: Points
    unseen: Points  # what stands around where no view looks, in the colours of what is next to it: nothing fits it


def sparse_cloud(given: Points | None, views: Sequence[View], most: int, rng: np.random.Generator) -> Cloud | None:
    """What stands around a rig, and in it the points `given` of a scene; up to `most` of both.

    None where no points are given or they tell all of the scene, where cameras stand close together or not around it,
    and where there is nothing around it.
    """
    cameras = [view.camera for view in views]
    if degrees_apart(cameras) <= SPARSE_DEGREES or not surround(cameras) or _plain(views):
        return None
    if given is None or _covered(given.positions, cameras) >= COVERED:
        return None
    around = surroundings(views)
    seen = np.zeros(len(around), np.bool_)
    for camera in cameras:
        seen[project(camera, around)[2]] = True
    outer = _some(Points(around[seen], seen_colours(around[seen], views)), most // 2, rng)
    colours = seen_colours(given.positions, views) if given.colours is None else given.colours
    inner = _some(replace(given, colours=colours), most - len(outer.positions), rng)
    points = Points(*(np.concatenate(parts) for parts in zip(_columns(outer), _columns(inner), strict=True)))
    places, shown = _columns(outer)
    unseen = Points(around[~seen], shown[cKDTree(places).query(around[~seen])[1]])
    return Cloud(points, _some(unseen, most // 10, rng))


def _some(points: Points, most: int, rng: np.random.Generator) -> Points:
    chosen = np.sort(rng.permutation(len(points.positions))[:most])
    return Points(*(column[chosen] for column in _columns(points)))


def _columns(points: Points) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    assert points.colours is not None
    return points.positions, points.colours


def _plain(views: Sequence[View]) -> bool:
    """Whether much of the pictures is their background's colour: somebody cut out what they show."""
    shares = [(np.abs(view.target.rgb - view.camera.background).max(axis=2) < CUT).mean() for view in views]
    return float(np.mean(shares)) > CUT_SHARE


def _covered(positions: NDArray[np.floating], cameras: Sequence[Camera]) -> float:
    """Mean share of the parts of the pictures that points (P, 3) fall into."""
    shares = []
    for camera in cameras:
        rows, columns, _ = project(camera, positions)
        parts = (rows * PARTS // camera.height) * PARTS + columns * PARTS // camera.width
        shares.append(len(np.unique(parts)) / PARTS**2)
    return float(np.mean(shares))


def surround(cameras: Sequence[Camera]) -> bool:
    towards = np.stack([camera.position for camera in cameras]) - looked_at(cameras)
    mean = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).mean(axis=0)
    return len(cameras) >= FEWEST and float(np.linalg.norm(mean)) < SURROUNDS


def surroundings(views: Sequence[View]) -> NDArray[np.float32]:
    """(D, 3) what stands around cameras that `surround` a scene, in every direction from where they look at."""
    cameras = [view.camera for view in views]
    centre, extent = looked_at(cameras), scene_extent(cameras)
    rise = 1 - (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS
    turn, across = GOLDEN_ANGLE * np.arange(DIRECTIONS), np.sqrt(1 - rise**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), rise], axis=1).astype(np.float64)
    inverse = np.linspace(1 / (RANGE[0] * extent), 1 / (RANGE[1] * extent), DISTANCES)
    places = centre + directions[:, None] / inverse[:, None]
    cost, pairs = _disagreement(views[:: -(-len(views) // VIEWS)], places)
    tree, known = cKDTree(directions), pairs > 0
    usual = np.median(cost[known] / pairs[known]) if known.any() else 0.0
    mean = (cost + usual) / (pairs + 1)  # the fewer see a place, the less it tells
    mean[_between(cameras, places)] += 2  # cameras stand in the room
    near = tree.query(directions, k=NEAREST)[1]
    mean = mean[near].mean(axis=1)
    chosen = _decide(mean, near[:, 1:])
    gain = np.median(mean, axis=1) - np.take_along_axis(mean, chosen[:, None], axis=1)[:, 0]
    weight = 1e-3 + known.any(axis=1) * np.maximum(gain, 0)
    near, spread = tree.query(directions, k=PLANE)[1], 1.5 * (inverse[0] - inverse[1])
    smooth = inverse[chosen]
    for _ in range(2):
        smooth = _on_planes(directions, smooth, weight, near, spread)
    return (centre + directions / np.clip(smooth, inverse[-1], inverse[0])[:, None]).astype(np.float32)


def _between(cameras: Sequence[Camera], places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(D, L) whether places (D, L, 3) are in the convex hull of the cameras; none where they stand in a plane.

    Cameras count on the other side of the rig's axis as well: a room is no narrower where a rig has a gap.
    """
    mean = np.mean([camera.world_to_camera[1, :3] for camera in cameras], axis=0)
    down = mean / np.linalg.norm(mean)
    from_centre = np.stack([camera.position for camera in cameras]) - looked_at(cameras)
    across = 2 * (from_centre @ down)[:, None] * down - from_centre
    try:
        faces = ConvexHull(looked_at(cameras) + np.concatenate([from_centre, across])).equations
    except QhullError:
        return np.zeros(places.shape[:2], np.bool_)
    inside = np.ones(places.shape[:2], np.bool_)
    for face in faces:
        inside &= places @ face[:3] + face[3] < 0
    return inside


def _disagreement(
    views: Sequence[View], places: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(D, L) summed differences, up to 1 each, of what views see at places (D, L, 3) to one of them, and their number.

    Both are 0 where fewer than two see one.
    """
    cost, pairs = np.zeros(places.shape[:2], np.float32), np.zeros(places.shape[:2], np.float32)
    pictures = [_features(view) for view in views]
    for part in np.array_split(np.arange(len(places)), -(-len(places) // 500)):
        points = places[part].reshape(-1, 3)
        values = np.full((len(views), len(points), pictures[0].shape[2]), np.nan, np.float32)
        for value, view, picture in zip(values, views, pictures, strict=True):
            rows, columns, inside = project(view.camera, points)
            scale = np.array(picture.shape[:2]) / (view.camera.height, view.camera.width)
            value[inside] = picture[(rows * scale[0]).astype(int), (columns * scale[1]).astype(int)]
        seen = np.isfinite(values[..., 0]).sum(axis=0)
        found, both = np.zeros(len(points), np.float32), seen >= 2
        apart = np.abs(values[:, both] - np.nanmedian(values[:, both], axis=0)).sum(axis=2) / 3
        found[both] = np.nansum(np.minimum(apart, 1), axis=0)
        cost[part], pairs[part] = (a.reshape(len(part), -1) for a in (found, np.maximum(seen - 1, 0)))
    return cost, pairs


def _features(view: View) -> NDArray[np.float32]:
    """(H, W, C) a small picture's texture, whatever its contrast: the level of light is another one from elsewhere."""
    rgb = view.target.rgb
    scale = min(1.0, SIZE / max(rgb.shape[:2]))
    small = resize(rgb, max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
    bands = []
    for fine, coarse in BANDS:
        band = box_mean(small, fine) - box_mean(small, coarse)
        deviation = np.sqrt(box_mean(np.square(band).sum(axis=2), coarse))[..., None]
        bands.append(band / (2 * (deviation + NOISE)))
    return np.concatenate(bands, axis=2)


def _decide(cost: NDArray[np.floating], near: NDArray[np.intp]) -> NDArray[np.intp]:
    """(D,) the distance of each direction by costs (D, L) and neighbours (D, K), min-sum with damped messages."""
    belief = cost.copy()
    for _ in range(ROUNDS):
        told = belief.copy()
        for i in range(1, DISTANCES):
            told[:, i] = np.minimum(told[:, i], told[:, i - 1] + STEP)
        for i in range(DISTANCES - 2, -1, -1):
            told[:, i] = np.minimum(told[:, i], told[:, i + 1] + STEP)
        told -= told.min(axis=1, keepdims=True)
        belief = (cost + 4 * np.minimum(told, STEP * FARTHEST)[near].mean(axis=1)) / 3
    return np.asarray(belief.argmin(axis=1), np.intp)


def _on_planes(
    directions: NDArray[np.float64],
    inverse: NDArray[np.float64],
    weight: NDArray[np.float64],
    near: NDArray[np.intp],
    spread: float,
) -> NDArray[np.float64]:
    """(D,) 1 / distance on a plane through the neighbours (D, K) of each direction, without those that are far off.

    `spread`: how far off a neighbour is that counts half.
    """
    around, values = directions[near], inverse[near]
    w = weight[near]
    for _ in range(4):
        # A ridge, so that neighbours all in one line tell a plane, too.
        left = np.einsum("dki,dkj,dk->dij", around, around, w) + 5e-5 * w.sum(axis=1)[:, None, None] * np.eye(3)
        plane = np.linalg.solve(left, np.einsum("dki,dk,dk->di", around, values, w)[..., None])
        apart = values - (around @ plane)[..., 0]
        w = weight[near] / (1 + np.square(apart / spread))
    return np.asarray((directions * plane[..., 0]).sum(axis=1), np.float64)
