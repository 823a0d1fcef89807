"""Colour difference as people see it. The only importer of colour, and only when asked: it takes a second to load."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def delta_e(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Mean CIEDE2000 difference of two (H, W, 3) sRGB pictures of [0, 1]; about 1 is just noticeable."""
    import colour  # a second of imports, paid only by those who ask

    lab = [colour.XYZ_to_Lab(colour.sRGB_to_XYZ(np.clip(p, 0, 1).astype(np.float64))) for p in (a, b)]
    return float(np.mean(colour.delta_E(lab[0], lab[1], method="CIE 2000")))
