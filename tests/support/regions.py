"""Small viewing regions, and encodes that look at little."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from tests.faces import FORGIVEN_DEGREES, FORGIVEN_SHARE, Camera, EncodeSettings, Place, Region


def place(x: float, *, reach: float = 0.5) -> Place:
    """At (x, 0, -4), looking along +z at what is four units away, with y down."""
    return Place([x, 0.0, -4.0], [x, 0.0, 0.0], [0.0, -1.0, 0.0], reach)


def region(*places: Place, turn: float = 10.0, source: str = "cameras") -> Region:
    """Pictures of 32 x 24 pixels, 50 degrees high, from these places; from the one in the middle if none are given."""
    return Region(source, 32, 24, 50.0, 0.01, turn, list(places) or [place(0.0)])


def region_json(region: Region) -> dict[str, Any]:
    """The region as a file of `--region` has it: fields that may be missing are, where they are None."""
    given = {name: value for name, value in asdict(region).items() if value is not None}
    return given | {"places": [{name: v for name, v in p.items() if v is not None} for p in given["places"]]}


def arc(degrees: float, count: int, reach: float, radius: float = 3.0) -> Region:
    """Places on a part of a circle about the origin, which they look at."""
    turns = np.radians(np.linspace(0, degrees, count))
    return region(
        *[Place([radius * np.cos(t), 0.0, radius * np.sin(t)], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], reach) for t in turns]
    )


def row(count: int, reach: float) -> Region:
    """Places one unit apart that look the same way, at something ten units away."""
    return region(*[Place([float(i), 0.0, 0.0], [float(i), 0.0, 10.0], [0.0, 1.0, 0.0], reach) for i in range(count)])


def departure(region: dict[str, Any], position: Sequence[float], forward: Sequence[float]) -> tuple[float, float]:
    found, turn = [], region["turn"]
    for p in region["places"]:
        distance = max(0.0, math.dist(position, p["position"]) - p["reach"])
        ahead = [f - x for f, x in zip(p["focus"], position, strict=True)]
        length = math.hypot(*ahead)
        cosine = math.fsum(a * f for a, f in zip(ahead, forward, strict=True)) / length if length else 1.0
        found.append((distance, max(0.0, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))) - turn)))
    return min(found)


def is_inside(region: Region, camera: Camera) -> bool:
    """Whether a camera is inside of a region, by the definition that the vectors of players are made by."""
    distance, degrees = departure(asdict(region), camera.position.tolist(), camera.world_to_camera[2, :3].tolist())
    size = max(np.abs(camera.position).max(), *(np.abs(np.subtract(p.focus, p.position)).max() for p in region.places))
    return distance <= FORGIVEN_SHARE * size and degrees <= FORGIVEN_DEGREES


# For tests of what becomes of packages: two small pictures of a group decide, and nothing is left out for lack of more.
QUICK = EncodeSettings(
    calibrate="none", preset="veryfast", measure_pictures=0, decide_pictures=2, keep_all=True, region=region()
)
