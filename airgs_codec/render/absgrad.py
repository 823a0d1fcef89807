"""Gradients by places in pictures, by which densification finds where Gaussians are missing. N Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch


def _before_backward() -> tuple[torch.Tensor, torch.Tensor]:
    raise RuntimeError("gradients by places are known after the backward pass of the picture")


@dataclass(slots=True, eq=False)
class AbsGrad:
    """Absolute gradients of one picture or several by the places of their Gaussians (AbsGS, Ye et al. 2024).

    The gradients of single pixels are summed by their absolute values, so that opposite ones do not cancel. A renderer
    that is given one sets `read` and `signed`.
    """

    # () -> (N,) |dL / d(place in pixels)| summed over pictures, and (N,) in how many of them the Gaussian is; after the
    # backward pass
    read: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _before_backward
    # The same as 3DGS has it (Kerbl et al. 2023): with the signs of single pixels, by places that are -1..1 across the
    # picture.
    signed: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _before_backward

    def collect(self, parts: Sequence[AbsGrad]) -> None:
        """Become the sum of those of several pictures, which may not be known yet."""

        self.read = lambda: _summed([part.read() for part in parts])
        self.signed = lambda: _summed([part.signed() for part in parts])


def _summed(parts: Sequence[tuple[torch.Tensor, torch.Tensor]]) -> tuple[torch.Tensor, torch.Tensor]:
    gradients, seen = zip(*parts, strict=True)
    return torch.stack(gradients).sum(dim=0), torch.stack(seen).sum(dim=0)
