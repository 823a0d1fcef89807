"""Quality of pictures: mean squared error, PSNR and SSIM; `color` has CIEDE2000.

Pictures are (H, W, 3) float32 RGB; samples outside [0, 1] are shown as the nearest end, and compared so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import blur

Floats = NDArray[np.float32]

PSNR_CAP = 100.0  # dB; equal pictures have no finite PSNR, and JSON no infinity
_RADIUS, _SIGMA = 5, 1.5  # Wang et al. 2004: 11x11 Gaussian window
_C1, _C2 = 0.01**2, 0.03**2  # same paper, K1 and K2 for a range of 1


def mse(a: Floats, b: Floats) -> float:
    """Mean squared error over pixels and channels."""
    return _mean_square(np.clip(a, 0, 1), np.clip(b, 0, 1))


def psnr(mean_squared_error: float) -> float:
    """PSNR in dB of samples in 0..1, at most PSNR_CAP. For many pictures take the mean of their errors first."""
    return PSNR_CAP if mean_squared_error <= 10 ** (-PSNR_CAP / 10) else -10 * math.log10(mean_squared_error)


def ssim(a: Floats, b: Floats) -> float:
    """Mean SSIM over pixels and channels (Wang et al. 2004, eq. 13), borders mirrored."""
    return Reference.of(b).ssim(a)


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A picture that several others are compared with, and what every comparison needs of it.

    It takes three times the memory of the picture; comparing takes half the time of `mse` and `ssim`.
    """

    picture: Floats  # (H, W, 3) within [0, 1]
    mean: Floats  # (H, W, 3) of the window around each pixel
    variance: Floats  # (H, W, 3) of the window, plus C2

    @staticmethod
    def of(picture: Floats) -> Reference:
        """The reference that a picture is."""
        shown = np.clip(picture, 0, 1)
        mean = blur(shown, _WINDOW)
        variance = blur(shown * shown, _WINDOW)
        variance -= mean * mean
        variance += _C2
        return Reference(shown, mean, variance)

    def mse(self, picture: Floats) -> float:
        """Mean squared error of another picture over pixels and channels."""
        return _mean_square(np.clip(picture, 0, 1), self.picture)

    def ssim(self, picture: Floats) -> float:
        """Mean SSIM of another picture, as `ssim` gives it."""
        shown = np.clip(picture, 0, 1)
        mean, product = blur(shown, _WINDOW), blur(shown * self.picture, _WINDOW)
        shown *= shown
        square = blur(shown, _WINDOW)
        # (2 m m' + C1) (2 (product - m m') + C2) / ((m^2 + m'^2 + C1) (square - m^2 + variance')), in place
        top = mean * self.mean
        top *= 2
        product *= 2
        product -= top
        product += _C2
        top += _C1
        top *= product
        mean *= mean
        square -= mean
        square += self.variance
        mean += self.mean * self.mean
        mean += _C1
        top /= np.multiply(mean, square, out=mean)
        return float(np.mean(top, dtype=np.float64))


def _gaussian_window() -> Floats:
    x = np.arange(-_RADIUS, _RADIUS + 1)
    kernel = np.exp(-(x**2) / (2 * _SIGMA**2))
    return (kernel / kernel.sum()).astype(np.float32)


_WINDOW = _gaussian_window()


def _mean_square(a: Floats, b: Floats) -> float:
    """Mean squared difference, summed in float64."""
    d = (a - b).ravel()
    return float(np.einsum("i,i->", d, d, dtype=np.float64)) / d.size
