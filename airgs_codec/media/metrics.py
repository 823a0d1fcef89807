"""Quality of pictures: mean squared error, PSNR and SSIM; `color` has CIEDE2000.

Pictures are (H, W, 3) float32 RGB; samples outside [0, 1] are shown as the nearest end, and compared so.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import blur

PSNR_CAP = 100.0  # dB; equal pictures have no finite PSNR, and JSON no infinity
_RADIUS, _SIGMA = 5, 1.5  # Wang et al. 2004: 11x11 Gaussian window
_C1, _C2 = 0.01**2, 0.03**2  # same paper, K1 and K2 for a range of 1


def mse(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Mean squared error over pixels and channels."""
    return float(np.mean((np.clip(a, 0, 1).astype(np.float64) - np.clip(b, 0, 1)) ** 2))


def psnr(mean_squared_error: float) -> float:
    """PSNR in dB of samples in 0..1, at most PSNR_CAP. For many pictures take the mean of their errors first."""
    return PSNR_CAP if mean_squared_error <= 10 ** (-PSNR_CAP / 10) else -10 * math.log10(mean_squared_error)


def ssim(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Mean SSIM over pixels and channels (Wang et al. 2004, eq. 13), borders mirrored."""
    x = np.arange(-_RADIUS, _RADIUS + 1)
    kernel = np.exp(-(x**2) / (2 * _SIGMA**2))
    kernel = (kernel / kernel.sum()).astype(np.float32)
    a, b = np.clip(a, 0, 1), np.clip(b, 0, 1)
    mean_a, mean_b = blur(a, kernel), blur(b, kernel)
    var_a = blur(a * a, kernel) - mean_a**2
    var_b = blur(b * b, kernel) - mean_b**2
    covariance = blur(a * b, kernel) - mean_a * mean_b
    top = (2 * mean_a * mean_b + _C1) * (2 * covariance + _C2)
    return float(np.mean(top / ((mean_a**2 + mean_b**2 + _C1) * (var_a + var_b + _C2)), dtype=np.float64))
