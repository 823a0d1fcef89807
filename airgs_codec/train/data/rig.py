"""Rigs without poses: a folder of videos that cameras filmed at the same time, and what finding their poses came to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from airgs_codec.errors import SceneError
from airgs_codec.train.data.videos import find_videos

FEWEST = 3  # cameras with a pose


@dataclass(frozen=True, slots=True)
class RigCamera:
    """What was found of one camera."""

    name: str
    posed: bool
    features: int  # in its picture
    matches: int  # of its features, summed over the cameras that it shares a geometry with
    neighbours: int  # these cameras
    points: int  # that its pose rests on; 0 without one
    error: float | None  # pixels, mean reprojection error of these points; None without a pose


@dataclass(frozen=True, slots=True)
class RigReport:
    """What finding the poses of a rig came to."""

    cameras: tuple[RigCamera, ...]
    points: int
    error: float  # pixels, mean reprojection error of all points

    @property
    def failed(self) -> list[RigCamera]:
        """The cameras without a pose."""
        return [camera for camera in self.cameras if not camera.posed]

    def summary(self) -> str:
        """The whole in a line."""
        posed = len(self.cameras) - len(self.failed)
        return f"{posed} of {len(self.cameras)} cameras have poses, {self.points:,} points, {self.error:.2f} px"

    def lines(self) -> list[str]:
        """A line for each camera."""
        return [_line(camera) for camera in self.cameras]


def has_rig(folder: Path) -> bool:
    """Whether the folder has several videos, in itself or in videos/."""
    return len(rig_videos(folder)) > 1


def rig_videos(folder: Path) -> list[Path]:
    """The videos of a rig by name, one a camera."""
    return find_videos(folder / "videos") or find_videos(folder)


def read_rig(folder: Path) -> NoReturn:
    """Raises SceneError: the poses must be found first."""
    count = len(rig_videos(folder))
    raise SceneError(f"{folder}: expected poses of {count} cameras, got videos alone: airgs-train finds them")


def _line(c: RigCamera) -> str:
    seen = f"{c.features:,} features, {c.matches:,} matches with {c.neighbours} cameras"
    if c.error is None:
        return f"{c.name}: no pose, {seen}"
    return f"{c.name}: {seen}, {c.points:,} points, {c.error:.2f} px"
