"""What every renderer takes: activated Gaussians, as numpy arrays or torch tensors.

N Gaussians, K = (degree + 1)^2 - 1 SH coefficients past DC.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, NamedTuple, Protocol, TypeVar


class Shaped(Protocol):
    """A numpy array or a torch tensor."""

    @property
    def shape(self) -> Sequence[int]:
        """The length of each axis."""


Array = TypeVar("Array", bound=Shaped)


class RasterInputs(NamedTuple, Generic[Array]):
    """Activated Gaussians, of one precision and device; or the derivatives of a loss by them."""

    means: Array  # (N, 3) world units
    quaternions: Array  # (N, 4) w, x, y, z of any length
    scales: Array  # (N, 3) world units
    opacities: Array  # (N,) 0..1
    sh: Array  # (N, K + 1, 3)

    @property
    def sh_degree(self) -> int:
        """The degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1
