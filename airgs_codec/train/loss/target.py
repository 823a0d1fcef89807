"""The picture that a rendered one is compared with. H x W pixels, n = 3 W interleaved samples a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.camera import Background
from airgs_codec.train.loss import kernels

Exposure = Mapping[str, Sequence[float]]  # camera -> gains r, g, b and offsets r, g, b


class Target:
    """A picture to be matched, and its windowed mean and variance (H, n) for SSIM."""

    def __init__(self, rgb: NDArray[np.float32], clear: NDArray[np.float32] | None = None) -> None:
        """`rgb`: (H, W, 3), 0..1. `clear`: (H, W) share of the background in it; None: not known."""
        self.rgb = np.ascontiguousarray(rgb, np.float32)
        self.clear = clear
        height, width, _ = self.rgb.shape
        self.rows = self.rgb.reshape(height, 3 * width)
        self.mean, self.variance = np.empty_like(self.rows), np.empty_like(self.rows)
        kernels.window_moments(self.rows, self.mean, self.variance)

    def before(self, there: Background, now: Background) -> Target:
        """The picture before the background `now` instead of the one that is there. Raises ValueError without alpha."""
        if self.clear is None:
            raise ValueError("expected a picture whose background is known")
        change = np.subtract(now, there).astype(np.float32)
        return Target(self.rgb + self.clear[..., None] * change, self.clear)

    @property
    def nbytes(self) -> int:
        """Memory that its arrays hold, in bytes."""
        return 3 * self.rgb.nbytes + (0 if self.clear is None else self.clear.nbytes)


def exposed_alike(picture: NDArray[np.float32], values: Sequence[float]) -> NDArray[np.float32]:
    """The picture (H, W, 3) as the average camera would have exposed it; colours may leave 0..1.

    `values`: gains and offsets of the camera that took it, as in `Exposure`.
    """
    gains, offsets = np.array(values, np.float32).reshape(2, 3)
    return (picture - offsets) / gains
