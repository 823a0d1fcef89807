"""Drawing with torch, with gradients: the CPU kernels, or gsplat 1.5 or 1.6 for tensors on a CUDA device.

gsplat imports without its kernels and fails later, so `missing` looks for them. It waits for the device once a call,
for the number of pairs; nothing else here waits. C cameras, N Gaussians, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch

from airgs_codec.render import cpu
from airgs_codec.render.cpu import DILATION, FAR_PLANE, Floats, Loaded, RasterInputs, Render
from airgs_codec.scene.camera import Background, Camera

Pictures = tuple[torch.Tensor, torch.Tensor]  # rgb (C, H, W, 3) and transmittance (C, H, W)


@dataclass(slots=True, eq=False)
class AbsGrad:
    """Gradients by the places of Gaussians in the pictures that were drawn with it, known after the backward pass."""

    # Of each call, signed or not: (N,) lengths of gradients, summed, and in how many pictures a row is.
    parts: list[Callable[[bool], tuple[torch.Tensor, torch.Tensor]]] = field(default_factory=list)

    def read(self, signed: bool = False) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (N,) |dL / d(place in pixels)|, summed over pictures, and (N,) in how many of them a Gaussian is.

        The gradients of single pixels are summed by their absolute values, so that opposite ones do not cancel (AbsGS,
        Ye et al. 2024). `signed`: as 3DGS has it (Kerbl et al. 2023), with their signs, and by places that are -1..1
        across the picture. Raises RuntimeError before the backward pass.
        """
        if not self.parts:
            raise RuntimeError("gradients by places are known after the backward pass of the picture")
        (lengths, seen), *others = (part(signed) for part in self.parts)
        for more, also in others:
            lengths, seen = lengths + more, seen + also
        return lengths, seen


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


def by_gsplat(tensor: torch.Tensor) -> bool:
    """Return whether gsplat draws with a tensor, and losses are computed where it is."""
    return tensor.is_cuda


def upload(values: Any, device: torch.device | str) -> torch.Tensor:
    """Return a tensor of bytes, or else float32, of numbers on a device, without waiting for a CUDA device."""
    array = np.asarray(values)
    host = torch.tensor(array if array.dtype == np.uint8 else array.astype(np.float32))
    return host.pin_memory().to(device, non_blocking=True) if torch.device(device).type == "cuda" else host


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Pictures:
        *tensors, cameras, absgrad, redraws = inputs
        arrays = RasterInputs(*(np.ascontiguousarray(t.detach().numpy(), np.float32) for t in tensors))
        each = zip(cameras, redraws or [None] * len(cameras), strict=True)
        ctx.found, ctx.blended = [], [cpu.blend(arrays, camera, camera.background, redraw) for camera, redraw in each]
        if absgrad is not None:
            absgrad.parts.append(partial(_summed, ctx.found))
        pictures = [blended.picture for blended in ctx.blended]
        if len(pictures) == 1:
            return torch.from_numpy(pictures[0].rgb[None]), torch.from_numpy(pictures[0].transmittance[None])
        rgb, transmittance = ([getattr(p, name) for p in pictures] for name in ("rgb", "transmittance"))
        return torch.from_numpy(np.stack(rgb)), torch.from_numpy(np.stack(transmittance))

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        total: list[Any] = []
        for blended, *given in reversed(list(zip(ctx.blended, *grads, strict=True))):
            rgb, transmittance = (np.ascontiguousarray(g.numpy(), np.float32) for g in given)
            by_inputs, places, absolute = cpu.gradients(blended, rgb, transmittance)
            seen = torch.zeros(len(places), dtype=torch.int64)
            seen[torch.from_numpy(blended.projected.order)] = 1
            half = np.array(blended.projected.size, np.float32) / 2
            lengths = (torch.from_numpy(np.hypot(x, y)) for x, y in (absolute.T, (places * half).T))
            ctx.found.insert(0, (*lengths, seen))
            total = [a + b for a, b in zip(total, by_inputs, strict=True)] if total else list(by_inputs)
        return (*map(torch.from_numpy, total), None, None, None)


