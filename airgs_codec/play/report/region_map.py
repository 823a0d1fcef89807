"""A map of a viewing region from above: places, how far they reach, what they look at, and a viewer's walk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, save_figure
from airgs_codec.package.region import Departure
from airgs_codec.package.tables import Region
from airgs_codec.play.report.viewer import Viewer
from airgs_codec.render import Camera

_BLUE, _ORANGE, _RED, _GREY = "#2a6fbb", "#e08a1e", "#c8453b", "#8a8f98"


def plot_region(viewer: Viewer, path: Path) -> None:
    """The region with the walk of a viewer. Raises ConfigError."""
    figure = new_figure(6, 6)
    axis = figure.subplots()
    draw_region(axis, viewer.region)
    _draw_walk(axis, viewer.region, viewer.cameras, viewer.departures)
    axis.legend(fontsize=8, loc="upper right")
    save_figure(figure, path)


def draw_region(axis: Any, region: Region) -> None:
    """Balls as circles, a line from each place to its focus."""
    plane = _plane(region)
    positions = np.array([place.position for place in region.places]) @ plane
    foci = np.array([place.focus for place in region.places]) @ plane
    turns = np.linspace(0, 2 * np.pi, 64)
    ring = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for position, place in zip(positions, region.places, strict=True):
        axis.fill(*(position + place.reach * ring).T, color=_BLUE, alpha=0.12, linewidth=0)
    axis.plot(*np.stack([positions, foci], axis=1).T, color=_GREY, linewidth=0.5, alpha=0.6)
    axis.plot(*foci.T, "x", ms=4, color=_ORANGE, label="looked at")
    axis.plot(*positions.T, ".", ms=5, color=_BLUE, label="places, and their reach")
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


def _draw_walk(axis: Any, region: Region, cameras: Sequence[Camera], away: Sequence[Departure]) -> None:
    line = np.array([camera.position for camera in cameras]) @ _plane(region)
    axis.plot(*line.T, color="black", linewidth=1, label="the walk")
    outside = line[[not d.inside for d in away]]
    if len(outside):
        axis.plot(*outside.T, ".", ms=3, color=_RED, label="outside")
