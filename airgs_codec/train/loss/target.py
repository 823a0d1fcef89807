"""The picture that a rendered one is compared with. H x W pixels, n = 3 W interleaved samples a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import to_floats
from airgs_codec.scene.camera import Background
from airgs_codec.train.loss import kernels

Exposure = Mapping[str, Sequence[float]]  # camera -> gains r, g, b and offsets r, g, b


class Target:
    """A picture to be matched."""

    def __init__(self, rgb: NDArray[np.float32], clear: NDArray[np.float32] | None = None) -> None:
        """`rgb`: (H, W, 3), 0..1. `clear`: (H, W) share of the background in it; None: not known."""
        self.rgb = np.ascontiguousarray(rgb, np.float32)
        self.clear = clear
        self.on_device: Any = None  # a tensor of `rgb`, where the loss is computed on a device

    @property
    def rows(self) -> NDArray[np.float32]:
        """The samples (H, n)."""
        return self.rgb.reshape(len(self.rgb), -1)

    @cached_property
    def moments(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Windowed mean and variance for SSIM, (H, n) each."""
        mean, variance = np.empty_like(self.rows), np.empty_like(self.rows)
        kernels.window_moments(self.rows, mean, variance)
        return mean, variance

    def before(self, there: Background, now: Background) -> Target:
        """The picture before the background `now` instead of the one that is there. Raises ValueError without alpha."""
        if self.clear is None:
            raise ValueError("expected a picture whose background is known")
        change = np.subtract(now, there).astype(np.float32)
        return Target(self.rgb + self.clear[..., None] * change, self.clear)

    @property
    def nbytes(self) -> int:
        """Memory that its arrays hold when the moments are known, in bytes."""
        return 3 * self.rgb.nbytes + (0 if self.clear is None else self.clear.nbytes)

    def target(self) -> Target:
        """Itself: a picture that is at hand."""
        return self

    def expect(self) -> None:
        """Nothing: it is at hand."""


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """A picture in 8 bits, 3 or 4 bytes a pixel, of which a target takes 36 or 40."""

    rgb: NDArray[np.uint8]  # (H, W, 3) before the background of the scene
    clear: NDArray[np.uint8] | None = None  # (H, W) share of the background in it; None: not known

    @property
    def nbytes(self) -> int:
        """Memory that its arrays hold, in bytes."""
        return self.rgb.nbytes + (0 if self.clear is None else self.clear.nbytes)

    def target(self, exposure: Sequence[float] | None) -> Target:
        """The picture in float32, as the average camera would have exposed it; None: exposed as it is."""
        rgb = to_floats(self.rgb)
        if exposure is not None:
            rgb = exposed_alike(rgb, exposure)
        return Target(rgb, None if self.clear is None else to_floats(self.clear))


def exposed_alike(picture: NDArray[np.float32], values: Sequence[float]) -> NDArray[np.float32]:
    """The picture (H, W, 3) as the average camera would have exposed it; colours may leave 0..1.

    `values`: gains and offsets of the camera that took it, as in `Exposure`.
    """
    gains, offsets = np.array(values, np.float32).reshape(2, 3)
    return (picture - offsets) / gains
