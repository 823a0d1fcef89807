"""How much pictures differ: mean squared error, PSNR, SSIM and CIEDE2000, of one picture and of many together.

Pictures are (H, W, 3) float32 sRGB. OpenCV is loaded to compare pictures, not for figures alone; colour-science, which
takes two seconds, when colours are compared.
"""

from __future__ import annotations

import math
import sys
import threading
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

PSNR_CAP = 100.0  # dB; equal pictures have no finite PSNR, and JSON no infinity
MOST_COLOURS = 2048  # pixels whose colours are compared; all of 320x320 take twenty times the time of PSNR and SSIM
_WINDOW = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))  # Wang et al. 2004: 11x11, Gaussian
_WINDOW = (_WINDOW / _WINDOW.sum()).astype(np.float32)
_C1, _C2 = 0.01**2, 0.03**2  # same paper, K1 and K2 for a range of 1
LOW = 0.05  # the quantile of pictures that is given next to their mean
SMALL = 0.01  # change of a sample by which the metric of colours is taken, and what is black
_LOADING = threading.Lock()  # filters of warnings and print options are those of all threads


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture as a screen shows it. What comparing it takes is computed once: for SSIM twice its memory."""

    rgb: Floats  # (H, W, 3) within [0, 1]

    @staticmethod
    def of(rgb: Floats) -> Picture:
        """Return a picture of (H, W, 3) samples, of which those outside [0, 1] become the nearest end."""
        return Picture(np.clip(rgb, 0, 1))

    def mse(self, other: Picture) -> float:
        """Return the mean squared error of another picture over pixels and channels, summed in float64."""
        d = (self.rgb - other.rgb).ravel()
        return float(np.einsum("i,i->", d, d, dtype=np.float64)) / d.size

    def ssim(self, other: Picture) -> float:
        """Return the mean SSIM over pixels and channels (Wang et al. 2004, eq. 13), borders mirrored."""
        product, covariance = self._mean * other._mean, _blur(self.rgb * other.rgb)
        covariance -= product
        means, spread = other._mean * other._mean + self._mean * self._mean, self._variance + other._variance
        likeness = (2 * product + _C1) * (2 * covariance + _C2) / ((means + _C1) * (spread + _C2))
        return float(np.mean(likeness, dtype=np.float64))

    def delta_e(self, other: Picture) -> float:
        """Return the mean CIEDE2000 difference (Sharma et al. 2005) of another picture; about 1 is just noticeable.

        Over every s-th pixel of every s-th row from the first on, s = ceil(sqrt(H W / MOST_COLOURS)): evenly spread,
        and at most about MOST_COLOURS.
        """
        return float(np.mean(delta_e(other._lab, self._lab)))

    @cached_property
    def _mean(self) -> Floats:
        return _blur(self.rgb)

    @cached_property
    def _variance(self) -> Floats:
        return _blur(self.rgb * self.rgb) - self._mean * self._mean

    @cached_property
    def _lab(self) -> NDArray[np.float64]:
        return to_lab(self.sampled)

    @property
    def sampled(self) -> NDArray[np.float64]:
        """Return the (h, w, 3) pixels whose colours are compared."""
        height, width, _ = self.rgb.shape
        stride = math.ceil(math.sqrt(height * width / MOST_COLOURS))
        return self.rgb[::stride, ::stride].astype(np.float64)


@dataclass(frozen=True, slots=True)
class Difference:
    """How much one picture differs from the picture that it should be."""

    mse: float  # mean squared error over pixels and channels
    ssim: float | None  # mean over pixels and channels; None: not compared
    delta_e: float | None  # CIEDE2000, mean over pixels; None: not compared
    blank: bool = False  # both are the same colour all over: they show nothing

    @staticmethod
    def of(reference: Picture, shown: Picture) -> Difference:
        """Return every figure of two pictures of one size."""
        error, blank = reference.mse(shown), bool((reference.rgb == shown.rgb[0, 0]).all())
        return Difference(error, reference.ssim(shown), reference.delta_e(shown), blank and error == 0)


@dataclass(frozen=True, slots=True)
class Quality:
    """How near some pictures are to what they should be."""

    psnr: float  # dB, of the mean squared error over pictures
    low: float  # dB: the quantile LOW of the PSNR of pictures
    ssim: float  # mean over pictures
    delta_e: float  # CIEDE2000, mean over pictures


def pool(differences: Sequence[Difference]) -> Quality:
    """Return the quality of all pictures together, at least one: of those that show something, if any does."""
    differences = [d for d in differences if not d.blank] or differences
    squared = [d.mse for d in differences]
    ssim, delta_e = (float(np.mean([getattr(d, name) for d in differences])) for name in ("ssim", "delta_e"))
    return Quality(psnr(float(np.mean(squared))), low_psnr(squared), ssim, delta_e)


def low_psnr(squared: Sequence[float]) -> float:
    """Return the quantile LOW of the PSNR, in dB, of pictures with these mean squared errors."""
    return float(np.quantile([psnr(error) for error in squared], LOW))


def mse(a: Floats, b: Floats) -> float:
    """Return the mean squared error of two pictures over pixels and channels, as a screen shows them."""
    return Picture.of(a).mse(Picture.of(b))


def psnr(mean_squared_error: float) -> float:
    """Return the PSNR in dB of samples in 0..1, at most PSNR_CAP. Of many pictures, give the mean of their errors."""
    return PSNR_CAP if mean_squared_error <= 10 ** (-PSNR_CAP / 10) else -10 * math.log10(mean_squared_error)


def _blur(picture: Floats) -> Floats:
    from airgs_codec.media.image import blur

    return blur(picture, _WINDOW)


def to_lab(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (..., 3) colours as CIE Lab."""
    _load()
    from colour import XYZ_to_Lab, sRGB_to_XYZ

    return np.asarray(XYZ_to_Lab(sRGB_to_XYZ(rgb)), np.float64)


def delta_e(reference: NDArray[np.float64], shown: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (...) CIEDE2000 (Sharma et al. 2005) of (..., 3) Lab colours."""
    _load()
    from colour.difference import delta_E_CIE2000

    return np.asarray(delta_E_CIE2000(reference, shown), np.float64)


def delta_e_metric(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3, 3) M: if (n, 3) colours all change by a small d (3,), their mean squared CIEDE2000 is about d M d.

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
