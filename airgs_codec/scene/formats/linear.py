"""Opacities and sizes that a file has as they are, not as logits and logarithms."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

SATURATED_LOGIT = np.float32(math.log(1019))  # a quarter of a step of 1/255 off 0 and 1, whose logits are infinite

_LEAST_SIZE = np.float32(1e-9)  # in place of 0, whose logarithm is infinite
SIZES = ("log_scales", -87.0, 88.0)  # whose sizes are neither 0 nor infinite in float32


def logits_of(alpha: NDArray[np.floating]) -> NDArray[np.float32]:
    """Logits of opacities in [0, 1], NaN of NaN.

    What is nearer to 0 or 1 than a quarter of a step of 1/255 becomes that, so that no logit is infinite.
    """
    alpha = alpha.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        logits = np.log(alpha / (1 - alpha))
    return np.clip(logits, -SATURATED_LOGIT, SATURATED_LOGIT).astype(np.float32)


def logs_of(sizes: NDArray[np.floating]) -> NDArray[np.float32]:
    """Logarithms of sizes; NaN of NaN and of what is negative, which is no size."""
    with np.errstate(invalid="ignore"):
        return np.log(np.where(sizes == 0, _LEAST_SIZE, sizes)).astype(np.float32)
