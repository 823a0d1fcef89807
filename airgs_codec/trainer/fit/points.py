"""The cloud that the first frame starts from: given, or triangulated from SIFT features that several views see.

Random points fill it up where it is thin. Around a rig that looks inwards stand walls and floor, where few cameras
that are far apart share too few features: they are one distance from its middle for each direction. A distance is
where pictures agree (plane sweep, Collins 1996), decided for all directions together by belief propagation
(Felzenszwalb and Huttenlocher 2006), which prefers equal neighbours. Planes fitted to the result make it smooth: on a
plane 1 / distance is linear in the direction.

P points, n of them inside a picture, V views, F features of all views together, numbered one view after another, D
directions, L distances, K neighbours of a direction, C channels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError, cKDTree

from airgs_codec.errors import SceneError
from airgs_codec.media.image import box_mean, match_features, resize, sift
from airgs_codec.scene.camera import Camera, looked_at, spiral
from airgs_codec.scene.gaussians import SH_C0, SH_REST, Gaussians
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.data.pictures import View

NEAREST = 100  # distances to what is near: in an extent of 1,000, one step would carry it out of view


def scene_extent(cameras: Sequence[Camera], points: Points | None = None) -> float:
    """Return the size of a scene in world units: 1.1 times the largest distance of a camera to their centre (3DGS).

    It is at least the median distance of the points to that centre: a narrow rig would make steps and sizes too small
    for what it sees. `limited` by what is near. 1 where all cameras are in one place and there are no points.
    """
    places = np.stack([camera.position for camera in cameras])
    centre = places.mean(axis=0)
    extent = 1.1 * float(np.linalg.norm(places - centre, axis=1).max())
    if points is not None and len(seen := points.positions[np.isfinite(points.positions).all(axis=1)]):
        extent = max(extent, float(np.median(np.linalg.norm(seen - centre, axis=1))))
        extent = limited(extent, places, seen)
    return extent or 1.0


def limited(extent: float, places: NDArray[np.float64], positions: NDArray[np.floating]) -> float:
    """Return the extent, or NEAREST times the distance within which cameras (V, 3) have a tenth of positions (P, 3)."""
    return min(extent, NEAREST * float(np.quantile(cKDTree(places).query(positions)[0], 0.1)))


def initial_points(given: Points | None, views: Sequence[View], fewest: int, rng: np.random.Generator) -> Points:
    """Return the given or triangulated points, finite and coloured, with random ones up to `fewest`.

    Raises SceneError when there are neither points nor two views to find them in, or no point is left.
    """
    if given is None and len(views) < 2:
        raise SceneError("expected a cloud of points or at least two training views, got one view")
    points = triangulate(views) if given is None else given
    finite = np.isfinite(points.positions).all(axis=1)
    points = Points(points.positions[finite], None if points.colours is None else points.colours[finite])
    if len(points.positions) < fewest:
        points = _with_random(points, fewest - len(points.positions), views, rng)
    if not len(points.positions):
        raise SceneError("expected training views that look at a common place: no point to start from was found")
    return replace(points, colours=seen_colours(points.positions, views)) if points.colours is None else points


def from_points(
    positions: NDArray[np.float32], colours: NDArray[np.float32], sh_degree: int, opacity: float, largest: float
) -> Gaussians:
    """Return balls with RGB `colours` (P, 3), as large as their three nearest neighbours are far, but for `largest`."""
    n = len(positions)
    near, _ = cKDTree(positions).query(positions, k=min(4, n))
    spacing = np.sqrt(np.square(near.reshape(n, -1)[:, 1:]).mean(axis=1)) if n > 1 else np.full(n, 0.01 * largest)
    radius = np.log(np.clip(spacing, 1e-4 * largest, largest))  # the logarithm of coincident points' 0 is -Inf
    turns, scales = np.tile([1, 0, 0, 0], (n, 1)), np.repeat(radius[:, None], 3, axis=1)
    logits, sh_dc = np.full(n, math.log(opacity / (1 - opacity))), (colours - 0.5) / SH_C0
    columns = (positions, turns, scales, logits, sh_dc, np.zeros((n, SH_REST[sh_degree], 3)))
    return Gaussians(*(column.astype(np.float32) for column in columns))


def _with_random(points: Points, count: int, views: Sequence[View], rng: np.random.Generator) -> Points:
    """Return the points and about `count` random ones, in their box or, where they are too few, before the cameras."""
    cameras = [view.camera for view in views]
    centre, reach = looked_at(cameras), np.full(3, scene_extent(cameras))
    if len(points.positions) >= 50:
        low, high = np.quantile(points.positions, [0.01, 0.99], axis=0)
        centre, reach = (low + high) / 2, 1.15 * (high - low) / 2
    drawn = rng.uniform(centre - reach, centre + reach, (2 * count, 3))
    seen = np.sum([np.isin(np.arange(len(drawn)), project(camera, drawn)[2]) for camera in cameras], axis=0)
    random = drawn[seen >= min(2, len(cameras))][:count].astype(np.float32)
    known = points.colours is not None
    colours = np.concatenate([points.colours, seen_colours(random, views)]) if known else None
    return Points(np.concatenate([points.positions, random]), colours)


SPARSE_DEGREES = 30.0  # between neighbouring cameras, from which views between them are soft


def degrees_apart(cameras: Sequence[Camera]) -> float:
    """Return the median angle between a camera and the nearest other one, from where they look at; 0 for one."""
    towards = np.stack([camera.position for camera in cameras]) - looked_at(cameras)
    unit = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    cosines = unit @ unit.T
    np.fill_diagonal(cosines, -1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosines.max(axis=1), -1, 1))))) if len(cameras) > 1 else 0.0


def seen_colours(positions: NDArray[np.floating], views: Sequence[View]) -> NDArray[np.float32]:
    """Return (P, 3) the median colour over the views whose picture a point falls into, 0.5 where there is none."""
    colours = np.full((len(views), len(positions), 3), np.nan, np.float32)
    for colour, view in zip(colours, views, strict=True):
        rows, columns, inside = project(view.camera, positions)
        colour[inside] = view.target.rgb[rows, columns]
    seen = ~np.isnan(colours[..., 0]).all(axis=0)
    out = np.full((len(positions), 3), 0.5, np.float32)
    out[seen] = np.nanmedian(colours[:, seen], axis=0)
    return out


def triangulate(views: Sequence[View]) -> Points:
    """Return the points of the tracks of SIFT features over neighbouring views, and their median colours.

    A track that meets a view twice has none, nor has one whose rays do not `intersect`.
    """
    features = [_features(view) for view in views]
    first = np.concatenate([[0], np.cumsum([len(f[0]) for f in features])])
    links = [np.empty((0, 2), np.intp)]
    for a, b in neighbours([view.camera for view in views], 6):
        matches = match_features(features[a][1], features[b][1], 0.8)  # ratio of Lowe 2004, 7.1
        links.append(matches + np.array([first[a], first[b]]))
    pairs = np.concatenate(links)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(first[-1], first[-1]))
    _, track = connected_components(graph, directed=False)
    places, colours = (np.concatenate([f[i] for f in features]) for i in (0, 2))
    view_of, order = np.repeat(np.arange(len(views)), np.diff(first)), np.argsort(track, kind="stable")
    found: list[tuple[NDArray[np.floating], NDArray[np.floating]]] = []
    for members in np.split(order, np.flatnonzero(np.diff(track[order])) + 1):
        if len(members) > 1 and len(set(view_of[members])) == len(members):
            point = intersect([views[view_of[m]].camera for m in members], places[members])
            if point is not None:
                found.append((point, np.median(colours[members], axis=0)))
    table = np.array(found, np.float32).reshape(-1, 2, 3)
    return Points(table[:, 0], table[:, 1])


def _features(view: View) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
    """Places (F, 2) in pixels, descriptors (F, 128) and colours (F, 3) of a view's SIFT features."""
    picture = view.target.rgb
    places, descriptors = sift(picture, 4000)
    columns, rows = places.astype(int).T
    return places, descriptors, picture[rows, columns]


