"""The cloud that the first frame starts from: given, or triangulated from SIFT features that several views see.

Random points fill it up where it is thin. Around a rig that looks inwards stand walls and floor, where few cameras
that are far apart share too few features: they are one distance from its middle for each direction. A distance is
where pictures agree (plane sweep, Collins 1996), decided for all directions together by belief propagation
(Felzenszwalb and Huttenlocher 2006): neighbours are alike. Planes through what was decided make it smooth: on a plane
1 / distance is linear in the direction.

P points, n of them inside a picture, V views, F features of all views together, numbered one view after another, D
directions, L distances, K neighbours of a direction, C channels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from airgs_codec.errors import SceneError
from airgs_codec.media.image import box_mean, match_features, resize, sift
from airgs_codec.scene.camera import GOLDEN_ANGLE, Camera, looked_at
from airgs_codec.scene.gaussians import SH_C0, SH_REST, Gaussians
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.data.pictures import View

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
        points = replace(points, colours=seen_colours(points.positions, views))
    return points


def from_points(
    positions: NDArray[np.float32], colours: NDArray[np.float32], sh_degree: int, opacity: float, largest: float
) -> Gaussians:
    """Balls with RGB `colours` (P, 3), as large as their three nearest neighbours are far, but for `largest`."""
    n = len(positions)
    near, _ = cKDTree(positions).query(positions, k=min(4, n))
    spacing = np.sqrt(np.square(near.reshape(n, -1)[:, 1:]).mean(axis=1)) if n > 1 else np.full(n, 0.01 * largest)
    radius = np.log(np.clip(spacing, 1e-4 * largest, largest))  # the logarithm of coincident points' 0 is -Inf
    return Gaussians(
        means=positions.astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.repeat(radius[:, None], 3, axis=1).astype(np.float32),
        opacity_logits=np.full(n, math.log(opacity / (1 - opacity)), np.float32),
        sh_dc=((colours - 0.5) / SH_C0).astype(np.float32),
        sh_rest=np.zeros((n, SH_REST[sh_degree], 3), np.float32),
    )


def _with_random(points: Points, count: int, views: Sequence[View], rng: np.random.Generator) -> Points:
    """The points and about `count` random ones, in their box or, where they are too few, before the cameras."""
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
        colours = np.concatenate([points.colours, seen_colours(random, views)])
    return Points(positions, colours)


SPARSE_DEGREES = 30.0  # between neighbouring cameras, from which views between them are soft


def degrees_apart(cameras: Sequence[Camera]) -> float:
    """Median angle between a camera and the nearest other one, from where they look at; 0 for fewer than two."""
    towards = np.stack([camera.position for camera in cameras]) - looked_at(cameras)
    unit = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    cosines = unit @ unit.T
    np.fill_diagonal(cosines, -1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosines.max(axis=1), -1, 1))))) if len(cameras) > 1 else 0.0


def seen_colours(positions: NDArray[np.float32], views: Sequence[View]) -> NDArray[np.float32]:
    """(P, 3) median colour over the views whose picture a point falls into, 0.5 where there is none."""
    colours = np.full((len(views), len(positions), 3), np.nan, np.float32)
    for colour, view in zip(colours, views, strict=True):
        rows, columns, inside = project(view.camera, positions)
        colour[inside] = view.target.rgb[rows, columns]
    seen = ~np.isnan(colours[..., 0]).all(axis=0)
    out = np.full((len(positions), 3), 0.5, np.float32)
    out[seen] = np.nanmedian(colours[:, seen], axis=0)
    return out


FEATURES = 4000  # most in a view
NEIGHBOURS = 6  # views that each one is matched with
RATIO = 0.8  # of the distances to the best and the second match, at most (Lowe 2004, 7.1)
REPROJECTION = 2.0  # pixels, in every view of a track
LEAST_ANGLE = np.radians(1.0)  # between two rays of a track


def triangulate(views: Sequence[View]) -> Points:
    """The points of the tracks of SIFT features over neighbouring views (`intersect`), and their median colours."""
    features = [_features(view) for view in views]
    first = np.concatenate([[0], np.cumsum([len(f[0]) for f in features])])
    links = [
        match_features(features[a][1], features[b][1], RATIO) + np.array([first[a], first[b]])
        for a, b in neighbours([view.camera for view in views], NEIGHBOURS)
    ]
    pairs = np.concatenate(links) if links else np.empty((0, 2), np.intp)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(first[-1], first[-1]))
    _, track = connected_components(graph, directed=False)
    places, seen_colours = (np.concatenate([f[i] for f in features]) for i in (0, 2))
    view_of = np.repeat(np.arange(len(views)), np.diff(first))
    positions, colours = [], []
    for members in _tracks(track, view_of):
        cameras = [views[view_of[m]].camera for m in members]
        point = intersect(cameras, places[members])
        if point is not None:
            positions.append(point)
            colours.append(np.median(seen_colours[members], axis=0))
    shape = (-1, 3)
    return Points(np.array(positions, np.float32).reshape(shape), np.array(colours, np.float32).reshape(shape))


def _features(view: View) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
    """Places (F, 2) in pixels, descriptors (F, 128) and colours (F, 3) of a view's SIFT features."""
    picture = view.target.rgb
    places, descriptors = sift(picture, FEATURES)
    columns, rows = places.astype(int).T
    return places, descriptors, picture[rows, columns]


