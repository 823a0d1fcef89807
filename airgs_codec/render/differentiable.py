"""The renderer as a torch function with gradients: the CPU kernels, or gsplat for tensors on a CUDA device.

C cameras, N Gaussians, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from airgs_codec.render import cpu, cuda
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.camera import Background, Camera

Picture = tuple[torch.Tensor, torch.Tensor]  # rgb (H, W, 3) and transmittance (H, W)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Picture:
        *tensors, camera, background, absgrad, redraw = inputs
        ctx.inputs = RasterInputs(*(np.ascontiguousarray(t.detach().numpy(), np.float32) for t in tensors))
        ctx.camera, ctx.absgrad = camera, absgrad
        ctx.blended = cpu.blend(ctx.inputs, camera, background, redraw)
        picture = ctx.blended.picture
        return torch.from_numpy(picture.rgb), torch.from_numpy(picture.transmittance)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        rgb, transmittance = (np.ascontiguousarray(g.numpy(), np.float32) for g in grads)
        gradients = cpu.gradients(ctx.inputs, ctx.camera, ctx.blended, rgb, transmittance)
        if ctx.absgrad is not None:
            seen = torch.zeros(len(gradients.places), dtype=torch.bool)
            seen[torch.from_numpy(ctx.blended.projected.order)] = True
            half = np.array([ctx.camera.width / 2, ctx.camera.height / 2], np.float32)
            absolute, signed = _lengths(gradients.absolute), _lengths(gradients.places * half)
            ctx.absgrad.read = lambda: (absolute, seen)
            ctx.absgrad.signed = lambda: (signed, seen)
        return (*(torch.from_numpy(column) for column in gradients.inputs), None, None, None, None)


def _lengths(vectors: cpu.Floats) -> torch.Tensor:
    return torch.from_numpy(np.hypot(vectors[:, 0], vectors[:, 1]))


def rasterize(
    inputs: RasterInputs[torch.Tensor],
    camera: Camera,
    background: Background | None = None,
    absgrad: AbsGrad | None = None,
    redraw: cpu.Redraw | None = None,
) -> Picture:
    """The picture (H, W, 3) and its transmittance (H, W), float32, differentiable, on the device of the inputs.

    `background`: None for the camera's. `absgrad` can be read after the backward pass. `redraw`: only its tiles are
    drawn and have gradients; gsplat draws all.
    """
    background = camera.background if background is None else background
    if inputs.means.is_cuda:
        drawn = cuda.rasterize(inputs, [camera], [background], absgrad)
        return drawn.rgb[0], drawn.transmittance[0]
    return _Rasterize.apply(*inputs, camera, background, absgrad, redraw)


def rasterize_views(
    inputs: RasterInputs[torch.Tensor],
    cameras: Sequence[Camera],
    absgrad: AbsGrad | None = None,
    redraws: Sequence[cpu.Redraw | None] | None = None,
) -> list[Picture]:
    """What several cameras see, each before its own background, as `rasterize` gives it; `redraws`: one for each.

    On CUDA cameras of one size and near plane are drawn at once. `absgrad` is that of all pictures together.
    """
    if inputs.means.is_cuda and len(cameras) > 1 and cuda.alike(cameras):
        drawn = cuda.rasterize(inputs, cameras, [camera.background for camera in cameras], absgrad)
        return list(zip(drawn.rgb, drawn.transmittance, strict=True))
    alone = absgrad is None or len(cameras) == 1
    parts = [absgrad if alone else AbsGrad() for _ in cameras]
    if absgrad is not None and not alone:
        absgrad.collect([part for part in parts if part is not None])
    each = zip(cameras, parts, redraws or [None] * len(cameras), strict=True)
    return [rasterize(inputs, camera, None, part, redraw) for camera, part, redraw in each]
