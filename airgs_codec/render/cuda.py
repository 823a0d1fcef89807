"""Drawing with torch, with gradients: the CPU kernels, or gsplat 1.5 for tensors on a CUDA device.

gsplat imports without its kernels and fails later, so they are looked for: `missing` says what is not there. It waits
for the device twice a call (an inverse of the cameras' matrices, the number of pairs), which several cameras share;
nothing here waits besides. C cameras, N Gaussians, M pixels that Gaussians are blended into, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render import cpu
from airgs_codec.render.cpu import DILATION, FAR, TILE, Contribution, Floats, Loaded, RasterInputs, Redraw, Render
from airgs_codec.scene.camera import Background, Camera

BAND_PAIRS = 1 << 17  # (Gaussian, tile) pairs whose pixels are listed at once: at most 256 each, of 70 bytes
ALL_BATCHES = 2**31 - 1  # of the pairs of a tile; the kernel takes a 32-bit number
MOST_ALPHA = 0.999  # of a Gaussian in a pixel, as in the CPU renderer

Picture = tuple[torch.Tensor, torch.Tensor]  # rgb (H, W, 3) and transmittance (H, W)


def _before_backward() -> tuple[torch.Tensor, torch.Tensor]:
    raise RuntimeError("gradients by places are known after the backward pass of the picture")


@dataclass(slots=True, eq=False)
class AbsGrad:
    """Absolute gradients of one picture or several by the places of their Gaussians (AbsGS, Ye et al. 2024).

    The gradients of single pixels are summed by their absolute values, so that opposite ones do not cancel. A renderer
    that is given one sets `read` and `signed`.
    """

    # () -> (N,) |dL / d(place in pixels)| summed over pictures, and (N,) in how many of them the Gaussian is; after the
    # backward pass
    read: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _before_backward
    # The same as 3DGS has it (Kerbl et al. 2023): with the signs of single pixels, by places that are -1..1 across the
    # picture.
    signed: Callable[[], tuple[torch.Tensor, torch.Tensor]] = _before_backward

    def collect(self, parts: Sequence[AbsGrad]) -> None:
        """Become the sum of those of several pictures, which may not be known yet."""
        self.read = lambda: _summed([part.read() for part in parts])
        self.signed = lambda: _summed([part.signed() for part in parts])


def _summed(parts: Sequence[tuple[torch.Tensor, torch.Tensor]]) -> tuple[torch.Tensor, torch.Tensor]:
    gradients, seen = zip(*parts, strict=True)
    return torch.stack(gradients).sum(dim=0), torch.stack(seen).sum(dim=0)


def missing() -> str | None:
    """Why gsplat cannot run here; None if it can. Compiles its kernels where they are not compiled yet (minutes).

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
    """A float32 tensor of an array or numbers on a device; a CUDA device takes it in its own time, nobody waits."""
    host = torch.tensor(np.asarray(values, np.float32))
    return host.pin_memory().to(device, non_blocking=True) if torch.device(device).type == "cuda" else host


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What C cameras of one size see."""

    rgb: torch.Tensor  # (C, H, W, 3)
    transmittance: torch.Tensor  # (C, H, W)
    meta: dict[str, Any]  # what gsplat says of its projection


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Picture:
        *tensors, camera, background, absgrad, redraw = inputs
        arrays = RasterInputs(*(np.ascontiguousarray(t.detach().numpy(), np.float32) for t in tensors))
        ctx.absgrad, ctx.blended = absgrad, cpu.blend(arrays, camera, background, redraw)
        picture = ctx.blended.picture
        return torch.from_numpy(picture.rgb), torch.from_numpy(picture.transmittance)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        rgb, transmittance = (np.ascontiguousarray(g.numpy(), np.float32) for g in grads)
        gradients = cpu.gradients(ctx.blended, rgb, transmittance)
        if ctx.absgrad is not None:
            seen = torch.zeros(len(gradients.places), dtype=torch.bool)
            seen[torch.from_numpy(ctx.blended.projected.order)] = True
            half = np.array(ctx.blended.projected.size, np.float32) / 2
            absolute, signed = (
                torch.from_numpy(np.hypot(x, y)) for x, y in (gradients.absolute.T, (gradients.places * half).T)
            )
            ctx.absgrad.read = lambda: (absolute, seen)
            ctx.absgrad.signed = lambda: (signed, seen)
        return (*(torch.from_numpy(column) for column in gradients.inputs), None, None, None, None)


def rasterize_views(
    inputs: RasterInputs[torch.Tensor],
    cameras: Sequence[Camera],
    absgrad: AbsGrad | None = None,
    redraws: Sequence[Redraw | None] | None = None,
) -> list[Picture]:
    """Draw what several cameras see, each before its own background: float32, differentiable, on the inputs' device.

    On CUDA cameras of one size and near plane are drawn at once. `absgrad` is that of all pictures together, and can be
    read after the backward pass. `redraws`: one for each; only its tiles are drawn and have gradients (gsplat draws
    all).
    """
    on_cuda = inputs.means.is_cuda
    if on_cuda and alike(cameras):
        drawn = rasterize(inputs, cameras, [camera.background for camera in cameras], absgrad)
        return list(zip(drawn.rgb, drawn.transmittance, strict=True))
    if absgrad is None or len(cameras) == 1:
        parts: list[AbsGrad | None] = [absgrad] * len(cameras)
    else:
        absgrad.collect(several := [AbsGrad() for _ in cameras])
        parts = [*several]
    if on_cuda:
        return [rasterize_views(inputs, [c], part)[0] for c, part in zip(cameras, parts, strict=True)]
    each = zip(cameras, parts, redraws or [None] * len(cameras), strict=True)
    return [_Rasterize.apply(*inputs, c, c.background, part, redraw) for c, part, redraw in each]


def alike(cameras: Sequence[Camera]) -> bool:
    """Whether gsplat can draw for these cameras at once: they have one size and one near plane."""
    return len({(camera.width, camera.height, camera.near) for camera in cameras}) == 1


def rasterize(
    inputs: RasterInputs[torch.Tensor],
    cameras: Sequence[Camera],
    backgrounds: Sequence[Background],
    absgrad: AbsGrad | None = None,
) -> Drawn:
    """Return what cameras that are `alike` see, each before a background of its own.

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
        far_plane=FAR,
        eps2d=DILATION,
        sh_degree=inputs.sh_degree,
        packed=False,
        backgrounds=upload(backgrounds, device),
        absgrad=absgrad is not None,
    )
    if absgrad is not None:
        _read_later(absgrad, meta)
    return Drawn(rgb, 1 - alpha[..., 0], meta)


