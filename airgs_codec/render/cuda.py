"""gsplat behind the same function as the CPU renderer, for tensors on a CUDA device. Imported only where it is used.

gsplat 1.5 imports without its kernels and fails later, so they are looked for: `missing` says what is not there.
"""

from __future__ import annotations

from typing import Any

import torch

from airgs_codec.render.absgrad import AbsGrad
from airgs_codec.render.cpu import DILATION, FAR
from airgs_codec.render.inputs import RasterInputs
from airgs_codec.scene.camera import Background, Camera


def missing() -> str | None:
    """Why gsplat cannot run here; None if it can. Compiles its kernels where they are not compiled yet (minutes)."""
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    try:
        from gsplat.cuda import _backend
    except ImportError as error:
        return f"gsplat cannot be imported ({error}): pip install 'airgs-codec[cuda]'"
    if _backend._C is None:
        return "gsplat has no kernels: it needs the CUDA toolkit (nvcc) to compile them"
    return None


def rasterize(
    inputs: RasterInputs[torch.Tensor],
    camera: Camera,
    background: Background | None = None,
    absgrad: AbsGrad | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """As `differentiable.rasterize`. Pixels may differ by 5e-3 where alpha is next to 1/255, others by 1e-5."""
    from gsplat import rasterization

    def on_device(values: Any) -> torch.Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=inputs.means.device)

    matrix = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    rgb, alpha, meta = rasterization(
        *inputs,
        on_device(camera.world_to_camera)[None],
        on_device(matrix)[None],
        camera.width,
        camera.height,
        near_plane=camera.near,
        far_plane=FAR,
        eps2d=DILATION,
        sh_degree=inputs.sh_degree,
        packed=False,
        backgrounds=on_device(camera.background if background is None else background)[None],
        absgrad=absgrad is not None,
    )
    if absgrad is not None:  # gsplat leaves absolute gradients on its projected means once the gradient reaches them
        means2d, radii = meta["means2d"], meta["radii"]
        absgrad.read = lambda: (means2d.absgrad[0].norm(dim=-1), (radii[0] > 0).all(dim=-1))
    return rgb[0], 1 - alpha[0, ..., 0]
