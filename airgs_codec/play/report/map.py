"""Where the viewer of a session stands at every display tick, whether he keeps to the package's region, and a map.

The map shows the region from above: places, how far they reach, what they look at, and the walk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import BLUE, GREY, ORANGE, RED
from airgs_codec._sampling import evenly_spaced
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.region import ORBIT, Departure, departure_words, departures, levelled
from airgs_codec.package.tables import Region
from airgs_codec.package.viewpath import Path, path_by_cameras, path_of_region
from airgs_codec.play.session import SessionLog
from airgs_codec.render import Camera
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.camera import resized

MOST_PIXELS = 640  # of the longer side of a picture of the screen
MOST_STOPS = 64  # cameras that the walk comes by


def path_of(m: Manifest, cameras: Sequence[Camera] = ()) -> Path:
    """The way of a viewer through a package's region, or by way of `cameras`, at most MOST_STOPS of them."""
    region = levelled(m.region, m.world)
    if not cameras:
        return path_of_region(region)
    return path_by_cameras(region, [cameras[i] for i in evenly_spaced(len(cameras), MOST_STOPS)])


@dataclass(frozen=True, slots=True)
class Viewer:
    """A walk through a session."""

    region: Region
    cameras: list[Camera]  # one a display tick
    departures: list[Departure]  # from the region, one a display tick
    unreached: int = 0  # stops that the walk does not come by
    renderer: Renderer = CPU  # draws what he sees

    @staticmethod
    def of(log: SessionLog, cameras: Sequence[Camera] = (), renderer: Renderer = CPU) -> Viewer:
        """The walk along `path_of(manifest, cameras)`."""
        path, ticks = path_of(log.offers.manifest, cameras), len(log.screen_ticks)
        times = np.arange(ticks) / log.offers.fps
        shown = [resized(view, MOST_PIXELS / max(view.width, view.height)) for view in path.cameras(times)]
        return Viewer(path.region, shown, departures(path.region, shown), path.unreached, renderer)

    @property
    def outside(self) -> int:
        """How many ticks the viewer is outside of the region."""
        return sum(not d.inside for d in self.departures)

    @property
    def furthest(self) -> Departure:
        """The most in world units and the most in degrees, perhaps of different ticks."""
        return Departure(max(d.distance for d in self.departures), max(d.degrees for d in self.departures))

    def caption(self, tick: int) -> str:
        """Return what a film has to say about the place of its viewer; empty where all is well."""
        if not self.departures[tick].inside:
            return f"outside the region: {departure_words(self.departures[tick])}"
        return "viewpoint unknown: an orbit is assumed" if self.region.source == ORBIT else ""

    @property
    def words(self) -> str:
        """Where the viewer was, in a line."""
        text = "inside the viewing region all the time"
        if self.outside:
            at_most = departure_words(self.furthest)
            text = f"outside the viewing region for {self.outside} of {len(self.cameras)} ticks, by at most {at_most}"
        if self.unreached:
            why = "the way there leads out of the region or through what is looked at"
            text += f"; stops that are not on the walk, {why}: {self.unreached}"
        return text

    def table(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "ticks": len(self.cameras),
            "ticks_outside": self.outside,
            "furthest_units": self.furthest.distance,
            "furthest_degrees": self.furthest.degrees,
            "stops_unreached": self.unreached,
        }


def draw_region(axis: Any, region: Region) -> None:
    """Balls as circles, a line from each place to its focus."""
    plane = _plane(region)
    positions = np.array([place.position for place in region.places]) @ plane
    foci = np.array([place.focus for place in region.places]) @ plane
    turns = np.linspace(0, 2 * np.pi, 64)
    ring = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for position, place in zip(positions, region.places, strict=True):
        axis.fill(*(position + place.reach * ring).T, color=BLUE, alpha=0.12, linewidth=0)
    axis.plot(*np.stack([positions, foci], axis=1).T, color=GREY, linewidth=0.5, alpha=0.6)
    axis.plot(*foci.T, "x", ms=4, color=ORANGE, label="looked at")
    axis.plot(*positions.T, ".", ms=5, color=BLUE, label="places, and their reach")
    axis.set(title="Viewing region from above, world units", aspect="equal")
    axis.grid(alpha=0.3)
    axis.set_axisbelow(True)


def _plane(region: Region) -> NDArray[np.float64]:
    """(3, 2) directions to the right and towards the top of the map, across the mean up of the places."""
    up = np.mean([np.array(place.up) / np.linalg.norm(place.up) for place in region.places], axis=0)
    _, _, axes = np.linalg.svd(up[None])  # the first row is along `up`
    right, top = axes[1:]
    if np.cross(right, top) @ up < 0:
        top = -top
    return np.stack([right, top], axis=1)


def draw_walk(viewer: Viewer, axis: Any) -> None:
    """The region with the walk of a viewer."""
    draw_region(axis, viewer.region)
    line = np.array([camera.position for camera in viewer.cameras]) @ _plane(viewer.region)
    axis.plot(*line.T, color="black", linewidth=1, label="the walk")
    outside = line[[not d.inside for d in viewer.departures]]
    if len(outside):
        axis.plot(*outside.T, ".", ms=3, color=RED, label="outside")
    axis.set_title("")
    axis.legend(fontsize=8, loc="upper right")
