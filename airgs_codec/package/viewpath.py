"""A viewer's walk through the region of a package: smooth, round the rig, never through what he looks at.

The walk leads from stop to stop: places of the region, or cameras. Two stops are neighbours where the straight way
between them, with the focus going over straight as well, keeps half of its distance from the focus: there is no way
through the content to the other side. Between places, it has to be inside of the region as well, and so is all of the
walk, if it is to be kept there; else steps out of the region cost far more. Steps cost their squared length: many
short ones beat a long one, the walk follows a rig, and where that has ends, it comes back the way it went.
S stops; units are those of the world.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.sparse.csgraph import connected_components, shortest_path

from airgs_codec.package.region import Vector, departure, keep_inside, leaving, place_view, view_from
from airgs_codec.package.tables import Place, Region
from airgs_codec.scene.camera import Camera

KEPT_DISTANCE = 0.5  # of the distance from the focus, on the way from a stop to its neighbour
GAP_COST = 1000.0  # of a squared unit between the reaches of two stops; others cost 1
SPEED = 0.25  # of the distance from the focus, a second
TURNING = 15.0  # degrees a second
SIGHTS = 6  # places that a walk has to come by
LEAST_SECONDS = 1.0  # from a stop to the next
CIRCLE = 0.5  # of the reach: radius of the walk where there is only one stop
CORNERS = 8  # of that circle
TINY = np.finfo(np.float64).tiny  # a step of length 0 would count as none
SAMPLES = 9  # of a way between two stops, looked at to keep it inside
SLOWER = (0.5, 0.5, 0.5, 0.0)  # factors on the speed at stops, one after another, to keep a way inside; 0: a corner

LENS = ("width", "height", "fx", "fy", "cx", "cy", "near")  # what cameras have of their own, fields of Camera


@dataclass(frozen=True, slots=True)
class Path:
    """A walk that goes on as often as need be."""

    region: Region
    tour: list[Place]
    line: _Line | None  # None: there is one place to stand at
    lens: dict[str, Any]  # of the cameras, where it is not the region's
    unreached: int  # stops that it does not come by: the way there leads through the content, or out of the region
    kept: bool = False  # inside of the region, all the time

    def cameras(self, times: NDArray[np.float64]) -> list[Camera]:
        """The view at each of some seconds."""
        if self.line is None:
            cameras = [place_view(self.region, self.tour[0], f"path{i:04d}") for i in range(len(times))]
        else:
            positions, foci, ups = self.line.at(times)
            if self.kept:
                positions, foci = keep_inside(self.region, positions, foci)
            rows = zip(positions, foci, ups, strict=True)
            cameras = [view_from(self.region, *row, f"path{i:04d}") for i, row in enumerate(rows)]
        return [replace(camera, **self.lens) for camera in cameras] if self.lens else cameras


def path_of_region(region: Region, kept: bool = True) -> Path:
    """A path through the places of a region, with its picture size and field of view.

    The walk is a loop that goes on as often as need be, by way of SIGHTS places and those between them. Places that
    look alike, such as those of a rig that is small beside the reach, are one stop; where there is only one, the walk
    is a circle about it. Of a region in parts the walk keeps to the one with most sights, or else the first; without
    `kept`, it crosses over, and is outside on the way.
    """
    stops = _thinned(region)
    return replace(_path(region, stops, _sights(stops), kept), kept=kept)


def path_by_cameras(region: Region, cameras: Sequence[Camera]) -> Path:
    """The same by way of `cameras`, with the lens of the first; it may pass by places of the region in between."""
    stops = [_stop(region, camera) for camera in cameras]
    path = _path(region, stops + _thinned(region), range(len(stops)), False)
    return replace(path, lens={name: getattr(cameras[0], name) for name in LENS})


def _stop(region: Region, camera: Camera) -> Place:
    """A camera as a place; its focus is as far away as that of the nearest place."""
    nearest = min(region.places, key=lambda place: float(np.linalg.norm(camera.position - np.array(place.position))))
    rotation = camera.world_to_camera[:3, :3]
    focus = camera.position + float(np.linalg.norm(_offset(nearest))) * rotation[2]
    return Place(camera.position.tolist(), focus.tolist(), (-rotation[1]).tolist(), 0.0)


def _offset(place: Place) -> Vector:
    """(3,) from the focus to the position."""
    return np.array(place.position) - np.array(place.focus)


def _thinned(region: Region) -> list[Place]:
    """The places in their order, without those whose view another one allows anyway."""
    positions = np.array([place.position for place in region.places])
    middle = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    chosen: list[int] = []
    for i in np.argsort(middle, kind="stable").tolist():
        view = place_view(region, region.places[i])
        if not chosen or not departure(replace(region, places=[region.places[k] for k in chosen]), view).inside:
            chosen.append(i)
    return [region.places[i] for i in sorted(chosen)]


def _sights(stops: Sequence[Place]) -> list[int]:
    """At most SIGHTS stops, each as far as possible from those before it, in their order."""
    points = _points(stops)
    chosen = [0]
    while len(chosen) < min(SIGHTS, len(stops)):
        nearest = np.square(points[:, None] - points[chosen]).sum(axis=(2, 3)).min(axis=1)
        chosen.append(int(np.argmax(nearest)))
    return sorted(chosen)


def _points(stops: Sequence[Place]) -> NDArray[np.float64]:
    """(S, 2, 3) positions and foci."""
    return np.array([[stop.position, stop.focus] for stop in stops])


def _path(region: Region, stops: Sequence[Place], visited: Sequence[int], kept: bool) -> Path:
    """A path by the stops `visited`, which may use the others on its way; `kept`: by ways inside of the region."""
    costs, before = _ways(stops, region if kept else None)
    reached = _together(costs, visited)
    tour = [stops[i] for i in _expanded(_tour(costs, reached), before)]
    if len(tour) == 1:
        tour = _circle(region, tour[0])
    line = _Line.through(tour).kept_inside(region) if len(tour) > 1 else None
    return Path(region, tour, line, {}, len(visited) - len(reached))


def _ways(stops: Sequence[Place], region: Region | None) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """(S, S) the cost of the best way from a stop to another, infinite where there is none; (S, S) the last stop
    before its end. `region`: that ways stay in.
    """
    reaches = np.array([stop.reach for stop in stops])
    points = _points(stops)
    lengths = np.linalg.norm(points[:, None] - points[None], axis=3)  # (S, S, 2)
    gaps = np.maximum(lengths[..., 0] - reaches[:, None] - reaches[None], 0)
    steps = np.maximum(np.square(lengths).sum(axis=2) + GAP_COST * gaps**2, TINY)
    for (i, a), (j, b) in itertools.product(enumerate(stops), repeat=2):
        if i == j or not _keeps_off(a, b) or (region and not _are_inside(region, *_between(points[i], points[j]))):
            steps[i, j] = 0.0  # no step
    costs, before = shortest_path(steps, return_predecessors=True)
    return costs, before


def _keeps_off(a: Place, b: Place) -> bool:
    """Whether the straight way between two stops keeps its distance from the focus."""
    start, end = _offset(a), _offset(b)
    step = end - start
    squared = float(step @ step)
    share = float(np.clip(-(start @ step) / squared, 0, 1)) if squared > 0 else 0.0
    least = float(np.linalg.norm(start + share * step))
    return least >= KEPT_DISTANCE * min(float(np.linalg.norm(start)), float(np.linalg.norm(end)))


def _between(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, SAMPLES, 3) positions and foci on the straight way from a stop to another, each (2, 3)."""
    share = np.linspace(0, 1, SAMPLES)[:, None]
    return np.asarray((1 - share) * start[:, None] + share * end[:, None])


