"""What a viewer sees and is expected to see: views over time, and boxes in and beside a picture.

A player knows how its viewer stands and moved until now. It expects the movement to go on and to die down, so that
after t seconds DECAY_S * (1 - exp(-t / DECAY_S)) seconds of it have passed. Measured in docs/results/tiles.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import GroupTile
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import from_rotation_vector, to_matrices

BEFORE_S = 0.1  # seconds over which a viewer's movement is measured
DECAY_S = 0.5  # seconds in which a movement is expected to have died down to 1 / e
SMALL_TURN = 1e-6  # radians: below it angle / (2 sin(angle)) is 1/2
CORNERS = 6  # points on each axis of a box that are looked for in a picture

Vector = NDArray[np.float64]


class View(Protocol):
    """What a viewer sees over time."""

    def at(self, seconds: float) -> Camera:
        """His picture so many seconds after the first one was shown."""


@dataclass(frozen=True, slots=True, eq=False)
class Velocity:
    """How a viewer moves."""

    turn: Vector  # (3,) rotation vector in camera axes, radians a second
    shift: Vector  # (3,) world units a second

    @staticmethod
    def between(before: Camera, here: Camera, seconds: float = BEFORE_S) -> Velocity:
        """The steady movement that leads from one view to another in a time."""
        step = here.world_to_camera[:3, :3] @ before.world_to_camera[:3, :3].T
        angle = np.arccos(np.clip((np.trace(step) - 1) / 2, -1, 1))
        axis = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]])
        turn = axis * (0.5 if angle < SMALL_TURN else angle / (2 * np.sin(angle)))
        return Velocity(turn / seconds, (here.position - before.position) / seconds)


def expected(view: Camera, velocity: Velocity, ahead_s: float) -> Camera:
    """Return what a viewer is expected to see some seconds later who sees and moves like this."""
    passed_s = DECAY_S * (1 - np.exp(-max(0.0, ahead_s) / DECAY_S))
    rotation = to_matrices(from_rotation_vector(passed_s * velocity.turn)) @ view.world_to_camera[:3, :3]
    position = view.position + passed_s * velocity.shift
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ position
    return replace(view, world_to_camera=matrix)


def half_angles(view: Camera) -> Vector:
    """(2,) half of the field of view across and down, radians."""
    return np.arctan([view.width / 2 / view.fx, view.height / 2 / view.fy])


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Parts of space, P of them, each as CORNERS points on every axis of a box, its corners among them."""

    points: Vector  # (P, CORNERS^3, 3) scene coordinates; NaN where nothing is to be seen

    @staticmethod
    def of(corners: Iterable[tuple[Sequence[float], Sequence[float]]]) -> Boxes:
        """Boxes between two opposite corners (3,) each."""
        clouds = []
        for low, high in corners:
            axes = [np.linspace(a, b, CORNERS) for a, b in zip(low, high, strict=True)]
            clouds.append(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3))
        return Boxes(np.array(clouds))

    @staticmethod
    def of_tiles(tiles: Sequence[GroupTile]) -> Boxes:
        """The boxes of the tiles of a group; nothing is to be seen of a tile without rows."""
        boxes = Boxes.of((tile.low, tile.high) for tile in tiles)
        boxes.points[[not any(tier.count for tier in tile.tiers) for tile in tiles]] = np.nan
        return boxes

    @property
    def has_rows(self) -> NDArray[np.bool_]:
        """(P,) where there is something to be seen."""
        return np.isfinite(self.points[:, 0, 0])

    def degrees_off(self, view: Camera) -> Vector:
        """(P,) by how many degrees the sides of a picture must be moved out for a point of a box to be in it.

        Negative where one is in the picture: how far inside of its sides the innermost one is. Infinite where nothing
        is to be seen.
        """
        x, y, z = np.moveaxis(self.points @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3], -1, 0)
        across, down = half_angles(view)
        beside, above = np.abs(np.arctan2(x, z)) - across, np.abs(np.arctan2(y, np.hypot(x, z))) - down
        off = np.degrees(np.maximum(beside, above).min(axis=1))
        return np.where(self.has_rows, off, np.inf)

    def nearest(self, views: Iterable[Camera]) -> Vector:
        """(P,) the same in that of some pictures in which it is least."""
        return np.min([self.degrees_off(view) for view in views], axis=0)

    def in_sight(self, view: Camera, margin: float) -> NDArray[np.bool_]:
        """(P,) whether a point of a box is in a picture whose sides are moved out by `margin` degrees."""
        return self.degrees_off(view) <= margin
