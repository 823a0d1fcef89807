"""Viewers inside and outside of a viewing region (FORMAT.md, section 8)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tests.makers.vectors.text import Table, plain
from tests.support.vectors import Case, cases

Vector = Sequence[float]


def departure(places: Sequence[Case], turn: float, position: Vector, forward: Vector) -> tuple[float, float]:
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
    return {"cases": [case | {"viewers": [_viewer(case, one) for one in case["viewers"]]} for case in cases("region")]}


def _viewer(case: Case, one: Case) -> Case:
    distance, degrees = departure(case["places"], case["turn"], one["position"], one["forward"])
    degrees = 0.0 if degrees < 1e-4 else degrees  # rounding
    return one | {"distance": plain(distance), "degrees": plain(degrees), "inside": distance == 0 and degrees == 0}