def _are_inside(region: Region, positions: Vector, foci: Vector) -> bool:
    """Whether viewers at `positions` (C, 3) who look at `foci` (C, 3) are all inside of a region."""
    ahead = foci - positions
    distance, degrees, _ = leaving(region, positions, ahead / np.linalg.norm(ahead, axis=1, keepdims=True))
    return not (distance.any() or degrees.any())


def _together(costs: NDArray[np.float64], visited: Sequence[int]) -> list[int]:
    """Most of the stops that can be walked to from each other, in their order."""
    labels = connected_components(np.isfinite(costs), directed=False)[1][list(visited)]
    most = np.bincount(labels).argmax()
    return [stop for stop, label in zip(visited, labels, strict=True) if label == most]


def _tour(costs: NDArray[np.float64], stops: Sequence[int]) -> list[int]:
    """A short round trip: always on to the nearest, then parts of it turned round as long as that makes it shorter."""
    tour, left = [stops[0]], list(stops[1:])
    while left:
        tour.append(left.pop(int(np.argmin(costs[tour[-1], left]))))
    while better := _turned_round(costs, tour):
        tour = better
    return tour


def _turned_round(costs: NDArray[np.float64], tour: Sequence[int]) -> list[int] | None:
    """The tour with one part turned round so that it is shorter (2-opt; Croes 1958); None when there is no such part.

    1e-9: what rounding makes shorter would go on for ever.
    """
    for i, j in itertools.combinations(range(len(tour)), 2):
        a, b, c, d = tour[i], tour[i + 1], tour[j], tour[(j + 1) % len(tour)]
        if costs[a, c] + costs[b, d] < (1 - 1e-9) * (costs[a, b] + costs[c, d]):
            return [*tour[: i + 1], *tour[i + 1 : j + 1][::-1], *tour[j + 1 :]]
    return None


