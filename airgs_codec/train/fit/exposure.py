"""Exposure and white balance of real cameras: a gain and an offset for each camera and colour. V views.

Cameras that see one wall differently bright are otherwise explained by haze in front of them. The mean over cameras is
the identity, so that a camera nobody trained on is rendered as the average one; or that of a reference camera is, whose
look the Gaussians then have.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from airgs_codec.train.fit.adam import BETAS

RATE = 2e-3  # learning rate


class ExposureModel:
    """Gains and offsets of V cameras, fitted beside the Gaussians."""

    def __init__(self, views: int, device: str, reference: int | None = None) -> None:
        """The identity for every camera. `reference`: the view whose camera keeps it; None: the average camera does."""
        self._reference = reference
        self._logs = torch.zeros(views, 3, device=device, requires_grad=True)
        self._offsets = torch.zeros(views, 3, device=device, requires_grad=True)
        self._adam = torch.optim.Adam([self._logs, self._offsets], lr=RATE, betas=BETAS)

    def apply(self, rgb: torch.Tensor, view: int) -> torch.Tensor:
        """The rendered picture (H, W, 3) as the camera of that view would have exposed it."""
        gains, offsets = self._tables()
        return rgb * gains[view] + offsets[view]

    def step(self) -> None:
        """Move along the gradients, by Adam."""
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def table(self, names: Sequence[str]) -> dict[str, list[float]]:
        """Gains r, g, b and offsets r, g, b by the names of the cameras, rounded to 5 digits."""
        gains, offsets = (t.detach().cpu().numpy() for t in self._tables())
        rows = np.concatenate([gains, offsets], axis=1)
        return {name: [round(float(v), 5) for v in row] for name, row in zip(names, rows, strict=True)}

    def _tables(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Gains and offsets, (V, 3) each."""
        own = slice(None) if self._reference is None else slice(self._reference, self._reference + 1)
        logs, offsets = (t - t[own].mean(dim=0, keepdim=True) for t in (self._logs, self._offsets))
        return logs.exp(), offsets
