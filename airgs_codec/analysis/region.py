"""The viewing region that cameras and a scene suggest. C cameras, P places; N rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.package.tables import MAX_PLACES, Place, Region
from airgs_codec.render import Camera, measure_contribution
from airgs_codec.scene.camera import resized, weighted_quantile
from airgs_codec.scene.gaussians import Gaussians

RIG_SHARE = 0.25  # of the largest distance between two cameras: the margin, where it is the larger one
DISTANCE_SHARE = 0.1  # of the distance to the content: the other one
MOST_SHARE = 0.25  # of that distance: no viewer walks further towards what he looks at
CLEARANCE_SHARE = 0.5  # of the distance to the nearest content that is visible: no viewer walks into it
NEAREST = 0.02  # share of what a picture shows that may lie nearer than the clearance
ONE_SIDE = 0.5  # length of the mean of the directions in which cameras look, seen from above: about 220 degrees
TURN = 5.0  # degrees that a viewer may look off the focus
LOOK_PIXELS = 128  # on the longer side, enough to see how far away the content is


class _Look(NamedTuple):
    """Distances of one camera to the scene, in world units."""

    camera: Camera
    distance: float  # to the content along the view axis, median over the picture
    clearance: float  # to the nearest content


def region_around(
    cameras: Sequence[Camera], gaussians: Gaussians, *, margin: float | None = None, source: str = "cameras"
) -> Region:
    """The region about the cameras of a scene; `gaussians` are one of its frames, finite.

    Every camera is a place, or MAX_PLACES of them that are far from each other; of the cameras of a scene the one in
    the middle is the first, where viewers begin. Its focus is as far away as the median of what it sees. A place
    reaches as far as `margin` (world units): by default a quarter of the largest distance between two cameras or a
    tenth of the median distance to the content, whichever is larger, but at most a quarter of that distance; and never
    further than half-way to the nearest content. Without a margin nobody may turn either.

    Raises ConfigError for a margin that is not 0 or more.
    """
    if margin is not None and not 0 <= margin < np.inf:
        raise ConfigError(f"margin: expected 0 or more world units, got {margin}")
    looks = [_look(camera, gaussians) for camera in _far_apart(cameras, MAX_PLACES)]
    if margin is None:
        positions = np.stack([look.camera.position for look in looks])
        rig = float(np.linalg.norm(positions[:, None] - positions[None], axis=2).max())
        distance = float(np.median([look.distance for look in looks]))
        margin = min(max(RIG_SHARE * rig, DISTANCE_SHARE * distance), MOST_SHARE * distance)
    first = looks[0].camera
    places = [_place(look, margin) for look in looks]
    return Region(
        source=source,
        width=first.width,
        height=first.height,
        fov_y=float(np.degrees(2 * np.arctan(first.height / 2 / first.fy))),
        near=min(look.camera.near for look in looks),
        turn=TURN if margin > 0 else 0.0,
        places=_middle_first(places) if source == "cameras" else places,
    )


def _middle_first(places: Sequence[Place]) -> list[Place]:
    """The places, first the one from which the others are nearest, with what they look at.

    Those all round a scene have no middle, but for one above it that nobody would begin at: they stay as they were.
    """
    ends = np.array([[place.position, place.focus] for place in places])
    up, ahead = np.mean([place.up for place in places], axis=0), ends[:, 1] - ends[:, 0]
    level = np.cross(up, np.cross(ahead, up))
    lengths = np.maximum(np.linalg.norm(level, axis=1, keepdims=True), np.finfo(np.float64).tiny)  # straight down: 0
    if np.linalg.norm(np.mean(level / lengths, axis=0)) < ONE_SIDE:
        return list(places)
    sums = [float(np.linalg.norm(ends - one, axis=2).sum()) for one in ends]
    middle = places[int(np.argmin(sums))]
    return [middle, *(place for place in places if place is not middle)]


def _place(look: _Look, margin: float) -> Place:
    rotation, position = look.camera.world_to_camera[:3, :3], look.camera.position
    focus = position + look.distance * rotation[2]
    reach = min(margin, CLEARANCE_SHARE * look.clearance)
    ends = _rounded(position, look.distance), _rounded(focus, look.distance)
    return Place(*ends, _rounded(-rotation[1], 1.0), float(f"{reach:.7g}"))


def _rounded(vector: NDArray[np.float64], size: float) -> list[float]:
    """To a ten-millionth of `size`: nobody stands more exactly, and every viewer fetches them."""
    return [round(float(v), 7 - int(np.floor(np.log10(size)))) for v in vector]


def _look(camera: Camera, g: Gaussians) -> _Look:
    """Distances to what a camera sees, weighed by what each Gaussian gives to the picture."""
    small = resized(camera, LOOK_PIXELS / max(camera.width, camera.height))
    weight = measure_contribution(g, small).total
    offsets = g.means.astype(np.float64) - camera.position
    if not weight.any():  # an empty picture: all of the scene counts
        weight = np.ones(len(g))
    depth = np.abs(offsets @ camera.world_to_camera[2, :3])
    distance = max(weighted_quantile(depth, weight, 0.5), camera.near)  # near: of 0 the focus would have no direction
    return _Look(camera, distance, weighted_quantile(np.linalg.norm(offsets, axis=1), weight, NEAREST))


def _far_apart(cameras: Sequence[Camera], most: int) -> list[Camera]:
    """At most so many cameras, each as far as possible from those before it, in the order in which they were given."""
    positions = np.stack([camera.position for camera in cameras])
    chosen: list[int] = []
    nearest = np.full(len(cameras), np.inf)
    for _ in range(min(most, len(cameras))):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
        nearest[chosen] = -1  # once each, wherever the others stand
    return [cameras[i] for i in sorted(chosen)]
