"""Rendering on the CPU without torch. N Gaussians, V visible, M (Gaussian, tile) pairs, H x W pixels."""

from __future__ import annotations

import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from airgs_codec.render import cpu_kernels as kernels
from airgs_codec.render.inputs import BLACK, Background, RasterInputs
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians

Floats = NDArray[np.float32]

FAR = 1e10  # world units along the view axis
DILATION = 0.3  # px^2 added to the projected covariance, as gsplat and INRIA do
BANDS = 4  # bands of tile rows that threads bin side by side

_LOCK = threading.Lock()  # numba's thread layers abort when two threads run parallel kernels
_announced = False


@dataclass(frozen=True, slots=True, eq=False)
class Render:
    """A picture. Colours are not clipped."""

    rgb: Floats  # (H, W, 3)
    transmittance: Floats  # (H, W), 1 where nothing was drawn


@dataclass(frozen=True, slots=True, eq=False)
class Contribution:
    """What each Gaussian gave to one picture: its blending weights alpha T over all pixels."""

    total: NDArray[np.float64]  # (N,) their sum
    peak: NDArray[np.float64]  # (N,) their maximum, 0..1
    hits: NDArray[np.int64]  # (N,) pixels where it was blended


@dataclass(frozen=True, slots=True, eq=False)
class Blended:
    """A picture and everything its gradient and statistics need."""

    picture: Render
    flat: Floats  # (N, 12) projected Gaussians, see `cpu_kernels`
    order: NDArray[np.int32]  # (V,) front to back
    first_pair: NDArray[np.int64]  # (V + 1,) first place in `slots` of each visible Gaussian
    tile_start: NDArray[np.int64]  # (tiles + 1,) first pair of each tile
    ids: NDArray[np.int32]  # (M,) Gaussian of each pair, tile by tile
    slots: NDArray[np.int32]  # (M,) place in `ids` of each pair, Gaussian by Gaussian
    tile_order: NDArray[np.int32]  # (tiles,) in which they are blended
    blended: NDArray[np.int32]  # (tiles,) pairs that were visited before every pixel was opaque
    tiles: tuple[int, int]  # across, down


def activate(g: Gaussians) -> RasterInputs[Floats]:
    """Gaussians in stored domain -> contiguous float32 arrays as the kernels take them."""
    with np.errstate(over="ignore"):  # a scale past float32 is Inf, and Inf is culled
        scales = np.exp(g.log_scales)
    sh = np.concatenate([g.sh_dc[:, None], g.sh_rest], axis=1)
    columns = (g.means, g.quaternions, scales, g.opacities(), sh)
    return RasterInputs(*(np.ascontiguousarray(c, np.float32) for c in columns))


def render(gaussians: Gaussians, camera: Camera, background: Background = BLACK) -> Render:
    """The picture that `camera` sees of the Gaussians before a background."""
    return blend(activate(gaussians), camera, background).picture


def measure_contribution(gaussians: Gaussians, camera: Camera) -> Contribution:
    """How much each Gaussian contributes to what `camera` sees."""
    b = blend(activate(gaussians), camera, BLACK)
    pairs = np.zeros((len(b.ids), 12), np.float32)
    with _LOCK:
        kernels.blend_statistics(
            b.flat, b.tile_start, b.ids, b.tile_order, *b.tiles, b.blended, pairs, camera.width, camera.height
        )
    n = len(gaussians)
    peak = np.zeros(n)
    np.maximum.at(peak, b.ids, pairs[:, 1])
    hits = np.bincount(b.ids, pairs[:, 2], n).astype(np.int64)
    total = np.bincount(b.ids, pairs[:, 0], n).astype(np.float64)
    return Contribution(total, peak, hits)


