"""Usage frequency: how much a Gaussian contributes to the training views. N Gaussians, T frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.gaussians import Gaussians
from airgs_codec.render import Camera, measure_contribution

MEASURES = ("importance", "max", "sum", "hits")  # the first is `leaveout.importance`


@dataclass(frozen=True, slots=True, eq=False)
class Usage:
    """Blending weights alpha T of each Gaussian over all pixels, views and frames measured."""

    total: NDArray[np.float64]  # (N,) sum of alpha T
    peak: NDArray[np.float64]  # (N,) max of alpha T, 0..1
    hits: NDArray[np.int64]  # (N,) pixels where it is blended: the paper's usage frequency, literally

    def measure(self, name: str) -> NDArray[np.float64]:
        """(N,) by name: max, sum or hits."""
        return {"max": self.peak, "sum": self.total, "hits": self.hits.astype(np.float64)}[name]


def measure_usage(frames: Sequence[Gaussians], cameras: Sequence[Camera]) -> Usage:
    """Usage over some frames of one group, seen by all cameras."""
    n = len(frames[0])
    total, peak, hits = np.zeros(n), np.zeros(n), np.zeros(n, np.int64)
    for frame in frames:
        for camera in cameras:
            seen = measure_contribution(frame, camera)
            total += seen.total
            peak = np.maximum(peak, seen.peak)
            hits += seen.hits
    return Usage(total, peak, hits)
