"""A plain walk of a viewer: from each place of a region on to the nearest one that is left, and back the same way.

Between two places he turns about what he looks at, so that he never walks through it. S stops, T moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec.package.region import place_view, view_from
from airgs_codec.package.tables import Place, Region
from airgs_codec.scene.camera import Camera

STEP_S = 2.0  # from a stop to the next
CIRCLE, CORNERS = 0.5, 8  # where there is but one place: the radius of a circle about it, in reaches, and its stops


@dataclass(frozen=True, slots=True)
class Path:
    """A walk that goes on as often as need be."""

    region: Region
    stops: Sequence[Place]  # at least two; the last is the first again

    def cameras(self, times: NDArray[np.float64]) -> list[Camera]:
        """The view at each of (T,) seconds."""
        whole, share = np.divmod(times / STEP_S % (len(self.stops) - 1), 1)
        at, numbers = whole + share**2 * (3 - 2 * share), np.arange(len(self.stops))  # slower near the stops
        positions, foci, ups = (np.array([getattr(s, of) for s in self.stops]) for of in ("position", "focus", "up"))
        axes = [place_view(self.region, stop).world_to_camera[:3, :3] for stop in self.stops]
        ups /= np.linalg.norm(ups, axis=1, keepdims=True)
        rows = np.column_stack([foci, ups, np.linalg.norm(positions - foci, axis=1)])
        between = np.column_stack([np.interp(at, numbers, column) for column in rows.T])
        ahead = Slerp(numbers, Rotation.from_matrix(axes))(at).as_matrix()[:, 2]
        views = zip(between[:, :3] - between[:, 6:] * ahead, between[:, :3], between[:, 3:6], strict=True)
        return [view_from(self.region, *view, f"path{i:04d}") for i, view in enumerate(views)]


def path_of_region(region: Region) -> Path:
    """The walk by all places of a region, from the first on; a circle about the place where there is but one."""
    tour, left = [region.places[0]], list(region.places[1:])
    while left:
        last = np.array([*tour[-1].position, *tour[-1].focus])
        tour.append(left.pop(int(np.argmin([np.linalg.norm(last - [*p.position, *p.focus]) for p in left]))))
    if len(tour) > 1:
        return Path(region, [*tour, *tour[-2::-1]])
    right, down = place_view(region, tour[0]).world_to_camera[:2, :3] * CIRCLE * tour[0].reach
    turns = 2 * np.pi * np.arange(CORNERS + 1) / CORNERS
    ring = tour[0].position + np.cos(turns)[:, None] * right + np.sin(turns)[:, None] * down
    return Path(region, [replace(tour[0], position=position.tolist()) for position in ring])
