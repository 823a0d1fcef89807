"""Gaussians as torch tensors in stored domain, the way to and from them, and Adam for them, whose rows may come and go.

N Gaussians, K SH coefficients past DC. Names are those of `Gaussians`, the paper's six attributes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render.backend import Loaded, Renderer
from airgs_codec.render.cpu import RasterInputs, Redraw
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.render.differentiable import Picture, rasterize_views
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.frames import QUATERNION_MIN_NORM
from airgs_codec.scene.gaussians import SH_REST, Gaussians
from airgs_codec.trainer.data.pictures import View

ATTRIBUTES = tuple(f.name for f in fields(Gaussians))
Parameters = dict[str, torch.Tensor]  # attribute -> (N, ...)
# Quaternions of other lengths are made unit ones before a fit: Adam's steps have one size, by which a short quaternion
# would be thrown about and a long one could not turn.
LENGTHS = (0.1, 10.0)


@dataclass(frozen=True, slots=True, eq=False)
class InMotion:
    gaussians: Gaussians
    velocity: NDArray[np.float32] | None = None  # (N, 3) what means move by in a frame; None: not known
    cleared: int = 0  # rows of its fit that hung in open space and were removed

    def at(self, after: float) -> Gaussians:
        """So many frames after their time; where they are, where their velocity is not known."""
        if not after or self.velocity is None:
            return self.gaussians
        return replace(self.gaussians, means=self.gaussians.means + np.float32(after) * self.velocity)


def loading(g: Gaussians | InMotion, renderer: Renderer) -> Callable[[float], Loaded]:
    """What gives Gaussians so many frames after their time, ready to be drawn; each is loaded once."""
    return cache(lambda after: renderer.load(g.at(after) if isinstance(g, InMotion) else g))


def from_gaussians(g: Gaussians, device: str = "cpu") -> Parameters:
    """Copies on a device; quaternions whose length is not within LENGTHS get length 1, unless they stand for none."""
    columns = {name: getattr(g, name) for name in ATTRIBUTES} | {"quaternions": _of_usual_length(g.quaternions)}
    return {name: torch.tensor(column, device=device) for name, column in columns.items()}


def _of_usual_length(quaternions: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 4) quaternions; those shorter than QUATERNION_MIN_NORM, which are drawn as the identity, stay."""
    length = np.linalg.norm(quaternions.astype(np.float64), axis=1, keepdims=True)
    usual = ((length >= LENGTHS[0]) & (length <= LENGTHS[1])) | ~(length > QUATERNION_MIN_NORM)
    return np.where(usual, quaternions, quaternions / np.where(usual, 1.0, length)).astype(np.float32)


def to_gaussians(p: Mapping[str, torch.Tensor]) -> Gaussians:
    return Gaussians(*(p[name].detach().cpu().numpy().astype(np.float32) for name in ATTRIBUTES))


