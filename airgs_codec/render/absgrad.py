"""Absolute gradients, by which densification finds where Gaussians are missing. N Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch


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
