"""How much pictures differ: mean squared error, PSNR, SSIM and CIEDE2000, of one picture and of many together.

Pictures are (H, W, 3) float32 sRGB. OpenCV is loaded to compare pictures, not for figures alone. Colour differences are
worked out here and tested against colour-science, whose import takes a second of a core.
"""

from __future__ import annotations

import math
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
_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])  # IEC 61966-2-1
_WHITE = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])  # D65, XYZ


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
    """Return (..., 3) sRGB colours as CIE 1976 L*a*b*, with the white of D65."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0) + 0.055) / 1.055) ** 2.4)
    t = linear @ _TO_XYZ.T / _WHITE
    x, y, z = np.moveaxis(np.where(t > (24 / 116) ** 3, np.cbrt(t), 841 / 108 * t + 16 / 116), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def delta_e(reference: NDArray[np.float64], shown: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (...) CIEDE2000 of (..., 3) Lab colours (Sharma et al. 2005, equations 2 to 22)."""
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(reference, -1, 0), np.moveaxis(shown, -1, 0)
    stretch = 1.5 - 0.5 * _grey_share((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2)
    c1, c2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = (np.arctan2(b, stretch * a) % math.tau for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + math.pi) % math.tau - math.pi
    turn = np.where(turn == -math.pi, h2 - h1, turn)  # opposite hues: in the direction of the paper
    hue, chroma, light = (h1 + turn / 2) % math.tau, (c1 + c2) / 2, ((l1 + l2) / 2 - 50) ** 2
    hue = np.where(c1 * c2 == 0, h1 + h2, hue)  # that of grey is 0
    weight = 1 - 0.17 * np.cos(hue - math.radians(30)) + 0.24 * np.cos(2 * hue)
    weight += 0.32 * np.cos(3 * hue + math.radians(6)) - 0.20 * np.cos(4 * hue - math.radians(63))
    rotation = math.radians(60) * np.exp(-(((np.degrees(hue) - 275) / 25) ** 2))
    d_l = (l2 - l1) / (1 + 0.015 * light / np.sqrt(20 + light))
    d_c = (c2 - c1) / (1 + 0.045 * chroma)
    d_h = 2 * np.sqrt(c1 * c2) * np.sin(turn / 2) / (1 + 0.015 * chroma * weight)
    return np.sqrt(d_l**2 + d_c**2 + d_h**2 - 2 * _grey_share(chroma) * np.sin(rotation) * d_c * d_h)


def _grey_share(chroma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 0 for grey and nearly 1 for strong colours."""
    return np.sqrt(chroma**7 / (chroma**7 + 25.0**7))


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
