"""Opacity as it is coded: alpha in [0, 1], not its logit. Arrays of any shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.gaussians import sigmoid

Floats = NDArray[np.floating]

# Decoded opacities stay inside [2^-20, 1 - 2^-20]: outside, the logit of a stored .ply is infinite.
OPACITY_MARGIN = np.float32(2.0**-20)


def to_opacity(logits: Floats) -> Floats:
    """Logits -> alpha in [0, 1]."""
    return sigmoid(logits)


def from_opacity(opacity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Decoded alpha -> finite logits; alpha that coding error carried out of [0, 1] is limited first (FORMAT.md §5)."""
    a = np.clip(opacity, OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    return np.log(a / (1 - a))
