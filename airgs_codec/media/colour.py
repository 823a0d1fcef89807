"""How different colours look: CIEDE2000, and what it says of small errors. Colours are sRGB from 0 to 1.

The only importer of colour-science, and only when asked: it takes two seconds.
"""

from __future__ import annotations

import sys
import threading
import warnings

import numpy as np
from numpy.typing import NDArray

SMALL = 0.01  # change of a sample by which the metric of colours is taken, and what is black
_LOADING = threading.Lock()  # filters of warnings and print options are those of all threads


def to_lab(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) colours as CIE Lab."""
    _load()
    from colour import XYZ_to_Lab, sRGB_to_XYZ

    return np.asarray(XYZ_to_Lab(sRGB_to_XYZ(rgb)), np.float64)


def delta_e(reference: NDArray[np.float64], shown: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) CIEDE2000 (Sharma et al. 2005) of (..., 3) Lab colours."""
    _load()
    from colour.difference import delta_E_CIE2000

    return np.asarray(delta_E_CIE2000(reference, shown), np.float64)


def delta_e_metric(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) M: if (n, 3) colours all change by a small d (3,), their mean squared CIEDE2000 is about d M d.

    Black ones, where nothing may have been drawn, do not count; M is the identity where all are.
    """
    rgb = rgb[rgb.max(axis=1) > SMALL]
    if not len(rgb):
        return np.eye(3)
    lab = to_lab(rgb)

    def squared(change: NDArray[np.float64]) -> float:
        return float(np.square(delta_e(lab, to_lab(rgb + SMALL * change))).mean()) / SMALL**2

    alone = [squared(axis) for axis in np.eye(3)]
    metric = np.diag(alone)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        metric[i, j] = metric[j, i] = (squared(np.eye(3)[i] + np.eye(3)[j]) - alone[i] - alone[j]) / 2
    return metric


def _load() -> None:
    """Import colour-science without its warnings about matplotlib, which only its plots need, and its print options."""
    with _LOADING:
        if "colour.difference" not in sys.modules:
            with warnings.catch_warnings(action="ignore"), np.printoptions():
                import colour.difference  # noqa: F401
