"""Usage frequency: how much a Gaussian contributes to given views. N Gaussians, T frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airgs_codec.render import Camera, measure_contribution
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.usage import Usage


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
