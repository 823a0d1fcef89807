"""A stand-in for gsplat 1.5.3 on the CPU: what the adapter calls, with gsplat's shapes, made by the CPU renderer.

C cameras, N Gaussians, M pixels that Gaussians are blended into.
"""

import sys
import types
from typing import Any

import numpy as np
import pytest
import torch

from airgs_codec.render import cpu, cuda
from tests.faces import Camera, RasterInputs

TILE = 16


def rasterization(
    *tensors: Any, near_plane: float, far_plane: float, eps2d: float, sh_degree: int, **more: Any
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """gsplat's: (C, H, W, 3), (C, H, W, 1) and its meta; without absolute gradients."""
    means, quats, scales, opacities, colors, views, lenses, width, height = tensors
    count, backgrounds = len(views), more["backgrounds"]
    assert views.shape == (count, 4, 4) and lenses.shape == (count, 3, 3) and backgrounds.shape == (count, 3)
    assert opacities.shape == (len(means),) and (sh_degree + 1) ** 2 <= colors.shape[1] and not more["packed"]
    assert (far_plane, eps2d, more["absgrad"]) == (cpu.FAR, cpu.DILATION, False)
    inputs = RasterInputs(means, quats, scales, opacities, colors)
    host = RasterInputs(*(np.ascontiguousarray(t.detach().numpy()) for t in inputs))
    pictures, projected = [], []
    for view, k, behind in zip(views.numpy(), lenses.numpy(), backgrounds.tolist(), strict=True):
        lens = (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))
        camera = Camera("", width, height, *lens, view.astype(np.float64), near=near_plane)
        pictures.append(cuda._Rasterize.apply(*inputs, camera, tuple(behind), None, None))
        projected.append(cpu.project(host, camera))
    rgb, transmittance = (torch.stack(parts) for parts in zip(*pictures, strict=True))
    return rgb, 1 - transmittance[..., None], _meta(projected, opacities, (width, height))


def _meta(projected: list[cpu.Projected], opacities: torch.Tensor, size: tuple[int, int]) -> dict[str, Any]:
    flat = np.stack([p.flat for p in projected])
    peak, shear, fall = (flat[..., i] for i in (2, 3, 4))
    conics = np.stack([peak, peak * shear, fall + peak * shear**2], axis=-1)
    across, down = projected[0].shape
    offsets, ids, done, radii = [], [], 0, np.zeros((*flat.shape[:2], 2), np.int32)
    for c, p in enumerate(projected):
        offsets.append(done + p.start[:-1].reshape(down, across))
        ids.append(p.ids.astype(np.int64) + c * flat.shape[1])
        done += len(p.ids)
        radii[c, p.order] = 1
    arrays = {
        "means2d": flat[..., :2].copy(), "conics": conics, "radii": radii,
        "isect_offsets": np.stack(offsets).astype(np.int32), "flatten_ids": np.concatenate(ids).astype(np.int32),
    }  # fmt: skip
    return {
        **{name: torch.from_numpy(array) for name, array in arrays.items()}, "tile_size": TILE,
        "opacities": torch.broadcast_to(opacities, flat.shape[:2]), "width": size[0], "height": size[1],
    }  # fmt: skip


def rasterize_to_indices_in_range(
    range_start: int, range_end: int, transmittances: torch.Tensor, *rest: Any
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """gsplat's, for one camera and all batches: ids of Gaussians (M,), pixels (M,) row by row, images (M,)."""
    means2d, conics, opacities, width, height, tile_size, offsets, ids = rest
    assert (range_start, tile_size) == (0, TILE) and type(range_end) is int and range_end < 2**32
    assert transmittances.shape == (1, height, width) and len(means2d) == 1
    down, across = offsets.shape[1:]
    assert down == -(-height // TILE) and across == -(-width // TILE)
    starts = [*offsets[0].reshape(-1).tolist(), len(ids)]
    found: list[list[int]] = [[] for _ in range(width * height)]
    mean, conic, opacity = means2d[0].numpy(), conics[0].numpy(), opacities[0].numpy()
    for y in range(height):
        for x in range(width):
            tile, left = (y // TILE) * across + x // TILE, 1.0
            for g in ids[starts[tile] : starts[tile + 1]].tolist():
                dx, dy = mean[g] - (x + 0.5, y + 0.5)
                a, b, c = conic[g]
                alpha = min(0.999, opacity[g] * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy))
                if alpha < 1 / 255:
                    continue
                if left * (1 - alpha) <= 1e-4:
                    break
                left *= 1 - alpha
                found[y * width + x].append(g)
    pixels = np.repeat(np.arange(width * height), [len(f) for f in found])
    gaussians = torch.tensor([g for f in found for g in f], dtype=torch.int64)
    return gaussians, torch.from_numpy(pixels), torch.zeros(len(pixels), dtype=torch.int64)


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make it what `import gsplat` finds, until the test ends."""
    module: Any = types.ModuleType("gsplat")
    module.rasterization, module.rasterize_to_indices_in_range = rasterization, rasterize_to_indices_in_range
    monkeypatch.setitem(sys.modules, "gsplat", module)
