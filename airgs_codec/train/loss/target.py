"""What a rendered picture is compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec.train.loss import kernels as kernels

Exposure = Mapping[str, Sequence[float]]  # camera -> gains r g b, offsets r g b


class Target:
    """A picture to be matched, with what the loss needs of it computed once."""

    def __init__(self, rgb: NDArray[np.float32]) -> None:
        """`rgb` (H, W, 3) of [0, 1]."""
        self.rgb = np.ascontiguousarray(rgb, np.float32)
        height, width, _ = self.rgb.shape
        self.rows = self.rgb.reshape(height, 3 * width)
        self.mean, self.variance = np.empty_like(self.rows), np.empty_like(self.rows)
        kernels.window_moments(self.rows, self.mean, self.variance)

    @property
    def nbytes(self) -> int:
        """Memory it holds."""
        return 3 * self.rgb.nbytes


def exposed_alike(picture: NDArray[np.float32], values: Sequence[float]) -> NDArray[np.float32]:
    """The picture (H, W, 3) as the average camera would have exposed it; may leave [0, 1]."""
    gains, offsets = np.array(values, np.float32).reshape(2, 3)
    return (picture - offsets) / gains
