"""What pictures differ by, as slow and plain as the definitions."""

from __future__ import annotations

import numpy as np


def plain_mse(a: np.ndarray, b: np.ndarray) -> float:
    """Mean squared error of (H, W, 3) pictures, sample by sample."""
    total = 0.0
    for first, second in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True):
        total += (min(max(first, 0.0), 1.0) - min(max(second, 0.0), 1.0)) ** 2
    return total / a.size


def plain_ssim(a: np.ndarray, b: np.ndarray) -> float:
    x = np.arange(-5, 6)
    weights = np.exp(-(x[:, None] ** 2 + x**2) / (2 * 1.5**2))
    weights /= weights.sum()

    def local_mean(p: np.ndarray) -> np.ndarray:
        padded = np.pad(p, ((5, 5), (5, 5), (0, 0)), mode="reflect")
        return np.einsum("hwcij,ij->hwc", np.lib.stride_tricks.sliding_window_view(padded, (11, 11), (0, 1)), weights)

    a, b = np.clip(a, 0, 1).astype(np.float64), np.clip(b, 0, 1).astype(np.float64)
    ma, mb = local_mean(a), local_mean(b)
    va, vb, covariance = local_mean(a * a) - ma**2, local_mean(b * b) - mb**2, local_mean(a * b) - ma * mb
    top = (2 * ma * mb + 0.01**2) * (2 * covariance + 0.03**2)
    return float((top / ((ma**2 + mb**2 + 0.01**2) * (va + vb + 0.03**2))).mean())
