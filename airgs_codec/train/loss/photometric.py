"""L_3DGS = (1 - lambda) L1 + lambda (1 - SSIM) of pictures (H, W, 3), and its gradient (AirGS, "Representation").

On the CPU one fused pass (`kernels`); on CUDA the same numbers from separable convolutions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render.cuda import upload
from airgs_codec.train.loss import kernels
from airgs_codec.train.loss.target import Target

LAMBDA = 0.2  # weight of 1 - SSIM, as AirGS and 3DGS have it


@dataclass(frozen=True, slots=True)
class Comparison:
    """How a rendered picture compares with its target."""

    loss: torch.Tensor  # scalar, differentiable
    _mse: Callable[[], float]
    _ssim: Callable[[], float]

    @property
    def mse(self) -> float:
        """Mean squared error of samples that are not clipped to 0..1; computed when it is asked for."""
        return self._mse()

    @property
    def ssim(self) -> float:
        """Mean over samples, pictures being zero outside."""
        return self._ssim()


def photometric(rgb: torch.Tensor, target: Target, weight: float = LAMBDA) -> Comparison:
    """Compare a rendered picture (H, W, 3) with its target; `weight` is lambda."""
    if rgb.is_cuda:
        return _on_cuda(rgb, target, weight)
    sums: list[float] = []
    loss = _Fused.apply(rgb, target, weight, sums)
    return Comparison(loss, lambda: sums[2], lambda: sums[1])


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rgb: torch.Tensor, target: Target, weight: float, out: list[float]) -> torch.Tensor:
        rows = np.ascontiguousarray(rgb.detach().numpy(), np.float32).reshape(target.rows.shape)
        gradient = np.empty_like(rows)
        sums = np.empty((len(rows), 3))
        scratch = _scratch(rows.shape)
        arguments = (1 - weight, weight, *scratch, gradient, sums)
        kernels.l1_dssim(rows, target.rows, *target.moments, *arguments)
        l1, ssim, square = sums.sum(axis=0) / rows.size
        out += [float(l1), float(ssim), float(square)]
        ctx.gradient = torch.from_numpy(gradient.reshape(rgb.shape))
        return torch.tensor((1 - weight) * l1 + weight * (1 - ssim), dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        return ctx.gradient * grads[0], None, None, None


_SCRATCH: dict[tuple[int, ...], tuple[NDArray[np.float32], NDArray[np.float32]]] = {}


def _scratch(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    if shape not in _SCRATCH:
        padded = (3, shape[0] + 2 * kernels.RADIUS, shape[1])
        _SCRATCH[shape] = (np.zeros(padded, np.float32), np.zeros(padded, np.float32))
    return _SCRATCH[shape]


def _on_cuda(rgb: torch.Tensor, target: Target, weight: float) -> Comparison:
    """Nothing here waits for the device."""
    if target.on_device is None:
        target.on_device = upload(target.rgb, rgb.device)
    truth = target.on_device
    similarity = windowed_ssim(rgb, truth)
    loss = (1 - weight) * (rgb - truth).abs().mean() + weight * (1 - similarity)
    return Comparison(loss, lambda: float((rgb.detach() - truth).square().mean()), lambda: float(similarity.detach()))


def windowed_ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean SSIM (Wang et al. 2004) of pictures (H, W, 3) that are zero outside, on any device in any precision."""
    half = [kernels.W0, kernels.W1, kernels.W2, kernels.W3, kernels.W4]
    window = upload([*half, kernels.W5, *half[::-1]], a.device).to(a.dtype)

    def blur(x: torch.Tensor) -> torch.Tensor:
        x = x.permute(2, 0, 1)[:, None]
        x = torch.nn.functional.conv2d(x, window.reshape(1, 1, 1, -1), padding=(0, kernels.RADIUS))
        return torch.nn.functional.conv2d(x, window.reshape(1, 1, -1, 1), padding=(kernels.RADIUS, 0))[:, 0]

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b, covariance = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2, blur(a * b) - mean_a * mean_b
    c1, c2 = float(kernels.C1), float(kernels.C2)
    top = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    return (top / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))).mean()
