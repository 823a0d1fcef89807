"""Motion classes and units: a row that pictures depend on more has its displacement sent finer. N rows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.sensitivity import FLOOR, Sensitivity
from airgs_codec.scene.gaussians import Gaussians


def motion_classes(sensitivity: NDArray[np.float64], floor: float) -> NDArray[np.int16]:
    """(N,) squared derivative of the picture by a row's mean, 1 / world unit^2 -> class c, its motion unit 2^c.

    The unit is the nearest power of two to 1 / sqrt(derivative): a row that the picture depends on more is sent finer.
    `floor` (> 0) is the least sensitivity that counts.
    """
    return np.clip(np.rint(-0.25 * np.log2(np.maximum(sensitivity, floor))), -128, 127).astype(np.int16)


def motion_units(classes: NDArray[np.int16]) -> NDArray[np.float32]:
    """(N,) class -> 2^c, what a row's displacement is counted in (world units)."""
    return np.exp2(classes.astype(np.float32))


def classify_motion(sensitivity: Sensitivity, g: Gaussians) -> NDArray[np.int16]:
    """(N,) motion classes: by what the pictures depend on a row; by the median size where no row is visible."""
    seen = sensitivity.means[sensitivity.means > 0]
    if not len(seen):  # nothing is visible: every row counts alike
        return np.full(len(g), round(math.log2(_median_size(g))), np.int16)
    return motion_classes(sensitivity.means, FLOOR * float(np.median(seen)))


def _median_size(g: Gaussians) -> float:
    return float(np.exp(np.clip(np.median(g.log_scales.astype(np.float64)), -30, 30)))
