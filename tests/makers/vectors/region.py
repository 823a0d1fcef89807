"""Viewers inside and outside of a viewing region (FORMAT.md, section 8)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tests.makers.vectors.text import Table, plain

Vector = tuple[float, float, float]
Place = dict[str, Any]


def place(position: Vector, focus: Vector, reach: float) -> Place:
    return {"position": position, "focus": focus, "up": (0.0, -1.0, 0.0), "reach": reach}


def axis(sideways: float, upwards: float = 0.0) -> Vector:
    a, b = math.radians(sideways), math.radians(upwards)
    return math.sin(a) * math.cos(b), -math.sin(b), math.cos(a) * math.cos(b)


AHEAD = axis(0)
ONE = [place((0.0, 0.0, -4.0), (0.0, 0.0, 0.0), 0.5)]
TWO = [place((0.0, 0.0, 0.0), (0.0, 0.0, 10.0), 1.0), place((1.5, 0.0, 0.0), (11.5, 0.0, 0.0), 1.0)]
POINT = [place((1.0, 2.0, 3.0), (1.0, 2.0, 7.0), 0.0)]
VIEWS: list[tuple[str, list[Place], float, list[tuple[Vector, Vector]]]] = [
    (
        "one ball",
        ONE,
        10.0,
        [
            *(((0.0, 0.0, -4.0), axis(a)) for a in (0, 9.5, 10.5, -60, 180)),
            *(((x, 0.0, -4.0), AHEAD) for x in (0.25, 0.4375, 0.5625, 3.0)),
            *(((0.0, 0.25, z), axis(3, 4)) for z in (-4.25, -3.0, 2.0)),
        ],
    ),
    (
        "two balls that overlap and look different ways",
        TWO,
        20.0,
        [
            *(((0.75, 0.0, 0.0), axis(a)) for a in (0, 45, 90, -90)),
            *(((x, 0.0, 0.0), axis(a)) for x in (-0.75, 2.25, -3.0, 5.0) for a in (0, 90)),
        ],
    ),
    ("a point", POINT, 0.0, [((1.0, 2.0, 3.0), AHEAD), ((1.0, 2.0, 3.0), axis(1)), ((1.0, 2.5, 3.0), AHEAD)]),
    ("any direction", ONE, 180.0, [((0.0, 0.0, -4.0), axis(180)), ((0.0, 0.0, -6.0), axis(90))]),
    (
        "a focus inside the ball, and a viewer at it",
        [place((0.0, 0.0, 0.0), (0.0, 0.0, 0.25), 1.0)],
        5.0,
        [((0.0, 0.0, 0.25), axis(123)), ((0.0, 0.0, 0.5), AHEAD), ((0.0, 0.0, 0.5), axis(180))],
    ),
]


def departure(places: Sequence[Place], turn: float, position: Vector, forward: Vector) -> tuple[float, float]:
    found = []
    for p in places:
        distance = max(0.0, math.dist(position, p["position"]) - p["reach"])
        ahead = [f - x for f, x in zip(p["focus"], position, strict=True)]
        length = math.hypot(*ahead)
        cosine = math.fsum(a * f for a, f in zip(ahead, forward, strict=True)) / length if length else 1.0
        found.append((distance, max(0.0, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))) - turn)))
    return min(found)


def table() -> Table:
    """Regions with viewers: where they are, the unit vector along which they look, and how far they are outside."""
    return {"cases": [_case(*case) for case in VIEWS]}


def _case(name: str, places: list[Place], turn: float, views: list[tuple[Vector, Vector]]) -> dict[str, Any]:
    viewers = []
    for position, forward in views:
        distance, degrees = departure(places, turn, position, forward)
        degrees = 0.0 if degrees < 1e-4 else degrees  # rounding
        outside = {"distance": plain(distance), "degrees": plain(degrees), "inside": distance == 0 and degrees == 0}
        viewers.append({"position": position, "forward": plain(forward), **outside})
    return {"name": name, "turn": turn, "places": places, "viewers": viewers}
