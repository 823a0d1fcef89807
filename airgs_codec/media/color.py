"""Colour difference as people see it. The only importer of colour-science, and only when asked: it takes two seconds.

Pictures are (H, W, 3) sRGB as shown on a screen, in [0, 1].
"""

from __future__ import annotations

import math
import warnings

import numpy as np
from numpy.typing import NDArray

MAX_PIXELS = 8192  # compared of a picture; all 320x320 of them take twenty times the time of its PSNR and SSIM


def delta_e(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Mean CIEDE2000 difference (Sharma et al. 2005) of two pictures; about 1 is just noticeable.

    Over every s-th pixel of every s-th row from the first on, s = ceil(sqrt(H W / MAX_PIXELS)): evenly spread, and at
    most about MAX_PIXELS. Samples outside [0, 1] are shown as the nearest end, and compared so.
    """
    # colour-science warns where matplotlib is missing, which only its plots need, and sets numpy's print options.
    with warnings.catch_warnings(action="ignore"), np.printoptions():
        from colour import XYZ_to_Lab, sRGB_to_XYZ
        from colour.difference import delta_E_CIE2000
    stride = math.ceil(math.sqrt(a.shape[0] * a.shape[1] / MAX_PIXELS))
    lab_a, lab_b = (XYZ_to_Lab(sRGB_to_XYZ(p[::stride, ::stride].clip(0, 1).astype(np.float64))) for p in (a, b))
    return float(np.mean(delta_E_CIE2000(lab_a, lab_b)))
