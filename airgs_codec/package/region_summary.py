"""The viewing region of a package in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airgs_codec.package.region import Departure
from airgs_codec.package.tables import Region

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