def _summed(found: list[tuple[torch.Tensor, ...]], signed: bool) -> tuple[torch.Tensor, torch.Tensor]:
    absolute, with_signs, seen = (torch.stack(of).sum(dim=0) for of in zip(*found, strict=True))
    return with_signs if signed else absolute, seen


def rasterize(
    inputs: RasterInputs[torch.Tensor], cameras: Sequence[Camera], absgrad: AbsGrad | None = None, redraws: Any = None
) -> Pictures:
    """Draw what cameras of one size and near plane see, each before its own background: float32, differentiable.

    `absgrad` can be read after the backward pass. `redraws`: a `Redraw` or None for each camera; only its tiles are
    drawn and have gradients (gsplat draws all). Pixels of gsplat may differ from the CPU renderer's by 5e-3 where alpha
    is next to 1/255, others by 1e-5.
    """
    if not by_gsplat(inputs.means):
        pictures: Pictures = _Rasterize.apply(*inputs, cameras, absgrad, redraws)
        return pictures
    import gsplat

    first, each = cameras[0], (_on_device(camera, inputs.means.device) for camera in cameras)
    views, lenses, places, backgrounds = (torch.stack(of) for of in zip(*each, strict=True))
    if hasattr(gsplat, "spherical_harmonics_l0"):  # gsplat 1.6
        values = gsplat.spherical_harmonics(inputs.sh_degree, inputs.means, views, inputs.sh)
    else:  # what 1.5 makes of SH by itself inverts the matrices of the cameras at every call, and waits for that
        towards, sh = inputs.means - places[:, None], inputs.sh.expand(len(cameras), -1, -1, -1)
        values = gsplat.spherical_harmonics(inputs.sh_degree, towards, sh, masks=towards.any(dim=-1))
    colours = (values + 0.5).relu()
    size, planes = (first.width, first.height), {"near_plane": first.near, "far_plane": FAR_PLANE}
    more = {"eps2d": DILATION, "packed": False, "backgrounds": backgrounds, "absgrad": absgrad is not None}
    rgb, alpha, meta = gsplat.rasterization(*inputs[:4], colours, views, lenses, *size, **planes, **more)
    if absgrad is not None:
        projected, radii = meta["means2d"], meta["radii"]
        projected.retain_grad()  # gsplat and torch leave gradients on the projected means

        def read(signed: bool) -> tuple[torch.Tensor, torch.Tensor]:
            half = upload([first.width / 2, first.height / 2], projected.device) if signed else None
            gradients = projected.absgrad if half is None else projected.grad * half
            return gradients.norm(dim=-1).sum(dim=0), (radii > 0).all(dim=-1).sum(dim=0)

        absgrad.parts.append(read)
    return rgb, 1 - alpha[..., 0]


@lru_cache(maxsize=1024)
def _on_device(camera: Camera, device: torch.device) -> tuple[torch.Tensor, ...]:
    """Matrices (4, 4) and (3, 3) of a camera, its position (3,) and background (3,), which are uploaded once."""
    lens = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    return tuple(upload(v, device) for v in (camera.world_to_camera, lens, camera.position, camera.background))


@dataclass(frozen=True, slots=True, eq=False)
class OnCuda(Loaded):
    """Gaussians that gsplat draws: at least one. What each of them contributes is measured by the CPU's kernels."""

    tensors: RasterInputs[torch.Tensor]  # the inputs on the device

    @staticmethod
    def of(inputs: RasterInputs[Floats], device: str = "cuda") -> OnCuda:
        return OnCuda(inputs, RasterInputs(*(upload(column, device) for column in inputs)))

    def draw(self, camera: Camera, background: Background | None = None) -> Render:
        with torch.no_grad():
            picture = rasterize(self.tensors, [replace(camera, background=background or camera.background)])
        return Render(*(values[0].cpu().numpy() for values in picture))
