"""What the differentiable renderers share: their arguments, and absolute gradients for densification.

N Gaussians, K SH coefficients past DC.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch

Background = tuple[float, float, float]  # r, g, b, 0..1


class RasterInputs(NamedTuple):
    """Activated Gaussians as tensors of one device and precision."""

    means: torch.Tensor  # (N, 3) world units
    quaternions: torch.Tensor  # (N, 4) w, x, y, z of any length
    scales: torch.Tensor  # (N, 3) world units
    opacities: torch.Tensor  # (N,) 0..1
    sh: torch.Tensor  # (N, K + 1, 3)


def _before_backward() -> tuple[torch.Tensor, torch.Tensor]:
    raise RuntimeError("absolute gradients are known after the backward pass of the picture")


@dataclass(slots=True, eq=False)
class AbsGrad:
    """Absolute gradients of one picture by the places of its Gaussians (AbsGS, Ye et al. 2024).

    The gradients of single pixels are summed by their absolute values, so that opposite ones do not cancel. A renderer
    that is given one sets `read`.
    """

    # () -> (N,) |dL / d(place in pixels)|, and (N,) whether the Gaussian is in the picture; after the backward pass
    read: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _before_backward
