"""Points of a scene from its pictures alone: SIFT features that several views see.

V views, F features of all views together, numbered one view after another.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from airgs_codec.media.image import match_features, sift
from airgs_codec.render import Camera
from airgs_codec.train.data.multiview import Points
from airgs_codec.train.data.pictures import View

FEATURES = 4000  # most in a view
NEIGHBOURS = 6  # views that each one is matched with
RATIO = 0.8  # of the distances to the best and the second match, at most (Lowe 2004, 7.1)
REPROJECTION = 2.0  # pixels, in every view of a track
LEAST_ANGLE = np.radians(1.0)  # between two rays of a track


def triangulate(views: Sequence[View]) -> Points:
    """The points of the views' SIFT tracks, and their median colours.

    Features are matched between neighbouring views, matches that share a feature are joined to tracks, and each track
    is triangulated and checked (`intersect`).
    """
    features = [_features(view) for view in views]
    first = np.concatenate([[0], np.cumsum([len(f[0]) for f in features])])
    links = [
        match_features(features[a][1], features[b][1], RATIO) + np.array([first[a], first[b]])
        for a, b in _neighbours([view.camera for view in views])
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


def _neighbours(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Pairs of cameras (a, b), a < b, that look most alike: in direction, and in place."""
    forward = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    place = np.stack([camera.position for camera in cameras])
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    farthest = float(apart.max()) or 1.0  # all cameras in one place: 0 / 0 otherwise
    unlike = (1 - forward @ forward.T) + apart / farthest
    pairs = set()
    for a, row in enumerate(unlike):
        for b in np.argsort(row, kind="stable")[: NEIGHBOURS + 1]:
            if a != b:
                pairs.add((min(a, int(b)), max(a, int(b))))
    return sorted(pairs)


def _tracks(track: NDArray[np.integer], view_of: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Features of each track, from the number of each feature's track (F,) and view (F,).

    Tracks that meet a view twice are mistaken and left out, as are features without a match.
    """
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
