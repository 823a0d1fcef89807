"""Absolute gradients, by which densification finds where Gaussians are missing. N Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch


def _before_backward() -> tuple[torch.Tensor, torch.Tensor]:
    raise RuntimeError("absolute gradients are known after the backward pass of the picture")


def _not_signed() -> tuple[torch.Tensor, torch.Tensor]:
    raise RuntimeError("signed gradients are known after the backward pass of one picture on the CPU")


@dataclass(slots=True, eq=False)
class AbsGrad:
    """Absolute gradients of one picture or several by the places of their Gaussians (AbsGS, Ye et al. 2024).

    The gradients of single pixels are summed by their absolute values, so that opposite ones do not cancel. A renderer
    that is given one sets `read`.
    """

    # () -> (N,) |dL / d(place in pixels)| summed over pictures, and (N,) in how many of them the Gaussian is; after the
    # backward pass
    read: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _before_backward
    # The same as 3DGS has it (Kerbl et al. 2023): with the signs of single pixels, by places that are -1..1 across the
    # picture. Of one picture, on the CPU.
    signed: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _not_signed

    def collect(self, parts: Sequence[AbsGrad]) -> None:
        """Become the sum of those of several pictures, which may not be known yet."""

        def read() -> tuple[torch.Tensor, torch.Tensor]:
            gradients, seen = zip(*(part.read() for part in parts), strict=True)
            return torch.stack(gradients).sum(dim=0), torch.stack(seen).sum(dim=0)

        self.read = read