def multiply(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """The Hamilton product of quaternions (N, 4)."""
    aw, av, bw, bv = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    vector = aw * bv + bw * av + torch.linalg.cross(av, bv)
    return torch.cat([aw * bw - (av * bv).sum(dim=1, keepdim=True), vector], dim=1)


def rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Vectors (N, 3) turned by unit quaternions (N, 4)."""
    turned = 2 * torch.linalg.cross(q[:, 1:], v)
    return v + q[:, :1] * turned + torch.linalg.cross(q[:, 1:], turned)


MOTION = "motion"  # beside the attributes, (N, 3): what means move by in a frame


def with_motion(p: Parameters, views: Sequence[View], motion: NDArray[np.float32] | None = None) -> Parameters:
    """Parameters that have a motion as well, where views show them at other times; None: 0."""
    if not any(view.after for view in views):
        return p
    start = torch.zeros_like(p["means"]) if motion is None else torch.from_numpy(motion).to(p["means"])
    return p | {MOTION: start}


def to_moving(p: Parameters) -> InMotion:
    """Copies in float32, with the motion where there is one."""
    motion = p.get(MOTION)
    return InMotion(to_gaussians(p), None if motion is None else motion.cpu().numpy().astype(np.float32))


def zeros_like(p: Mapping[str, torch.Tensor]) -> Parameters:
    return {name: torch.zeros_like(value) for name, value in p.items()}


def take_and_append(
    old: Mapping[str, torch.Tensor], keep: torch.Tensor, new: Mapping[str, torch.Tensor] | None
) -> Parameters:
    """The rows of `old` in the mask `keep` (N,), in order, and the rows of `new` after them."""
    return {n: v[keep] if new is None else torch.cat([v[keep], new[n]]) for n, v in old.items()}


def render(p: Mapping[str, torch.Tensor], camera: Camera, sh_degree: int, absgrad: AbsGrad | None = None) -> Picture:
    """The picture (H, W, 3) and its transmittance (H, W), differentiable, with SH up to `sh_degree`."""
    return rasterize_views(_activated(p, sh_degree), [camera], absgrad)[0]


def render_views(
    p: Mapping[str, torch.Tensor],
    cameras: Sequence[Camera],
    sh_degree: int,
    absgrad: AbsGrad | None = None,
    redraws: Sequence[Redraw | None] | None = None,
) -> list[Picture]:
    """The same for each of several cameras; `redraws`: one for each, as in `rasterize`."""
    return rasterize_views(_activated(p, sh_degree), cameras, absgrad, redraws)


def _activated(p: Mapping[str, torch.Tensor], sh_degree: int) -> RasterInputs[torch.Tensor]:
    sh = torch.cat([p["sh_dc"][:, None], p["sh_rest"][:, : SH_REST[sh_degree]]], dim=1)
    return RasterInputs(p["means"], p["quaternions"], p["log_scales"].exp(), p["opacity_logits"].sigmoid(), sh)


BETAS = (0.9, 0.999)
# Adam divides by the size of the gradient: without a floor it would move attributes that pictures do not depend on
# (the rotation of a ball) as far as others, by rounding noise. Gradients of pictures are 1e-8 and more.
EPSILON = 1e-12


class Adam:
    """Adam (Kingma and Ba 2015) over named tensors whose rows may come and go."""

    def __init__(self, parameters: Mapping[str, torch.Tensor], rates: Mapping[str, float]) -> None:
        """`parameters` are copied and made leaves; `rates` may be changed between steps through `self.rates`."""
        self.parameters = _leaves({name: p.detach().clone() for name, p in parameters.items()})
        self.rates = dict(rates)
        self._first, self._second = zeros_like(parameters), zeros_like(parameters)  # moments
        self._steps = 0

    @torch.no_grad()
    def step(self, shrink: Mapping[str, torch.Tensor] | None = None) -> None:
        """One step along the gradients, which are cleared.

        `shrink`: weights of an L1 norm of the parameters, in units of the loss, applied by its proximal map in Adam's
        metric: what the pictures do not hold at another value ends at exactly 0.
        """
        self._steps += 1
        bias = [1 - beta**self._steps for beta in BETAS]
        for name, p in self.parameters.items():
            if p.grad is None:
                continue
            first, second = self._first[name], self._second[name]
            first.lerp_(p.grad, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(p.grad, p.grad, value=1 - BETAS[1])
            scale = (second / bias[1]).sqrt_().add_(EPSILON)
            p.addcdiv_(first, scale, value=-self.rates[name] / bias[0])
            if shrink and name in shrink:
                threshold = self.rates[name] * shrink[name] / scale
                p.copy_(p.sign() * (p.abs() - threshold).clamp_min(0))
            p.grad = None

    def replace_values(self, name: str, values: torch.Tensor) -> None:
        """Give a parameter other values; its moments start at 0 again."""
        self.parameters[name] = values.detach().clone().requires_grad_(True)
        for moments in (self._first, self._second):
            moments[name] = torch.zeros_like(values)

    def replace_rows(self, keep: torch.Tensor, added: Mapping[str, torch.Tensor] | None = None) -> None:
        """Keep the rows of a mask (N,), in order, and append new ones, whose moments start at 0."""
        detached = {name: p.detach() for name, p in self.parameters.items()}
        self.parameters = _leaves(take_and_append(detached, keep, added))
        zeros = None if added is None else zeros_like(added)
        self._first, self._second = (take_and_append(m, keep, zeros) for m in (self._first, self._second))


def _leaves(parameters: Parameters) -> Parameters:
    return {name: p.requires_grad_(True) for name, p in parameters.items()}