def blend(inputs: RasterInputs[Floats], camera: Camera, background: Background) -> Blended:
    """Project the Gaussians, sort them by depth, assign them to tiles, blend them front to back."""
    _announce()
    n = len(inputs.means)
    flat = np.zeros((n, 12), np.float32)
    key = np.empty(n, np.uint64)
    touched = np.empty(n, np.int32)
    view, intrinsics = view_arguments(camera)
    shape = (camera.width, camera.height)
    geometry = (*inputs, inputs.sh_degree)
    rgb = np.empty((camera.height, camera.width, 3), np.float32)
    transmittance = np.empty((camera.height, camera.width), np.float32)
    with _LOCK:
        kernels.project(*geometry, view, intrinsics, *shape, camera.near, FAR, DILATION, flat, key, touched)
        visible = np.sort(key[touched > 0])  # depth, then row: the same order every time
        order = (visible & np.uint64(0xFFFFFFFF)).astype(np.int32)
        first_pair = np.concatenate([[0], np.cumsum(touched[order], dtype=np.int64)])
        tiles = (-(-camera.width // kernels.TILE), -(-camera.height // kernels.TILE))
        tile_start, ids, slots = kernels.bin_tiles(flat, order, first_pair, *tiles, BANDS)
        tile_order = _balanced(np.diff(tile_start))
        blended = np.empty(tiles[0] * tiles[1], np.int32)
        colour = np.asarray(background, np.float32)
        kernels.blend(flat, tile_start, ids, tile_order, *tiles, colour, rgb, transmittance, blended)
    picture = Render(rgb, transmittance)
    return Blended(picture, flat, order, first_pair, tile_start, ids, slots, tile_order, blended, tiles)


@dataclass(frozen=True, slots=True, eq=False)
class Gradients:
    """Derivatives of a loss by what a picture was made of."""

    inputs: RasterInputs[Floats]
    absolute: Floats  # (N, 2) by x and y of the pixel position, the absolute values of single pixels summed (AbsGS)


def gradients(
    inputs: RasterInputs[Floats], camera: Camera, blended: Blended, grad_rgb: Floats, grad_transmittance: Floats
) -> Gradients:
    """The backward pass of `blend`, from dL / d rgb (H, W, 3) and dL / d transmittance (H, W)."""
    b = blended
    pairs = np.empty((len(b.ids), 12), np.float32)
    sums = np.zeros((len(inputs.means), 12), np.float32)
    out = RasterInputs(*(np.zeros_like(column) for column in inputs))
    view, intrinsics = view_arguments(camera)
    tiled = (b.flat, b.tile_start, b.ids, b.tile_order, *b.tiles)
    picture = (b.picture.rgb, b.picture.transmittance, b.blended)
    size = (camera.width, camera.height)
    with _LOCK:
        kernels.blend_gradient(*tiled, *picture, grad_rgb, grad_transmittance, pairs)
        kernels.sum_pairs(b.order, b.first_pair, b.slots, pairs, sums)
        geometry = (*inputs, inputs.sh_degree, view, intrinsics)
        kernels.project_gradient(*geometry, *size, DILATION, b.flat, b.order, sums, *out)
    return Gradients(out, sums[:, 9:11])


def view_arguments(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World-to-camera matrix and fx, fy, cx, cy as the kernels take them."""
    view = np.ascontiguousarray(camera.world_to_camera, np.float64)
    return view, np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def _balanced(costs: NDArray[np.int64]) -> NDArray[np.int32]:
    """Tiles in an order whose equal static chunks cost alike: dealt out by descending cost, like cards."""
    ranked = np.argsort(-costs, kind="stable").astype(np.int32)
    threads = numba.get_num_threads()
    return np.concatenate([ranked[i::threads] for i in range(threads)])


def _announce() -> None:
    """Say once that kernels are compiled, when numba's cache has none yet."""
    global _announced
    if _announced:
        return
    _announced = True
    path = kernels.project.stats.cache_path
    if path and not any(Path(path).glob("cpu_kernels.project-*.nbi")):
        print("compiling the renderer's kernels (about 30 s, once)", file=sys.stderr)
