"""What V^3 adds to the loss of pictures: the residual of a frame to the one before is small and cheap to code.

N Gaussians, C channels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import torch

from airgs_codec.train.fit.parameters import Parameters

HELD = ("log_scales", "quaternions", "opacity_logits")  # what both losses hold
CODES = 255  # steps of an 8-bit picture


@dataclass(slots=True, eq=False)
class ResidualLoss:
    """weight * mean squared residual + weight * estimated bits of a sample of the quantised residual."""

    before: Parameters
    temporal: float
    entropy: float
    seed: int  # of the noise
    _shown: dict[str, torch.Tensor] = field(init=False)  # (N, C) as the codec codes it
    _steps: dict[str, torch.Tensor] = field(init=False)  # (C,) of the codec
    _noise: torch.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._shown = {name: coded_domain(name, self.before[name]) for name in HELD}
        spans = {name: values.amax(dim=0) - values.amin(dim=0) for name, values in self._shown.items()}
        self._steps = {n: torch.where(span > 0, span, torch.ones_like(span)) / CODES for n, span in spans.items()}
        self._noise = torch.Generator().manual_seed(self.seed)

    def __call__(self, residual: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """The loss of a residual (N, ...) of every attribute, in stored domain."""
        total = self.temporal * torch.stack([residual[name].square().mean() for name in HELD]).sum()
        if not self.entropy:
            return total
        codes = torch.cat([self._codes(name, residual[name]) for name in HELD], dim=1)
        noise = torch.rand(codes.shape, generator=self._noise) - 0.5
        return total + self.entropy * estimated_bits(codes + noise)

    def _codes(self, name: str, residual: torch.Tensor) -> torch.Tensor:
        now = coded_domain(name, self.before[name] + residual)
        return (now - self._shown[name]) / self._steps[name]


def coded_domain(name: str, values: torch.Tensor) -> torch.Tensor:
    """(N, C) values of an attribute as V^3 codes them: scales and opacities activated."""
    values = values.reshape(len(values), -1)
    return values.exp() if name == "log_scales" else values.sigmoid() if name == "opacity_logits" else values


def estimated_bits(samples: torch.Tensor) -> torch.Tensor:
    """Bits of a sample, mean over rows, summed over channels, of samples (N, C) that noise stands for rounding in.

    Each channel has a normal distribution with the mean mu and the deviation sigma of its N samples; a sample x takes
    -log2 (Phi((x + 1/2 - mu) / sigma) - Phi((x - 1/2 - mu) / sigma)). Computed from logarithms of Phi in the lower
    tail, where their difference does not cancel.
    """
    mean = samples.mean(dim=0)
    deviation = (samples.var(dim=0, correction=0) + 1e-6).sqrt()  # of one row it is 0, and 0 / 0 follows
    below = -(samples - mean).abs() / deviation
    half = 0.5 / deviation
    upper, lower = torch.special.log_ndtr(below + half), torch.special.log_ndtr(below - half)
    nats = -(upper + torch.log(-torch.expm1(lower - upper)))
    return nats.mean(dim=0).sum() / math.log(2)
