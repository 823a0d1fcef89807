"""The renderer as a torch function with gradients: the CPU kernels, or gsplat for tensors on a CUDA device."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from airgs_codec.render import cpu
from airgs_codec.render.absgrad import Background, Pull
from airgs_codec.scene.camera import Camera


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, torch.Tensor]:
        *tensors, camera, background, pull = inputs
        columns = [np.ascontiguousarray(t.detach().numpy(), np.float32) for t in tensors]
        ctx.activated = cpu.Activated(*columns)
        ctx.camera, ctx.pull = camera, pull
        ctx.blended = cpu.blend(ctx.activated, camera, background)
        picture = ctx.blended.picture
        return torch.from_numpy(picture.rgb), torch.from_numpy(picture.transmittance)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        rgb, transmittance = (np.ascontiguousarray(g.numpy(), np.float32) for g in grads)
        columns, pulled = cpu.gradients_and_pull(ctx.activated, ctx.camera, ctx.blended, rgb, transmittance)
        if ctx.pull is not None:
            seen = np.zeros(len(pulled), bool)
            seen[ctx.blended.order] = True
            result = torch.from_numpy(np.hypot(pulled[:, 0], pulled[:, 1])), torch.from_numpy(seen)
            ctx.pull.read = lambda: result
        return (*(torch.from_numpy(c) for c in columns), None, None, None)


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    sh: torch.Tensor,
    camera: Camera,
    background: Background = (0.0, 0.0, 0.0),
    pull: Pull | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Differentiable picture: rgb (H, W, 3) and transmittance (H, W), float32, on the device of the tensors.

    means (N, 3), quaternions (N, 4) of any length, scales (N, 3) and opacities (N,) activated, sh (N, K + 1, 3).
    `pull` is filled by the backward pass.
    """
    if means.is_cuda:
        from airgs_codec.render import cuda  # gsplat compiles its kernels when it is first imported

        return cuda.rasterize(means, quaternions, scales, opacities, sh, camera, background, pull)
    return _Rasterize.apply(means, quaternions, scales, opacities, sh, camera, background, pull)
