"""Where a package may be looked at from: views drawn from its region, whether a viewer is still inside, and in words.

A region is a union of balls, one about each of P places, with a direction to look in at each of them (`tables.Region`).
Cameras are as OpenCV has them; positions are in world units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import Header, Place, Region
from airgs_codec.package.world import up_of
from airgs_codec.scene.camera import BLACK, Background, Camera, look_at

SLIGHTLY_DOWN, GIVE_OR_TAKE = 15.0, 10.0  # degrees; a scene is seen best by most people who look down so much
AGREEMENT = 0.1  # directions whose mean is shorter do not agree on where up is
FORGIVEN_DEGREES = 1e-4  # beyond the turn
FORGIVEN_SHARE = 1e-9  # of 1 + the largest coordinate: a camera's position comes from its matrix, which rounds
LEVELLING = 100  # steps to what is upright: with more, rounding would speak where places say nothing
DECIDING, MEASURING, CHECKING = 0, 1, 2  # seeds of draws: for an encoder, for its tables, for whoever checks them
Vector = NDArray[np.float64]


def place_view(region: Region, place: Place, name: str = "place") -> Camera:
    """What a viewer sees who stands at a place and looks where it says."""
    return view_from(region, np.array(place.position), np.array(place.focus), np.array(place.up), name)


def levelled(m: Header) -> Region:
    """The region of a package as players take it: where the package tells which way is up, so it is at every place."""
    if m.world is None:
        return m.region
    up = up_of(m.world).tolist()
    return replace(m.region, places=[replace(place, up=up) for place in m.region.places])


def upright(region: Region) -> Vector:
    """(3,) where up is for all of a region, of length 1.

    It is the mean of its places' (where they do not agree, that of the first), levelled: the sides of pictures are at
    right angles to it.
    """
    ups = np.array([place.up for place in region.places])
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    sides = np.cross([_ahead(place) for place in region.places], ups)
    mean: Vector = ups.mean(axis=0)
    length = np.linalg.norm(mean)
    up = mean / length if length > AGREEMENT else ups[0]
    for _ in range(LEVELLING):
        up = up - sides.T @ (sides @ up) / len(sides)
        up /= np.linalg.norm(up)
    return up


def first_place(region: Region) -> Place:
    """Where a viewer begins: the first place, or, where nobody chose them, the first that looks down slightly."""
    if region.source in ("cameras", "file"):
        return region.places[0]
    up = upright(region)
    down = [float(np.degrees(np.arcsin(np.clip(-_ahead(place) @ up, -1, 1)))) for place in region.places]
    off = [max(GIVE_OR_TAKE, abs(degrees - SLIGHTLY_DOWN)) for degrees in down]
    return region.places[off.index(min(off))]


def _ahead(place: Place) -> Vector:
    """The direction (3,) of length 1 in which a viewer at a place looks."""
    ahead = np.array(place.focus, np.float64) - place.position
    return ahead / np.linalg.norm(ahead)


def view_from(region: Region, position: Vector, target: Vector, up: Vector, name: str) -> Camera:
    """A camera of the region's picture size and field of view at `position` (3,), looking at `target` (3,)."""
    square = look_at(position, target, up, size=region.height, fov_y=float(np.radians(region.fov_y)), name=name)
    behind = background_of(region)
    return replace(square, width=region.width, cx=region.width / 2, near=region.near, background=behind)


def background_of(region: Region) -> Background:
    """The colour behind the scene."""
    if region.background is None:
        return BLACK
    r, g, b = region.background
    return r, g, b


def before_background(region: Region, cameras: Sequence[Camera]) -> list[Camera]:
    """The cameras, which see the background of a region behind the scene."""
    return [replace(camera, background=background_of(region)) for camera in cameras]


def with_background(region: Region, background: Background) -> Region:
    """The region before a colour, which stands in it unless it is black."""
    return replace(region, background=None if background == BLACK else list(background))


def draw_views(region: Region, count: int, seed: int) -> list[Camera]:
    """`count` views drawn from a region, the same ones for the same seed.

    Places take turns in random order. About each, the distance to the place is drawn evenly between 0 and its reach,
    the direction to it evenly over the sphere, and the view axis evenly over the disk of directions that are at most
    `region.turn` degrees off the focus: viewers are more often near the places than at the rim.
    """
    rng = np.random.default_rng(seed)
    order: list[int] = []
    while len(order) < count:
        order += [int(i) for i in rng.permutation(len(region.places))]
    return [_draw(region, region.places[i], rng, f"draw{number:03d}") for number, i in enumerate(order[:count])]