def neighbours(cameras: Sequence[Camera], count: int) -> list[tuple[int, int]]:
    """Pairs of cameras (a, b), a < b, each with the `count` that are most like it: in direction, and in place."""
    forward = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    place = np.stack([camera.position for camera in cameras])
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    farthest = float(apart.max()) or 1.0  # all cameras in one place: 0 / 0 otherwise
    unlike = (1 - forward @ forward.T) + apart / farthest
    pairs = set()
    for a, row in enumerate(unlike):
        for b in np.argsort(row, kind="stable")[: count + 1]:
            if a != b:
                pairs.add((min(a, int(b)), max(a, int(b))))
    return sorted(pairs)


def _tracks(track: NDArray[np.integer], view_of: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Features of each track, from the track (F,) and view (F,) of each; none of tracks that meet a view twice."""
    order = np.argsort(track, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(track[order])) + 1)
    return [g for g in groups if len(g) > 1 and len(set(view_of[g])) == len(g)]


def intersect(cameras: Sequence[Camera], places: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """(3,) the point that V cameras see at pixels (V, 2), by linear triangulation (Hartley and Zisserman, 12.2).

    None if it is behind a camera, projects REPROJECTION or more away from a pixel, or all rays are nearly parallel.
    """
    rows = []
    for camera, (u, v) in zip(cameras, places, strict=True):
        m = camera.world_to_camera[:3]
        rows += [(u - camera.cx) / camera.fx * m[2] - m[0], (v - camera.cy) / camera.fy * m[2] - m[1]]
    *_, vt = np.linalg.svd(np.array(rows))
    x, y, z, w = vt[-1]
    if abs(w) < 1e-12:  # at infinity
        return None
    point = np.array([x, y, z]) / w
    rays = []
    for camera, place in zip(cameras, places, strict=True):
        a, b, depth = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
        if depth <= 0:
            return None
        seen = np.array([camera.fx * a / depth + camera.cx, camera.fy * b / depth + camera.cy])
        if np.linalg.norm(seen - place) >= REPROJECTION:
            return None
        rays.append((point - camera.position) / np.linalg.norm(point - camera.position))
    cosines = np.stack(rays) @ np.stack(rays).T
    return point if cosines.min() < np.cos(LEAST_ANGLE) else None


def project(
    camera: Camera, points: NDArray[np.floating]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Rows (n,) and columns (n,) of the pixels that points (P, 3) ahead fall into, and which (n,) they are."""
    view = camera.world_to_camera
    x, y, z = (points @ view[:3, :3].T + view[:3, 3]).T
    ahead = z > camera.near
    safe = np.where(ahead, z, 1.0)
    column, row = camera.fx * x / safe + camera.cx, camera.fy * y / safe + camera.cy
    inside = np.flatnonzero(ahead & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height))
    return row[inside].astype(np.intp), column[inside].astype(np.intp), inside


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
    outer = _some(around[seen], seen_colours(around[seen], views), most // 2, rng)
    colours = seen_colours(given.positions, views) if given.colours is None else given.colours
    inner = _some(given.positions, colours, most - len(outer[0]), rng)
    points = Points(*(np.concatenate(parts) for parts in zip(outer, inner, strict=True)))
    nearest = outer[1][cKDTree(outer[0]).query(around[~seen])[1]]
    return Cloud(points, Points(*_some(around[~seen], nearest, most // 10, rng)))


def _some(
    places: NDArray[np.floating], colours: NDArray[np.float32], most: int, rng: np.random.Generator
) -> tuple[NDArray[np.floating], NDArray[np.float32]]:
    chosen = np.sort(rng.permutation(len(places))[:most])
    return places[chosen], colours[chosen]


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
    """(D, L) summed differences, up to 1 each, of views at places (D, L, 3), and their number; 0 for fewer than two."""
    cost, pairs = np.zeros(places.shape[:2], np.float32), np.zeros(places.shape[:2], np.float32)
    pictures = [_texture(view) for view in views]
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


def _texture(view: View) -> NDArray[np.float32]:
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
    """(D,) 1 / distance on planes through neighbours (D, K); one that is `spread` off counts half."""
    around, values = directions[near], inverse[near]
    w = weight[near]
    for _ in range(4):
        # A ridge, so that neighbours all in one line tell a plane, too.
        left = np.einsum("dki,dkj,dk->dij", around, around, w) + 5e-5 * w.sum(axis=1)[:, None, None] * np.eye(3)
        plane = np.linalg.solve(left, np.einsum("dki,dk,dk->di", around, values, w)[..., None])
        apart = values - (around @ plane)[..., 0]
        w = weight[near] / (1 + np.square(apart / spread))
    return np.asarray((directions * plane[..., 0]).sum(axis=1), np.float64)
