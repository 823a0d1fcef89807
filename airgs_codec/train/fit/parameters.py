"""Gaussians as torch parameters in stored domain, and the optimiser that can add and remove rows.

N Gaussians, K SH coefficients past DC. Names are those of `Gaussians`, the paper's six attributes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.render.absgrad import Pull
from airgs_codec.render.differentiable import rasterize
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import SH_C0, SH_REST, Gaussians

ATTRIBUTES = tuple(f.name for f in fields(Gaussians))
Parameters = dict[str, torch.Tensor]

# Adam's steps of 3DGS; means in units of the scene's extent.
RATES = {
    "means": 1.6e-4,
    "quaternions": 1e-3,
    "log_scales": 5e-3,
    "opacity_logits": 5e-2,
    "sh_dc": 2.5e-3,
    "sh_rest": 2.5e-3 / 20,
}
BETAS = (0.9, 0.999)
# Adam divides by the size of the gradient: without a floor it would move attributes that pictures do not depend on
# (the rotation of a ball) as far as others, by rounding noise. Gradients of pictures are 1e-8 and more.
EPSILON = 1e-12


def from_gaussians(g: Gaussians, device: str = "cpu") -> Parameters:
    """Copies, to be optimised."""
    return {name: torch.tensor(getattr(g, name), device=device) for name in ATTRIBUTES}


def to_gaussians(p: Mapping[str, torch.Tensor]) -> Gaussians:
    """Copies, in float32."""
    return Gaussians(*(p[name].detach().cpu().numpy().astype(np.float32) for name in ATTRIBUTES))


def from_points(
    positions: NDArray[np.float32], colours: NDArray[np.float32], sh_degree: int, opacity: float, largest: float
) -> Gaussians:
    """Balls at (P, 3) `positions` with RGB `colours`, each as large as its three nearest neighbours are far."""
    n = len(positions)
    near, _ = cKDTree(positions).query(positions, k=min(4, n))
    spacing = np.sqrt(np.square(near.reshape(n, -1)[:, 1:]).mean(axis=1)) if n > 1 else np.full(n, 0.01 * largest)
    radius = np.log(np.clip(spacing, 1e-4 * largest, largest))  # coincident points have no spacing to take
    return Gaussians(
        means=positions.astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.repeat(radius[:, None], 3, axis=1).astype(np.float32),
        opacity_logits=np.full(n, math.log(opacity / (1 - opacity)), np.float32),
        sh_dc=((colours - 0.5) / SH_C0).astype(np.float32),
        sh_rest=np.zeros((n, SH_REST[sh_degree], 3), np.float32),
    )


def render(
    p: Mapping[str, torch.Tensor], camera: Camera, sh_degree: int, pull: Pull | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Differentiable picture (H, W, 3) and transmittance (H, W) with SH up to `sh_degree`."""
    sh = torch.cat([p["sh_dc"][:, None], p["sh_rest"][:, : SH_REST[sh_degree]]], dim=1)
    activated = (p["means"], p["quaternions"], p["log_scales"].exp(), p["opacity_logits"].sigmoid(), sh)
    return rasterize(*activated, camera, pull=pull)


@dataclass(slots=True, eq=False)
class _Moments:
    first: torch.Tensor
    second: torch.Tensor


class Adam:
    """Adam (Kingma and Ba 2015) over named tensors whose rows may come and go."""

    def __init__(self, parameters: Parameters, rates: Mapping[str, float]) -> None:
        """`parameters` are made leaves; `rates` may be changed between steps through `self.rates`."""
        self.parameters = {name: p.detach().clone().requires_grad_(True) for name, p in parameters.items()}
        self.rates = dict(rates)
        self._moments = {n: _Moments(torch.zeros_like(p), torch.zeros_like(p)) for n, p in parameters.items()}
        self._steps = 0

    @torch.no_grad()
    def step(self, shrink: Mapping[str, torch.Tensor] | None = None) -> None:
        """One step along the gradients, which are cleared.

        `shrink`: weights of an L1 norm on the parameter, in units of the loss, applied by its proximal map in Adam's
        metric: what the pictures do not hold at another value ends at exactly 0.
        """
        self._steps += 1
        bias = [1 - beta**self._steps for beta in BETAS]
        for name, p in self.parameters.items():
            if p.grad is None:
                continue
            m = self._moments[name]
            m.first.lerp_(p.grad, 1 - BETAS[0])
            m.second.mul_(BETAS[1]).addcmul_(p.grad, p.grad, value=1 - BETAS[1])
            scale = (m.second / bias[1]).sqrt_().add_(EPSILON)
            p.addcdiv_(m.first, scale, value=-self.rates[name] / bias[0])
            if shrink and name in shrink:
                threshold = self.rates[name] * shrink[name] / scale
                p.copy_(p.sign() * (p.abs() - threshold).clamp_min(0))
            p.grad = None

    def replace_rows(self, keep: torch.Tensor, added: Mapping[str, torch.Tensor] | None = None) -> None:
        """Keep the rows of a mask, in order, and append new ones, whose moments start at 0."""

        def grown(old: torch.Tensor, new: torch.Tensor | None) -> torch.Tensor:
            return old[keep] if new is None else torch.cat([old[keep], new])

        for name, p in self.parameters.items():
            new = None if added is None else added[name]
            zeros = None if new is None else torch.zeros_like(new)
            self.parameters[name] = grown(p.detach(), new).requires_grad_(True)
            m = self._moments[name]
            self._moments[name] = _Moments(grown(m.first, zeros), grown(m.second, zeros))

    def detached(self) -> Parameters:
        """The parameters as they are now."""
        return {name: p.detach().clone() for name, p in self.parameters.items()}


Rate = Callable[[float], float]  # factor on a learning rate over the share of the run that is done


def decay(last: float) -> Rate:
    """Exponential, from 1 to `last`."""
    return lambda done: last**done