def neighbours(cameras: Sequence[Camera], count: int) -> list[tuple[int, int]]:
    """Return pairs of cameras (a, b), a < b: each with the `count` nearest to it in direction and place."""
    forward = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    place = np.stack([camera.position for camera in cameras])
    distances = np.linalg.norm(place[:, None] - place[None], axis=2)
    unlike = (1 - forward @ forward.T) + distances / (float(distances.max()) or 1.0)  # all in one place: 0 / 0
    nearest = np.argsort(unlike, axis=1, kind="stable")[:, : count + 1]
    return sorted({(min(a, b), max(a, b)) for a, row in enumerate(nearest.tolist()) for b in row if a != b})


def intersect(cameras: Sequence[Camera], places: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return (3,) the point that V cameras see at pixels (V, 2), by linear triangulation.

    None if it is behind a camera, projects 2 pixels or more away from a pixel, or all rays are within a degree
    (Hartley and Zisserman, 12.2).
    """
    rows = []
    for camera, (u, v) in zip(cameras, places, strict=True):
        m = camera.world_to_camera[:3]
        rows += [(u - camera.cx) / camera.fx * m[2] - m[0], (v - camera.cy) / camera.fy * m[2] - m[1]]
    x, y, z, w = np.linalg.svd(np.array(rows))[2][-1]
    if abs(w) < 1e-12:  # at infinity
        return None
    point = np.array([x, y, z]) / w
    for camera, place in zip(cameras, places, strict=True):
        a, b, depth = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
        if depth <= 0:
            return None
        seen = np.array([camera.fx * a / depth + camera.cx, camera.fy * b / depth + camera.cy])
        if np.linalg.norm(seen - place) >= 2:
            return None
    rays = point - np.stack([camera.position for camera in cameras])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return point if (rays @ rays.T).min() < np.cos(np.radians(1)) else None


def project(
    camera: Camera, points: NDArray[np.floating]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return rows (n,) and columns (n,) of the pixels that points (P, 3) ahead fall into, and which (n,) they are."""
    view = camera.world_to_camera
    x, y, z = (points @ view[:3, :3].T + view[:3, 3]).T
    ahead = z > camera.near
    safe = np.where(ahead, z, 1.0)
    column, row = camera.fx * x / safe + camera.cx, camera.fy * y / safe + camera.cy
    inside = np.flatnonzero(ahead & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height))
    return row[inside].astype(np.intp), column[inside].astype(np.intp), inside