def _read_later(absgrad: AbsGrad, meta: dict[str, Any]) -> None:
    """Let `absgrad` read what gsplat and torch leave on the projected means once the gradient reaches them."""
    means2d, radii = meta["means2d"], meta["radii"]
    means2d.retain_grad()
    half = upload([meta["width"] / 2, meta["height"] / 2], means2d.device)

    def lengths(gradients: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return gradients.norm(dim=-1).sum(dim=0), (radii > 0).all(dim=-1).sum(dim=0)

    absgrad.read = lambda: lengths(means2d.absgrad)
    absgrad.signed = lambda: lengths(means2d.grad * half)


def measure_weights(drawn: Drawn) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Sum (N,) and maximum (N,) over the pixels of one camera of each Gaussian's alpha T, and pixels (N,), float64.

    The weights are made from gsplat's lists of the Gaussians in every pixel, front to back.
    """
    rows = drawn.meta["means2d"].shape[1]
    device = drawn.rgb.device
    total, peak, hits = (torch.zeros(rows, dtype=torch.float64, device=device) for _ in range(3))
    for ids, _, weights in _blended(drawn.meta):
        total.index_add_(0, ids, weights)
        peak.scatter_reduce_(0, ids, weights, "amax")
        hits += torch.bincount(ids, minlength=rows)
    return total, peak, hits


def measure_pairs(drawn: Drawn, mask: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Gaussian and tile (P,) of each pair that one camera sees, and its alpha T (P,) there, in all and in a mask.

    `mask`: (H, W), 1 inside. Tiles are counted row by row.
    """
    meta, rows, found = drawn.meta, drawn.meta["means2d"].shape[1], []
    size, width, across = meta["tile_size"], meta["width"], meta["isect_offsets"].shape[2]
    for ids, pixels, weights in _blended(meta):
        row, column = torch.div(pixels, width, rounding_mode="floor"), pixels % width
        tile = torch.div(row, size, rounding_mode="floor") * across + torch.div(column, size, rounding_mode="floor")
        keys, pair = torch.unique(tile * rows + ids, return_inverse=True)
        sums = torch.zeros(2, len(keys), dtype=weights.dtype, device=weights.device)
        sums[0].index_add_(0, pair, weights)
        sums[1].index_add_(0, pair, weights * mask.reshape(-1)[pixels])
        found.append((keys % rows, torch.div(keys, rows, rounding_mode="floor"), sums[0], sums[1]))
    ids, tiles, total, inside = (torch.cat(parts) for parts in zip(*found, strict=True))
    return ids, tiles, total, inside


@torch.no_grad()
def _blended(meta: dict[str, Any]) -> Iterator[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
    """Gaussians (M,), pixels (M,) of the picture row by row and alpha T (M,), some rows of tiles after the others."""
    from gsplat import rasterize_to_indices_in_range

    size, width, offsets, ids = meta["tile_size"], meta["width"], meta["isect_offsets"], meta["flatten_ids"]
    means, conics, opacities = (meta[name].detach() for name in ("means2d", "conics", "opacities"))
    starts = [*offsets[0, :, 0].tolist(), len(ids)]
    for first, stop in _bands(starts):
        height = min(meta["height"], stop * size) - first * size
        moved = means - upload([0.0, float(first * size)], means.device)
        found, pixels, _ = rasterize_to_indices_in_range(
            0,
            ALL_BATCHES,
            torch.ones(1, height, width, device=means.device),
            moved,
            conics,
            opacities,
            width,
            height,
            size,
            offsets[:, first:stop].contiguous(),
            ids[: starts[stop]],
        )
        alpha = _alpha(moved[0, found], conics[0, found], opacities[0, found], pixels, width)
        yield found, pixels + first * size * width, alpha * _transmittance(alpha, pixels)


def _bands(starts: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Rows of tiles [first, stop) with at most BAND_PAIRS pairs, or one row; `starts` is the first pair of each row."""
    first, rows = 0, len(starts) - 1
    while first < rows:
        stop = first + 1
        while stop < rows and starts[stop + 1] - starts[first] <= BAND_PAIRS:
            stop += 1
        yield first, stop
        first = stop


def _alpha(
    means: torch.Tensor, conics: torch.Tensor, opacities: torch.Tensor, pixels: torch.Tensor, width: int
) -> torch.Tensor:
    """(M,) float64 alpha of Gaussians at the centres of pixels, which are numbered row by row."""
    dx = means[:, 0] - (pixels % width + 0.5)
    dy = means[:, 1] - (torch.div(pixels, width, rounding_mode="floor") + 0.5)
    a, b, c = conics.unbind(-1)
    power = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    return (opacities * torch.exp(-power)).clamp_max(MOST_ALPHA).double()


def _transmittance(alpha: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
    """(M,) what is left of the light before each entry; entries of one pixel follow each other, front to back."""
    logs = torch.log1p(-alpha)
    before = logs.cumsum(0) - logs
    _, counts = torch.unique_consecutive(pixels, return_counts=True)
    first = counts.cumsum(0) - counts
    return torch.exp(before - before[first].repeat_interleave(counts))


@dataclass(frozen=True, slots=True, eq=False)
class OnCuda(Loaded):
    """Gaussians that gsplat draws: at least one."""

    tensors: RasterInputs[torch.Tensor]  # the inputs on the device

    @staticmethod
    def of(inputs: RasterInputs[Floats], device: str = "cuda") -> OnCuda:
        return OnCuda(inputs, RasterInputs(*(upload(column, device) for column in inputs)))

    def draw(self, camera: Camera, background: Background | None = None) -> Render:
        with torch.no_grad():
            drawn = rasterize(self.tensors, [camera], [camera.background if background is None else background])
        return Render(_array(drawn.rgb[0]), _array(drawn.transmittance[0]))

    def contribution(self, camera: Camera) -> Contribution:
        with torch.no_grad():
            return _contribution(rasterize(self.tensors, [camera], [camera.background]))

    def contribution_and_gradients(self, camera: Camera, pull: Floats) -> tuple[Contribution, RasterInputs[Floats]]:
        leaves = RasterInputs(*(t.detach().clone().requires_grad_(True) for t in self.tensors))
        drawn = rasterize(leaves, [camera], [camera.background])
        gradients = torch.autograd.grad((drawn.rgb[0] * upload(pull, drawn.rgb.device)).sum(), leaves)
        return _contribution(drawn), RasterInputs(*(_array(g) for g in gradients))

    def weights(self, camera: Camera, mask: NDArray[np.bool_]) -> cpu.Weights:
        shape = (-(-camera.height // TILE), -(-camera.width // TILE))
        with torch.no_grad():
            drawn = rasterize(self.tensors, [camera], [camera.background])
            ids, tiles, total, inside = measure_pairs(drawn, upload(mask, drawn.rgb.device))
        picture = Render(_array(drawn.rgb[0]), _array(drawn.transmittance[0]))
        pairs = (_array(ids.int()), _array(tiles.int()), _array(total.float()), _array(inside.float()))
        return cpu.Weights(picture, shape, *pairs)

    def without(self, camera: Camera) -> cpu.Without:
        def draw(rows: NDArray[np.bool_] | None) -> Floats:
            if rows is None:
                return self.draw(camera).rgb
            if not rows.any():
                return np.tile(np.asarray(camera.background, np.float32), (camera.height, camera.width, 1))
            drawn = torch.from_numpy(np.flatnonzero(rows)).to(self.tensors.means.device)
            return replace(self, tensors=RasterInputs(*(t[drawn] for t in self.tensors))).draw(camera).rgb

        return draw


def _contribution(drawn: Drawn) -> Contribution:
    total, peak, hits = (values.cpu().numpy() for values in measure_weights(drawn))
    return Contribution(total, peak, hits.astype(np.int64))


def _array(values: torch.Tensor) -> NDArray[Any]:
    return values.detach().cpu().numpy()
