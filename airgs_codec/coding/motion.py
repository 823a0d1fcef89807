"""Motion classes and units: the displacement of a row is sent the finer, the more pictures depend on it. N rows.

A row of class c has the motion unit 2^c world units.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import LEAST_CLASS, MOST_CLASS
from airgs_codec.scene.gaussians import Gaussians

FLOOR = 0.01  # of the median: rows that the given views hardly see may be seen from others


def motion_classes(sensitivity: NDArray[np.float64], floor: float) -> NDArray[np.int16]:
    """(N,) mean squared derivatives of pictures by the rows' means, in 1 / world unit^2 -> (N,) motion classes.

    The motion unit is the power of two nearest to the fourth root of 1 / `sensitivity`. `floor` (> 0) is the least
    sensitivity that counts: of a row that no picture shows the logarithm is infinite.
    """
    return np.clip(np.rint(-0.25 * np.log2(np.maximum(sensitivity, floor))), LEAST_CLASS, MOST_CLASS).astype(np.int16)


def motion_units(classes: NDArray[np.int16]) -> NDArray[np.float32]:
    """(N,) motion classes -> (N,) motion units 2^c in world units."""
    return np.exp2(classes.astype(np.float32))


def classify_motion(sensitivity: NDArray[np.float64], g: Gaussians) -> NDArray[np.int16]:
    """(N,) motion classes by (N,) `sensitivity`, as in `motion_classes`; where no row is seen, by the median size."""
    seen = sensitivity[sensitivity > 0]
    if not len(seen):  # nothing is visible: every row counts alike
        return np.full(len(g), round(math.log2(_median_size(g))), np.int16)
    return motion_classes(sensitivity, FLOOR * float(np.median(seen)))


def _median_size(g: Gaussians) -> float:
    return float(np.exp(np.clip(np.median(g.log_scales.astype(np.float64)), -30, 30)))