def _expanded(tour: Sequence[int], before: NDArray[np.intp]) -> list[int]:
    """The round trip with all stops that its ways lead by."""
    out: list[int] = []
    for start, end in zip(tour, [*tour[1:], tour[0]], strict=True):
        way = [end]
        while way[-1] != start:
            way.append(int(before[start, way[-1]]))
        out += way[:0:-1] if len(tour) > 1 else way
    return out


def _circle(region: Region, place: Place) -> list[Place]:
    """Stops on a circle about a place, across its view, that look at its focus."""
    radius = CIRCLE * place.reach
    if radius == 0:
        return [place]
    axes = place_view(region, place).world_to_camera[:2, :3]
    angles = 2 * np.pi * np.arange(CORNERS) / CORNERS
    ring = np.array(place.position) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1) @ axes
    return [replace(place, position=position.tolist(), reach=0.0) for position in ring]


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """A closed line through S stops: a cubic Hermite spline of position, focus and up over seconds."""

    times: NDArray[np.float64]  # (S + 1,) ascending from 0; the last is back at the first stop
    values: NDArray[np.float64]  # (S, 9)
    speeds: NDArray[np.float64]  # (S, 9) a second

    @staticmethod
    def through(tour: Sequence[Place]) -> _Line:
        """At a stop the line goes the way from the stop before it to the stop after it."""
        values = np.array([[*s.position, *s.focus, *(np.array(s.up) / np.linalg.norm(s.up))] for s in tour])
        seconds = np.array([_seconds(a, b) for a, b in zip(tour, [*tour[1:], tour[0]], strict=True)])
        speeds = np.roll(values, -1, axis=0) - np.roll(values, 1, axis=0)
        speeds /= (seconds + np.roll(seconds, 1))[:, None]
        return _Line(np.concatenate([[0.0], np.cumsum(seconds)]), values, speeds)

    def kept_inside(self, region: Region) -> _Line:
        """The line with lower speeds at the stops of ways that leave the region where the straight way does not."""
        count = len(self.values)
        straight = replace(self, speeds=np.zeros_like(self.speeds))
        ways = [way for way in range(count) if straight._is_inside(region, way)]
        line = self
        for factor in SLOWER:
            bent = {way for way in ways if not line._is_inside(region, way)}
            slow = [stop in bent or (stop - 1) % count in bent for stop in range(count)]
            line = replace(line, speeds=np.where(slow, factor, 1.0)[:, None] * line.speeds)
        return line

    def _is_inside(self, region: Region, way: int) -> bool:
        """Whether all of the way from a stop to the next is inside of a region."""
        positions, foci, _ = self.at(np.linspace(self.times[way], self.times[way + 1], SAMPLES))
        return _are_inside(region, positions, foci)

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, T, 3) position, focus and up at each of some seconds from the first stop on."""
        values, speeds = (np.vstack([rows, rows[:1]]) for rows in (self.values, self.speeds))
        rows = CubicHermiteSpline(self.times, values, speeds)(times % self.times[-1])
        return np.asarray(rows.reshape(-1, 3, 3).swapaxes(0, 1))


def _seconds(a: Place, b: Place) -> float:
    """Time from a stop to the next."""
    start, end = _offset(a), _offset(b)
    lengths = float(np.linalg.norm(start)), float(np.linalg.norm(end))
    moved = float(np.linalg.norm(np.array(b.position) - np.array(a.position)))
    turned = float(np.degrees(np.arccos(np.clip(start / lengths[0] @ end / lengths[1], -1, 1))))
    return max(moved / (SPEED * min(lengths)), turned / TURNING, LEAST_SECONDS)
