"""Drawing with torch, with gradients: the CPU kernels, or gsplat 1.5 for tensors on a CUDA device.

gsplat imports without its kernels and fails later, so `missing` looks for them. It waits
for the device twice a call (an inverse of the cameras' matrices, the number of pairs), which several cameras share;
nothing else here waits. C cameras, N Gaussians, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from airgs_codec.render import cpu
from airgs_codec.render.cpu import DILATION, FAR_PLANE, Floats, Loaded, RasterInputs, Redraw, Render
from airgs_codec.scene.camera import Background, Camera

Picture = tuple[torch.Tensor, torch.Tensor]  # rgb (H, W, 3) and transmittance (H, W), of several cameras (C, H, W, …)


@dataclass(slots=True, eq=False)
class AbsGrad:
    """Gradients by the places of Gaussians in the pictures that were drawn with it, known after the backward pass."""

    # Of each picture or several: (N,) lengths of absolute gradients, of signed ones, and in how many pictures a row is.
    parts: list[Callable[[], tuple[torch.Tensor, torch.Tensor, torch.Tensor]]] = field(default_factory=list)

    def read(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (N,) |dL / d(place in pixels)|, summed over pictures, and (N,) in how many of them a Gaussian is.

        The gradients of single pixels are summed by their absolute values, so that opposite ones do not cancel (AbsGS,
        Ye et al. 2024). Raises RuntimeError before the backward pass.
        """
        return self._sum(0), self._sum(2)

    def signed(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the same as 3DGS has it (Kerbl et al. 2023).

        It sums with the signs of single pixels, by places that are -1..1 across the picture.
        """
        return self._sum(1), self._sum(2)

    def _sum(self, which: int) -> torch.Tensor:
        if not self.parts:
            raise RuntimeError("gradients by places are known after the backward pass of the picture")
        return torch.stack([part()[which] for part in self.parts]).sum(dim=0)


def missing() -> str | None:
    """Return why gsplat cannot run here; None if it can. Compiles its kernels where they are not yet (minutes).

    torch raises RuntimeError with all that a compiler says where it fails, and where ninja is not on the PATH.
    """
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    try:
        from gsplat.cuda import _backend
    except ImportError as error:
        return f"gsplat cannot be imported ({error}): pip install 'airgs-codec[cuda]'"
    except RuntimeError as error:
        return f"gsplat's kernels cannot be compiled: {str(error).splitlines()[0]}"
    if _backend._C is None:
        return "gsplat has no kernels: it needs the CUDA toolkit (nvcc) to compile them"
    return None


def upload(values: Any, device: torch.device | str) -> torch.Tensor:
    """Return a float32 tensor of an array or numbers on a device, without waiting for a CUDA device."""
    host = torch.tensor(np.asarray(values, np.float32))
    return host.pin_memory().to(device, non_blocking=True) if torch.device(device).type == "cuda" else host


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Picture:
        *tensors, camera, background, absgrad, redraw = inputs
        arrays = RasterInputs(*(np.ascontiguousarray(t.detach().numpy(), np.float32) for t in tensors))
        ctx.found, ctx.blended = [], cpu.blend(arrays, camera, background, redraw)
        picture, found = ctx.blended.picture, ctx.found
        if absgrad is not None:
            absgrad.parts.append(lambda: found[0])
        return torch.from_numpy(picture.rgb), torch.from_numpy(picture.transmittance)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        rgb, transmittance = (np.ascontiguousarray(g.numpy(), np.float32) for g in grads)
        by_inputs, places, absolute = cpu.gradients(ctx.blended, rgb, transmittance)
        seen = torch.zeros(len(places), dtype=torch.int64)
        seen[torch.from_numpy(ctx.blended.projected.order)] = 1
        half = np.array(ctx.blended.projected.size, np.float32) / 2
        lengths = (torch.from_numpy(np.hypot(x, y)) for x, y in (absolute.T, (places * half).T))
        ctx.found.append((*lengths, seen))
        return (*(torch.from_numpy(column) for column in by_inputs), None, None, None, None)


def rasterize_views(
    inputs: RasterInputs[torch.Tensor],
    cameras: Sequence[Camera],
    absgrad: AbsGrad | None = None,
    redraws: Sequence[Redraw | None] | None = None,
) -> list[Picture]:
    """Draw what several cameras see, each before its own background: float32, differentiable, on the inputs' device.

    On CUDA cameras of one size and near plane are drawn at once. `absgrad` can be read after the backward pass.
    `redraws`: one for each; only its tiles are drawn and have gradients (gsplat draws all).
    """
    if not inputs.means.is_cuda:
        each = zip(cameras, redraws or [None] * len(cameras), strict=True)
        return [_Rasterize.apply(*inputs, c, c.background, absgrad, redraw) for c, redraw in each]
    if not equal_shapes(cameras):
        return [rasterize_views(inputs, [camera], absgrad)[0] for camera in cameras]
    return list(zip(*rasterize(inputs, cameras, [camera.background for camera in cameras], absgrad), strict=True))


def equal_shapes(cameras: Sequence[Camera]) -> bool:
    """Return whether gsplat can draw for these cameras at once: they have one size and one near plane."""
    return len({(camera.width, camera.height, camera.near) for camera in cameras}) == 1


def rasterize(
    inputs: RasterInputs[torch.Tensor],
    cameras: Sequence[Camera],
    backgrounds: Sequence[Background],
    absgrad: AbsGrad | None = None,
) -> Picture:
    """Return what cameras of equal shapes see, each before a background of its own: (C, H, W, 3) and (C, H, W).

    Pixels may differ from the CPU renderer's by 5e-3 where alpha is next to 1/255, others by 1e-5.
    """
    from gsplat import rasterization

    device, first = inputs.means.device, cameras[0]
    lenses = [[[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]] for c in cameras]
    rgb, alpha, meta = rasterization(
        *inputs,
        upload(np.stack([camera.world_to_camera for camera in cameras]), device),
        upload(lenses, device),
        first.width,
        first.height,
        near_plane=first.near,
        far_plane=FAR_PLANE,
        eps2d=DILATION,
        sh_degree=inputs.sh_degree,
        packed=False,
        backgrounds=upload(backgrounds, device),
        absgrad=absgrad is not None,
    )
    if absgrad is not None:
        places, radii, half = meta["means2d"], meta["radii"], upload([first.width / 2, first.height / 2], device)
        places.retain_grad()  # gsplat and torch leave gradients on the projected means

        def lengths() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
            absolute, signed = (g.norm(dim=-1).sum(dim=0) for g in (places.absgrad, places.grad * half))
            return absolute, signed, (radii > 0).all(dim=-1).sum(dim=0)

        absgrad.parts.append(lengths)
    return rgb, 1 - alpha[..., 0]


@dataclass(frozen=True, slots=True, eq=False)
class OnCuda(Loaded):
    """Gaussians that gsplat draws: at least one. What each of them contributes is measured by the CPU's kernels."""

    tensors: RasterInputs[torch.Tensor]  # the inputs on the device

    @staticmethod
    def of(inputs: RasterInputs[Floats], device: str = "cuda") -> OnCuda:
        return OnCuda(inputs, RasterInputs(*(upload(column, device) for column in inputs)))

    def draw(self, camera: Camera, background: Background | None = None) -> Render:
        with torch.no_grad():
            picture = rasterize(self.tensors, [camera], [camera.background if background is None else background])
        return Render(*(values[0].cpu().numpy() for values in picture))
