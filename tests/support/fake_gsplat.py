"""A stand-in for gsplat 1.5.3 on the CPU: what the adapter calls, with gsplat's shapes, made by the CPU renderer.

C cameras, N Gaussians.
"""

import sys
import types
from typing import Any

import numpy as np
import pytest
import torch

from airgs_codec.render import cpu, cuda
from tests.faces import Camera, RasterInputs


def rasterization(
    *tensors: Any, near_plane: float, far_plane: float, eps2d: float, sh_degree: int, **more: Any
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """gsplat's: (C, H, W, 3), (C, H, W, 1) and its meta; without absolute gradients."""
    means, quats, scales, opacities, colors, views, lenses, width, height = tensors
    count, backgrounds = len(views), more["backgrounds"]
    assert views.shape == (count, 4, 4) and lenses.shape == (count, 3, 3) and backgrounds.shape == (count, 3)
    assert opacities.shape == (len(means),) and (sh_degree + 1) ** 2 <= colors.shape[1] and not more["packed"]
    assert (far_plane, eps2d, more["absgrad"]) == (cpu.FAR_PLANE, cpu.DILATION, False)
    inputs = RasterInputs(means, quats, scales, opacities, colors)
    pictures = []
    for view, k, behind in zip(views.numpy(), lenses.numpy(), backgrounds.tolist(), strict=True):
        lens = (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))
        camera = Camera("", width, height, *lens, view.astype(np.float64), near=near_plane)
        pictures.append(cuda._Rasterize.apply(*inputs, camera, tuple(behind), None, None))
    rgb, transmittance = (torch.stack(parts) for parts in zip(*pictures, strict=True))
    return rgb, 1 - transmittance[..., None], {}


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make it what `import gsplat` finds, until the test ends."""
    module: Any = types.ModuleType("gsplat")
    module.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)
