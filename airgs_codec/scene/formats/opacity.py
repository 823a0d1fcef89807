"""Opacities that a file has as they are, not as logits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

SATURATED_LOGIT = np.float32(math.log(1019))  # a quarter of a step of 1/255 off 0 and 1, whose logits are infinite


def logits_of(alpha: NDArray[np.floating]) -> NDArray[np.float32]:
    """Logits of opacities in [0, 1], NaN of NaN.

    What is nearer to 0 or 1 than a quarter of a step of 1/255 becomes that, so that no logit is infinite.
    """
    alpha = alpha.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        logits = np.log(alpha / (1 - alpha))
    return np.clip(logits, -SATURATED_LOGIT, SATURATED_LOGIT).astype(np.float32)
