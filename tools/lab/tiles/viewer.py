"""Viewers who turn at a pace that nobody knows in advance.

Times are seconds after the first picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from airgs_codec.package.tables import Region
from airgs_codec.package.viewpath import Path, path_of_region
from airgs_codec.scene.camera import Camera

PACE = 2.0  # seconds of the walk in a second, on average
Swing = tuple[float, float, float]  # seconds of the walk by which he runs ahead or behind; period; phase
SWINGS: tuple[Swing, ...] = ((3.0, 5.3, 0.0), (1.2, 1.9, 1.0))
HELD_OUT_SEED = 7
VIEWERS: dict[str, float] = {"lively": 1.0, "calm": 0.3, "even": 0.0}  # name -> factor on the swings
HELD_OUT = "held out"  # a viewer that no constant was chosen by


@dataclass(frozen=True, slots=True)
class Watcher:
    """The walk of a viewer through a region, as a `play.sight.View`."""

    path: Path
    swings: Sequence[Swing] = SWINGS

    @staticmethod
    def of(region: Region, name: str) -> Watcher:
        """One of VIEWERS, or the one that is HELD_OUT: other swings, drawn from a seed."""
        path = path_of_region(region)
        if name == HELD_OUT:
            return Watcher(path, drawn_swings(HELD_OUT_SEED))
        return Watcher(path, [(VIEWERS[name] * ahead, period, phase) for ahead, period, phase in SWINGS])

    def at(self, seconds: float) -> Camera:
        """What he sees at a moment."""
        place = PACE * seconds
        for ahead, period, phase in self.swings:
            place += ahead * (np.sin(2 * np.pi * seconds / period + phase) - np.sin(phase))
        return self.path.at(place)

    def turning(self, seconds: float, rate: int = 50) -> float:
        """Degrees a second that he turns at, the 95th percentile over a time."""
        axes = np.array([self.at(tick / rate).world_to_camera[2, :3] for tick in range(round(seconds * rate))])
        cosines = np.clip((axes[1:] * axes[:-1]).sum(axis=1), -1, 1)
        return float(np.percentile(np.degrees(np.arccos(cosines)) * rate, 95))


def drawn_swings(seed: int) -> list[Swing]:
    """Two swings about as strong as SWINGS, a slow one and a quick one."""
    rng = np.random.default_rng(seed)
    slow = float(rng.uniform(1.5, 3.0)), float(rng.uniform(4.0, 7.0)), float(rng.uniform(0, 2 * np.pi))
    quick = float(rng.uniform(0.5, 1.2)), float(rng.uniform(1.5, 2.5)), float(rng.uniform(0, 2 * np.pi))
    return [slow, quick]