def _draw(region: Region, place: Place, rng: np.random.Generator, name: str) -> Camera:
    step = rng.normal(size=3)
    position = np.array(place.position) + step / np.linalg.norm(step) * place.reach * rng.uniform()
    ahead = np.array(place.focus) - position
    distance = float(np.linalg.norm(ahead))
    side = np.cross(ahead, rng.normal(size=3))
    side *= distance / max(float(np.linalg.norm(side)), np.finfo(float).tiny)  # tiny: 0 / 0 where both are parallel
    angle = np.radians(region.turn) * np.sqrt(rng.uniform())
    target = position + np.cos(angle) * ahead + np.sin(angle) * side
    return view_from(region, position, target, np.array(place.up), name)


@dataclass(frozen=True, slots=True)
class Departure:
    """How far a viewer is outside of a region; both are 0 inside."""

    distance: float  # world units beyond the reach of the nearest place
    degrees: float  # by which he looks further away from its focus than the region allows

    @property
    def inside(self) -> bool:
        """Whether the viewer is inside."""
        return self.distance == 0 and self.degrees == 0


def departure(region: Region, camera: Camera) -> Departure:
    """How far the viewer is outside, from the place for which it is least: distance first, then direction."""
    return departures(region, [camera])[0]


def departures(region: Region, cameras: Sequence[Camera]) -> list[Departure]:
    """The same for each of C cameras."""
    positions = np.array([camera.position for camera in cameras]).reshape(-1, 1, 3)
    forward = np.array([camera.world_to_camera[2, :3] for camera in cameras]).reshape(-1, 1, 3)
    centres, foci = (np.array([getattr(place, name) for place in region.places]) for name in ("position", "focus"))
    slack = FORGIVEN_SHARE * (1 + np.abs(positions).max(axis=2))
    away = np.linalg.norm(positions - centres, axis=2) - [place.reach for place in region.places]
    ahead = foci - positions
    length = np.linalg.norm(ahead, axis=2)
    cosine = (ahead * forward).sum(axis=2) / np.maximum(length, np.finfo(float).tiny)
    cosine[length <= slack] = 1.0  # at the focus every direction is towards it
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1))) - region.turn
    distance = np.where(away > slack, away, 0.0)  # (C, P)
    least = distance.min(axis=1)
    degrees[degrees <= FORGIVEN_DEGREES] = 0.0
    degrees[distance > least[:, None]] = np.inf
    return [Departure(float(d), float(a)) for d, a in zip(least, degrees.min(axis=1), strict=True)]


def distances(places: Sequence[Place]) -> Vector:
    """(P, P) world units between the positions of places."""
    positions = np.array([place.position for place in places])
    pairs: Vector = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    return pairs


ORBIT = "orbit"  # the source of a region that is a guess
SOURCES = {
    "cameras": "about the cameras of the scene",
    "found": "about places that were found by looking at the scene",
    "file": "as it was given",
    ORBIT: "on an orbit around the scene, because nobody knows from where it is meant to be seen",
}


@dataclass(frozen=True, slots=True)
class RegionSummary:
    """Figures of a region; pairs are the least and the most over its places."""

    source: str
    places: int
    reach: tuple[float, float]  # world units
    distance: tuple[float, float]  # world units from a place to what its viewer looks at
    turn: float  # degrees
    near: float  # world units
    width: int  # pixels of the views that it was judged by
    height: int
    fov_y: float  # degrees

    @staticmethod
    def of(region: Region) -> RegionSummary:
        """The figures of a region."""
        reach = [place.reach for place in region.places]
        away = [float(np.linalg.norm(np.subtract(place.position, place.focus))) for place in region.places]
        return RegionSummary(
            source=region.source,
            places=len(region.places),
            reach=(min(reach), max(reach)),
            distance=(min(away), max(away)),
            turn=region.turn,
            near=region.near,
            width=region.width,
            height=region.height,
            fov_y=region.fov_y,
        )

    @property
    def words(self) -> str:
        """Where a viewer may be."""
        places = "1 place" if self.places == 1 else f"{self.places} places"
        return (
            f"{SOURCES[self.source]}: {places} with a reach of {_span(self.reach)} units, {_span(self.distance)} units "
            f"from what is looked at; {self.turn:g}° to turn"
        )

    @property
    def views(self) -> str:
        """What a viewer's pictures are like."""
        return f"{self.width}x{self.height} pixels, {self.fov_y:.3g}° high, near plane at {self.near:g} units"


def departure_words(d: Departure) -> str:
    """How far a viewer is outside, empty where he is inside."""
    parts = [f"{d.distance:.2g} units"] * (d.distance > 0) + [f"{d.degrees:.2g}°"] * (d.degrees > 0)
    return " and ".join(parts)


def _span(values: tuple[float, float]) -> str:
    low, high = (f"{value:.3g}" for value in values)
    return low if low == high else f"{low} to {high}"
