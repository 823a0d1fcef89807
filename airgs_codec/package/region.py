"""Where a package may be looked at from, which way is up, and how long a unit is.

A region is a union of balls, one about each of P places, with a direction to look in at each (`tables.Region`). Cameras
are as OpenCV has them; positions are in the scene's own coordinates. Its `World` tells players where it stands in a
right-handed world with y up: p in the scene is at A p + b there, with A a rotation times a scale and (A | b) the three
rows of the transform. The second row says which way is up, the scale how long a unit is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from airgs_codec.errors import ConfigError
from airgs_codec.package.parse import LEAST_SCALE, MOST_SCALE, fault_of
from airgs_codec.package.tables import Place, Region, World
from airgs_codec.places.whole import expect_plain
from airgs_codec.scene.camera import BLACK, Background, Camera, look_at
from airgs_codec.scene.formats.form import Axes
from airgs_codec.scene.frames import Origin
from airgs_codec.scene.gaussians import Doubles

AGREEMENT = 0.1  # directions whose mean is shorter do not agree on where up is
FORGIVEN_DEGREES = 1e-4  # beyond the turn, by which players let viewers look further aside
FORGIVEN_SHARE = 1e-9  # of how far the focus is, or a coordinate, beyond the reach: positions from matrices round
LEVELLING = 100  # steps to what is upright: with more, rounding would speak where places say nothing
DECIDING, MEASURING, CHECKING = 0, 1, 2  # seeds of draws: for an encoder, for its tables, for whoever checks them
AXES = {sign + name: tuple(int(f"{sign}1") * (name == axis) for axis in "xyz") for name in "xyz" for sign in ("", "-")}


def place_view(region: Region, place: Place, name: str = "place") -> Camera:
    return view_from(region, np.array(place.position), np.array(place.focus), np.array(place.up), name)


def first_views(region: Region, world: World | None) -> tuple[Camera, ...]:
    """Return what viewers see from each place of the region of a package; they begin at the first."""
    upright = levelled(region, world)
    return tuple(place_view(upright, place, f"place{i}") for i, place in enumerate(upright.places))


def opening_view(region: Region, world: World | None) -> Camera:
    """Return what players show first where there is room at the sides: the first place, at least 16 to 9."""
    level = levelled(region, world)
    camera = place_view(level, replace(level.places[0], up=upright(level).tolist()))
    width = max(camera.width, round(camera.height * 16 / 9))
    return replace(camera, width=width, cx=width / 2)


def levelled(region: Region, world: World | None) -> Region:
    """Return the region of a package as players take it: with the up of its world at every place."""
    places = [replace(place, up=up_of(world).tolist()) for place in region.places if world]
    return replace(region, places=places) if world else region


def upright(region: Region) -> Doubles:
    """Return (3,) up for all of a region, of length 1: the mean of its places' (of the first, where they do not agree).

    It is levelled: the sides of pictures are at right angles to it.
    """
    ups = np.array([place.up for place in region.places])
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    ahead = [np.array(place.focus, np.float64) - place.position for place in region.places]
    sides = np.cross([direction / np.linalg.norm(direction) for direction in ahead], ups)
    mean: Doubles = ups.mean(axis=0)
    up = mean / length if (length := np.linalg.norm(mean)) > AGREEMENT else ups[0]
    for _ in range(LEVELLING):
        up = up - sides.T @ (sides @ up) / len(sides)
        up /= np.linalg.norm(up)
    return up


def view_from(region: Region, position: Doubles, target: Doubles, up: Doubles, name: str) -> Camera:
    square = look_at(position, target, up, size=region.height, fov_y=float(np.radians(region.fov_y)), name=name)
    behind = background_of(region)
    return replace(square, width=region.width, cx=region.width / 2, near=region.near, background=behind)


def background_of(region: Region) -> Background:
    r, g, b = region.background or BLACK
    return r, g, b


def before_background(region: Region, cameras: Sequence[Camera]) -> list[Camera]:
    return [replace(camera, background=background_of(region)) for camera in cameras]


def with_background(region: Region, background: Background) -> Region:
    return replace(region, background=None if background == BLACK else list(background))


def from_origin(region: Region, origin: ArrayLike) -> Region:
    ends = [np.subtract([place.position, place.focus], origin).tolist() for place in region.places]
    places = [replace(place, position=a, focus=b) for place, (a, b) in zip(region.places, ends, strict=True)]
    return replace(region, places=places)


def draw_views(region: Region, count: int, seed: int) -> list[Camera]:
    """Draw `count` views from a region, the same ones for the same seed.

    Places take turns in random order. About each, the distance to the place is drawn evenly between 0 and its reach,
    the direction to it evenly over the sphere, and the view axis evenly over the disk of directions that are at most
    `region.turn` degrees off the focus: viewers are more often near the places than at the rim.
    """
    rng, places = np.random.default_rng(seed), len(region.places)
    order = [place for _ in range(-(-count // places)) for place in rng.permutation(places).tolist()][:count]
    return [_draw(region, region.places[i], rng, f"draw{number:03d}") for number, i in enumerate(order)]


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


GUESSED = ("found", "orbit")  # the sources of a region where no camera was given
SOURCES = {
    "cameras": "about the cameras of the scene",
    "found": "about places that were found by looking at the scene",
    "file": "as it was given",
    "orbit": "on an orbit around the scene, because nobody knows from where it is meant to be seen",
}


def region_figures(region: Region) -> dict[str, Any]:
    """Return figures of a region, in world units and degrees; pairs are the least and the most over its places."""
    reach = [place.reach for place in region.places]
    away = [float(np.linalg.norm(np.subtract(place.position, place.focus))) for place in region.places]
    spans = {"reach": (min(reach), max(reach)), "distance": (min(away), max(away))}
    shared = {name: getattr(region, name) for name in ("turn", "near", "width", "height", "fov_y")}
    return {"source": region.source, "places": len(reach), **spans, **shared}


def region_words(region: Region) -> str:
    figures, count = region_figures(region), len(region.places)
    ends = ([f"{value:.3g}" for value in figures[name]] for name in ("reach", "distance"))
    reach, distance = (" to ".join(dict.fromkeys(pair)) for pair in ends)
    about = f"{SOURCES[region.source]}: {count} place{'s' * (count != 1)} with a reach of {reach} units"
    return f"{about}, {distance} units from what is looked at; {region.turn:g}° to turn"


def world_from(up: Sequence[float], metres: float | None = None) -> World:
    """Return the world of a scene of which `up` (3,) points up and a unit is `metres` long; None: unknown.

    The turn is the shortest one, after half a turn about x where up is in the lower half space: so y down, z up and
    y up become (x, -y, -z), (x, z, -y) and (x, y, z). Raises ConfigError.
    """
    direction, length = np.array(up, np.float64), math.hypot(*up)
    if not (0 < length < np.inf):
        raise ConfigError(f"up: expected a direction, got {list(up)}")
    direction /= length
    first = np.diag([1.0, -1.0, -1.0]) if direction[1] < 0 else np.eye(3)
    x, y, z = first @ direction
    cross = np.array([[0, -x, 0], [x, 0, z], [0, -z, 0]])  # Rodrigues: the product of (x, y, z) and the y axis
    turn = (np.eye(3) + cross + cross @ cross / (1 + y)) @ first
    scale = 1.0 if metres is None else metres
    if not LEAST_SCALE <= scale <= MOST_SCALE:
        raise ConfigError(f"scale: expected {LEAST_SCALE:g} to {MOST_SCALE:g} metres a unit, got {scale:g}")
    rows = np.hstack([scale * turn, np.zeros((3, 1))]) + 0.0  # no -0
    return World(rows.ravel().tolist(), metres is not None)


def world_at(world: World, origin: Origin) -> World:
    """Return a world for coordinates from an origin; a transform that shifts nothing stays as it is."""
    rows = np.array(world.transform).reshape(3, 4)
    if rows[:, 3].any():
        rows[:, 3] += rows[:, :3] @ origin
    return replace(world, transform=rows.ravel().tolist())


def up_of(world: World) -> Doubles:
    """Return (3,) up in the coordinates of the scene, of length 1."""
    row = np.array(world.transform[4:7])
    return np.asarray(row / np.linalg.norm(row))


def unit_of(world: World) -> float | None:
    """Return the metres that a unit of the scene is long; None: unknown."""
    return float(np.linalg.norm(world.transform[4:7])) if world.metric else None


def parse_up(text: str) -> tuple[float, ...]:
    """Read a direction from text: an axis such as y or -y, or X,Y,Z. Raises ConfigError."""
    if text in AXES:
        return AXES[text]
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"expected {', '.join(AXES)} or X,Y,Z that points up, got {text!r}") from error
    return x, y, z


def read_world(path: Path) -> World:
    """Read a transform to a world with y up in metres: 3x4 or 4x4 numbers row by row, as text or JSON.

    Raises ConfigError for anything else.
    """
    try:
        expect_plain(path)
        text = path.read_text(encoding="utf-8-sig")
        values = np.array(json.loads(text) if text.lstrip()[:1] == "[" else text.split(), np.float64).ravel()
    except OSError as error:
        raise ConfigError(f"{path}: cannot read a transform: {error.strerror}") from error
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise ConfigError(f"{path}: expected 12 or 16 numbers, row by row: {str(error)[:120]}") from error
    rows, last = values[:12].tolist(), values[12:].tolist()
    if len(values) not in (12, 16):
        raise ConfigError(f"{path}: expected 12 or 16 numbers, row by row, got {len(values)} numbers")
    if fault := f"expected a last row of 0 0 0 1, got {last}" if last not in ([], [0, 0, 0, 1]) else fault_of(rows):
        raise ConfigError(f"{path}: {fault}")
    return World(rows, metric=True)


def world_words(world: World | None) -> str:
    if world is None:
        return "up: unknown, players take that of the views of the region; units: unknown"
    up = ", ".join(f"{number:.6g}" for number in up_of(world).round(6) + 0.0)
    unit = unit_of(world)
    return f"up: ({up}); units: " + ("unknown" if unit is None else f"one is {unit:.6g} m")


def misread(world: World | None, form: str, axes: Axes | None) -> list[str]:
    """Return a sentence where the specification of a format and a package differ about up and units."""
    meant, said = axes and world_words(world_from(axes.up, axes.metres)), world_words(world)
    differ = meant is not None and meant != said
    return [f"coordinates stay: readers of {form} take {meant}; here it is {said}"] if differ else []
