"""A viewer who turns at a pace that nobody knows in advance, what a player expects him to see, and what he sees.

Times are seconds from the first picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import Region
from airgs_codec.package.viewpath import walk_region
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.rotations import from_rotation_vector, to_matrices
from tools.tiles.split import Tile

RATE = 50.0  # cameras a second of the walk
PACE = 2.0  # seconds of the walk in a second, on average
SWINGS = ((3.0, 5.3, 0.0), (1.2, 1.9, 1.0))  # seconds of the walk by which he runs ahead or behind; period; phase
BEFORE = 0.1  # seconds over which a player measures how fast he moves
DECAY = 0.5  # seconds in which a movement is expected to have died down to 1 / e
CORNERS = 6  # points on each axis of a tile's box that are looked for in the picture
SIGMAS = 3.0  # of a Gaussian, within which it is seen


@dataclass(frozen=True, slots=True)
class Watcher:
    """The walk of a viewer through a region."""

    walk: list[Camera]
    swing: float = 1.0  # factor on SWINGS

    @staticmethod
    def of(region: Region, seconds: float, swing: float = 1.0) -> Watcher:
        """A walk that is long enough for so many seconds."""
        longest = PACE * seconds + 2 * swing * sum(ahead for ahead, _, _ in SWINGS)
        return Watcher(walk_region(region, int(longest * RATE), RATE).cameras, swing)

    def at(self, time: float) -> Camera:
        """What he sees at a moment."""
        place = PACE * time
        for ahead, period, phase in SWINGS:
            place += self.swing * ahead * (np.sin(2 * np.pi * max(0.0, time) / period + phase) - np.sin(phase))
        return self.walk[int(np.clip(round(place * RATE), 0, len(self.walk) - 1))]

    def expected(self, now: float, later: float) -> Camera:
        """What a player expects him to see later who knows how he stood and moved until now."""
        if later <= now:
            return self.at(later)
        here, before = self.at(now), self.at(now - BEFORE)
        share = DECAY * (1 - np.exp(-(later - now) / DECAY)) / BEFORE
        turn = here.world_to_camera[:3, :3] @ before.world_to_camera[:3, :3].T
        angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
        axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        vector = share * axis * (0.5 if angle < 1e-6 else angle / (2 * np.sin(angle)))
        rotation = to_matrices(from_rotation_vector(vector)) @ here.world_to_camera[:3, :3]
        position = here.position + share * (here.position - before.position)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ position
        return replace(here, world_to_camera=matrix)


def half_angles(camera: Camera) -> NDArray[np.float64]:
    """(2,) half of the field of view across and down, radians."""
    return np.arctan([camera.width / 2 / camera.fx, camera.height / 2 / camera.fy])


def in_sight(tile: Tile, camera: Camera, margin: float) -> bool:
    """Whether a point of a tile's box is in the picture, whose sides are moved out by `margin` degrees."""
    axes = [np.linspace(low, high, CORNERS) for low, high in zip(tile.low, tile.high, strict=True)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    x, y, z = (points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]).T
    across, down = half_angles(camera) + np.radians(margin)
    beside, above = np.abs(np.arctan2(x, z)), np.abs(np.arctan2(y, np.hypot(x, z)))
    return bool(((beside <= across) & (above <= down)).any())


def distance(tile: Tile, camera: Camera) -> float:
    """World units from a viewer to the nearest point of a tile's box."""
    return float(np.linalg.norm(np.clip(camera.position, tile.low, tile.high) - camera.position))


def touches(frame: Gaussians, camera: Camera) -> bool:
    """Whether any Gaussian of a frame is in the picture, to SIGMAS."""
    means = frame.means.astype(np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    z = means[:, 2]
    front = z > camera.near
    across, down = np.tan(half_angles(camera))
    reach = SIGMAS * np.exp(frame.log_scales.max(axis=1).astype(np.float64)) * np.hypot(1, max(across, down))
    inside = (np.abs(means[:, 0]) <= z * across + reach) & (np.abs(means[:, 1]) <= z * down + reach)
    return bool((front & inside).any())


def moments(start: float, stop: float, count: int = 5) -> Iterator[float]:
    """Moments of a span of time, its ends among them."""
    yield from np.linspace(start, stop, count).tolist()
