"""The CPU renderer as a torch function with gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from airgs_codec.render import cpu
from airgs_codec.render.camera import Camera


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, torch.Tensor]:
        *tensors, camera, background = inputs
        columns = [np.ascontiguousarray(t.detach().numpy(), np.float32) for t in tensors]
        ctx.activated = cpu.Activated(*columns)
        ctx.camera = camera
        ctx.blended = cpu.blend(ctx.activated, camera, background)
        picture = ctx.blended.picture
        return torch.from_numpy(picture.rgb), torch.from_numpy(picture.transmittance)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        columns = cpu.gradients(
            ctx.activated,
            ctx.camera,
            ctx.blended,
            np.ascontiguousarray(grads[0].numpy(), np.float32),
            np.ascontiguousarray(grads[1].numpy(), np.float32),
        )
        return (*(torch.from_numpy(c) for c in columns), None, None)


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    sh: torch.Tensor,
    camera: Camera,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[torch.Tensor, torch.Tensor]:
    """Differentiable picture: rgb (H, W, 3) and transmittance (H, W), float32.

    means (N, 3), quaternions (N, 4) of any length, scales (N, 3) and opacities (N,) activated, sh (N, K + 1, 3).
    """
    return _Rasterize.apply(means, quaternions, scales, opacities, sh, camera, background)
