"""Usage frequency: how much a Gaussian contributes to given views. N Gaussians, T frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airgs_codec.render import Camera, Contribution
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.usage import Usage


class UsageSums:
    """Adds up what single pictures say about N rows."""

    def __init__(self, rows: int) -> None:
        self._total, self._peak, self._hits = np.zeros(rows), np.zeros(rows), np.zeros(rows, np.int64)

    def add(self, seen: Contribution) -> None:
        """One more picture."""
        self._total += seen.total
        self._peak = np.maximum(self._peak, seen.peak)
        self._hits += seen.hits

    def usage(self) -> Usage:
        """Over all pictures added so far."""
        return Usage(self._total, self._peak, self._hits)


def measure_usage(frames: Sequence[Gaussians], cameras: Sequence[Camera], renderer: Renderer = CPU) -> Usage:
    """Usage over some frames of one group, seen by all cameras."""
    sums = UsageSums(len(frames[0]))
    for frame in frames:
        loaded = renderer.load(frame)
        for camera in cameras:
            sums.add(loaded.contribution(camera))
    return sums.usage()
