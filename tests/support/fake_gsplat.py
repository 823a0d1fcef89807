"""A stand-in for gsplat 1.5.3 or 1.6: what the adapter calls, with gsplat's shapes, made by the CPU renderer.

C cameras, N Gaussians.
"""

import sys
import types
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import _disable_current_modes

from airgs_codec.render import cpu, cuda
from airgs_codec.render.reference import sh_values
from tests.faces import SH_C0, Camera


class Kernel(torch.autograd.Function):
    """A function as one operator, with gradients, none of whose own operators is counted."""

    @staticmethod
    def forward(ctx: Any, function: Any, *tensors: torch.Tensor) -> Any:
        with _disable_current_modes(), torch.enable_grad():
            ctx.given = [t.detach().requires_grad_() for t in tensors]
            ctx.made = function(*ctx.given)
        return tuple(t.detach() for t in ctx.made)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> Any:
        with _disable_current_modes():
            return None, *torch.autograd.grad(ctx.made, ctx.given, grads)


def spherical_harmonics(degree: int, dirs: torch.Tensor, coeffs: torch.Tensor, masks: torch.Tensor) -> torch.Tensor:
    """gsplat's: (C, N, 3) of directions of any length and (C, N, K, 3), 0 where it is masked."""
    assert coeffs.shape[:2] == masks.shape == dirs.shape[:2] and (degree + 1) ** 2 == coeffs.shape[2]
    unit = torch.nn.functional.normalize
    return Kernel.apply(lambda to, sh: (sh_values(unit(to, dim=-1), sh) * masks[..., None],), dirs, coeffs)[0]


def spherical_harmonics_of_views(
    degree: int, means: torch.Tensor, viewmats: torch.Tensor, coeffs: torch.Tensor
) -> torch.Tensor:
    """gsplat 1.6's, of means (N, 3), matrices (C, 4, 4) and coefficients (N, K, 3)."""
    towards = means - torch.linalg.inv(viewmats.detach())[:, None, :3, 3]
    sh = coeffs.expand(len(viewmats), -1, -1, -1)
    return spherical_harmonics(degree, towards, sh, torch.ones(towards.shape[:2], dtype=torch.bool))


def rasterization(
    *tensors: Any, near_plane: float, far_plane: float, eps2d: float, packed: bool, backgrounds: Any, absgrad: bool
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """gsplat's: (C, H, W, 3), (C, H, W, 1) and its meta; without absolute gradients."""
    *inputs, views, lenses, width, height = tensors
    count, colors = len(views), inputs[4]
    assert views.shape == (count, 4, 4) and lenses.shape == (count, 3, 3) and backgrounds.shape == (count, 3)
    assert colors.shape == (count, len(inputs[0]), 3) and inputs[3].shape == (len(inputs[0]),) and not packed
    assert (far_plane, eps2d, absgrad) == (cpu.FAR_PLANE, cpu.DILATION, False)

    def draw(*inputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        pictures = []
        for view, k, behind, colour in zip(views.numpy(), lenses.numpy(), backgrounds.tolist(), inputs[4], strict=True):
            lens = (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), view.astype(np.float64))
            camera = Camera("", width, height, *lens, near=near_plane, background=tuple(behind))
            pictures.append(cuda._Rasterize.apply(*inputs[:4], ((colour - 0.5) / SH_C0)[:, None], [camera], None, None))
        rgb, transmittance = (torch.cat(parts) for parts in zip(*pictures, strict=True))
        return rgb, 1 - transmittance[..., None]

    return *Kernel.apply(draw, *inputs), {}


def install(monkeypatch: pytest.MonkeyPatch, version: str = "1.5.3") -> None:
    """Make it what `import gsplat` finds, and tensors of the CPU what it draws, until the test ends."""
    module: Any = types.ModuleType("gsplat")
    module.rasterization, module.spherical_harmonics = rasterization, spherical_harmonics
    if version == "1.6":
        module.spherical_harmonics, module.spherical_harmonics_l0 = spherical_harmonics_of_views, None
    monkeypatch.setitem(sys.modules, "gsplat", module)
    monkeypatch.setattr(cuda, "by_gsplat", lambda tensor: True)
