"""What both differentiable renderers share: the background of a picture, and absolute gradients for densification."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

Background = tuple[float, float, float]  # r, g, b of [0, 1]


def _nothing() -> tuple[torch.Tensor, torch.Tensor]:
    raise RuntimeError("the pull of a picture is known after its backward pass")


@dataclass(slots=True, eq=False)
class Pull:
    """How strongly pixels pull at each Gaussian's place in a picture; to be read after the backward pass.

    Absolute gradients of single pixels, summed (AbsGS): pulls in opposite directions do not cancel.
    """

    # (N,) |dL / d(pixel position)|, and (N,) whether the row is in the picture
    read: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _nothing