Floats = NDArray[np.float64]
DISTANCES = 64
STEP = 0.2  # cost of a neighbour one distance away, where pictures disagree by up to 1


def sparse_cloud(
    given: Points | None, views: Sequence[View], most: int, rng: np.random.Generator
) -> tuple[Points, Points] | None:
    """Return what stands around a rig with the points `given` of a scene, up to `most`; and what no view sees of it.

    The latter has the colours of what is next to it, and nothing fits it. None where no points are given or they cover
    a fifth of the pictures, which somebody cut out, or whose cameras stand close together or not around the scene.
    """
    cameras = [view.camera for view in views]
    if given is None or degrees_apart(cameras) <= SPARSE_DEGREES or not surround(cameras):
        return None
    plain = [(np.abs(view.target.rgb - view.camera.background).max(axis=2) < 1 / 255).mean() for view in views]
    if float(np.mean(plain)) > 0.2 or _covered(given.positions, cameras) >= 0.2:
        return None
    around = surroundings(views)
    seen = np.zeros(len(around), np.bool_)
    for camera in cameras:
        seen[project(camera, around)[2]] = True

    def some(places: NDArray[np.floating], colours: NDArray[np.float32], count: int) -> Points:
        chosen = np.sort(rng.permutation(len(places))[:count])
        return Points(places[chosen], colours[chosen])

    outer = some(around[seen], seen_colours(around[seen], views), most // 2)
    colours = seen_colours(given.positions, views) if given.colours is None else given.colours
    inner = some(given.positions, colours, most - len(outer.positions))
    assert outer.colours is not None and inner.colours is not None
    both = [np.concatenate(pair) for pair in ((outer.positions, inner.positions), (outer.colours, inner.colours))]
    nearest = outer.colours[cKDTree(outer.positions).query(around[~seen])[1]]
    return Points(both[0], both[1]), some(around[~seen], nearest, most // 10)


def _covered(positions: NDArray[np.floating], cameras: Sequence[Camera]) -> float:
    """Return mean share of the pictures' parts, 20 on each side, that points (P, 3) fall into."""
    shares = []
    for camera in cameras:
        rows, columns, _ = project(camera, positions)
        shares.append(len(np.unique((rows * 20 // camera.height) * 20 + columns * 20 // camera.width)) / 400)
    return float(np.mean(shares))


def surround(cameras: Sequence[Camera]) -> bool:
    towards = np.stack([camera.position for camera in cameras]) - looked_at(cameras)
    mean = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).mean(axis=0)
    return len(cameras) >= 4 and float(np.linalg.norm(mean)) < 0.6


def surroundings(views: Sequence[View]) -> NDArray[np.float32]:
    """Return (D, 3) what stands around cameras that `surround` a scene, in every direction from where they look at."""
    cameras = [view.camera for view in views]
    centre, extent, directions = looked_at(cameras), scene_extent(cameras), spiral(4000)[:, [1, 2, 0]]
    inverse = np.linspace(1 / (0.25 * extent), 1 / (5 * extent), DISTANCES)
    places = centre + directions[:, None] / inverse[:, None]
    cost, pairs = _disagreement(views[:: -(-len(views) // 12)], places)
    tree, known = cKDTree(directions), pairs > 0
    usual = np.median(cost[known] / pairs[known]) if known.any() else 0.0
    mean = (cost + usual) / (pairs + 1)  # the fewer see a place, the less certain it is
    mean[_between(cameras, places)] += 2  # cameras stand in the room
    near = tree.query(directions, k=9)[1]
    mean = mean[near].mean(axis=1)
    chosen = _decide(mean, near[:, 1:])
    gain = np.median(mean, axis=1) - np.take_along_axis(mean, chosen[:, None], axis=1)[:, 0]
    weight = 1e-3 + known.any(axis=1) * np.maximum(gain, 0)
    near, spread = tree.query(directions, k=80)[1], 1.5 * (inverse[0] - inverse[1])
    smooth = inverse[chosen]
    for _ in range(2):
        smooth = _on_planes(directions, smooth, weight, near, spread)
    return (centre + directions / np.clip(smooth, inverse[-1], inverse[0])[:, None]).astype(np.float32)


def _between(cameras: Sequence[Camera], places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (D, L) whether places (D, L, 3) are in the convex hull of the cameras; none where they stand in a plane.

    Cameras count on the other side of the rig's axis as well: a room is no narrower where a rig has a gap.
    """
    mean = np.mean([camera.world_to_camera[1, :3] for camera in cameras], axis=0)
    down = mean / np.linalg.norm(mean)
    from_centre = np.stack([camera.position for camera in cameras]) - looked_at(cameras)
    across = 2 * (from_centre @ down)[:, None] * down - from_centre
    try:
        hull = Delaunay(looked_at(cameras) + np.concatenate([from_centre, across]))
    except QhullError:
        return np.zeros(places.shape[:2], np.bool_)
    return np.asarray(hull.find_simplex(places) >= 0)


def _disagreement(views: Sequence[View], places: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (D, L) summed differences, up to 1 each, of views at places (D, L, 3), and their number; 0 of one."""
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
        errors = np.abs(values[:, both] - np.nanmedian(values[:, both], axis=0)).sum(axis=2) / 3
        found[both] = np.nansum(np.minimum(errors, 1), axis=0)
        cost[part], pairs[part] = (a.reshape(len(part), -1) for a in (found, np.maximum(seen - 1, 0)))
    return cost, pairs


def _texture(view: View) -> NDArray[np.float32]:
    """Return (H, W, C) texture of a picture of 240 pixels, whatever its contrast: light differs from elsewhere."""
    rgb = view.target.rgb
    scale = min(1.0, 240 / max(rgb.shape[:2]))
    small = resize(rgb, max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
    bands = []
    for fine, coarse in ((3, 13), (7, 33)):  # pixels: coarser than the first and finer than the second
        band = box_mean(small, fine) - box_mean(small, coarse)
        deviation = np.sqrt(box_mean(np.square(band).sum(axis=2), coarse))[..., None]
        bands.append(band / (2 * (deviation + 0.03)))  # less than this deviation is no texture
    return np.concatenate(bands, axis=2)


def _decide(cost: NDArray[np.floating], near: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return (D,) the distance of each direction by costs (D, L) and neighbours (D, K): damped min-sum."""
    belief, ramp = cost.copy(), STEP * np.arange(DISTANCES)
    for _ in range(30):
        up = np.minimum.accumulate(belief - ramp, axis=1) + ramp
        down = np.minimum.accumulate((belief + ramp)[:, ::-1], axis=1)[:, ::-1] - ramp
        message = np.minimum(up, down) - belief.min(axis=1, keepdims=True)
        belief = (cost + 4 * np.minimum(message, 16 * STEP)[near].mean(axis=1)) / 3  # 16 distances cost the most
    return np.asarray(belief.argmin(axis=1), np.intp)


def _on_planes(directions: Floats, inverse: Floats, weight: Floats, near: NDArray[np.intp], spread: float) -> Floats:
    """Return (D,) 1 / distance on planes through neighbours (D, K); one that is `spread` off counts half."""
    around, values = directions[near], inverse[near]
    w = weight[near]
    for _ in range(4):
        # A ridge, so that neighbours that are collinear define a plane, too.
        left = np.einsum("dki,dkj,dk->dij", around, around, w) + 5e-5 * w.sum(axis=1)[:, None, None] * np.eye(3)
        plane = np.linalg.solve(left, np.einsum("dki,dk,dk->di", around, values, w)[..., None])
        off = values - (around @ plane)[..., 0]
        w = weight[near] / (1 + np.square(off / spread))
    return np.asarray((directions * plane[..., 0]).sum(axis=1), np.float64)
