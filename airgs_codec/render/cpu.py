"""Rendering on the CPU without torch, and what every renderer takes.

N Gaussians, V visible, K = (degree + 1)^2 - 1 SH coefficients past DC, M (Gaussian, tile) pairs, H x W pixels.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numba
import numpy as np
from numba.np.ufunc import parallel
from numpy.typing import NDArray

from airgs_codec._arguments import brief
from airgs_codec.media.image import encode_png, save_png, to_bytes
from airgs_codec.render import cpu_kernels as kernels
from airgs_codec.scene.camera import Background, Camera
from airgs_codec.scene.gaussians import Gaussians

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Without = Callable[[NDArray[np.bool_] | None], Floats]  # mask (N,) of the rows that are drawn, None: all -> (H, W, 3)

TILE = kernels.TILE_SIDE  # pixels
FAR_PLANE = 1e18  # world units along the view axis: the square of more is no float32
DILATION = 0.3  # px^2 added to the projected covariance, as gsplat and INRIA do

_LOCK = threading.Lock()  # numba's thread layers abort when two threads run parallel kernels
_AHEAD: list[subprocess.Popen[bytes]] = []  # what compiles kernels of gradients
POOLED = [kernels]  # modules whose kernels numba's pool of threads works on


def _forked() -> None:
    """In a process that was forked: a lock that nobody holds, and a pool of threads that a fork does not break.

    GNU's OpenMP, numba's fastest pool, ends a forked process that enters it when its parent has. Kernels that are
    loaded again are bound to the pool that is then chosen.
    """
    global _LOCK
    _LOCK = threading.Lock()
    if parallel._is_initialized and numba.threading_layer() == "omp":
        numba.config.THREADING_LAYER = "workqueue"  # type: ignore[attr-defined]
        parallel._is_initialized = False
        for module in POOLED:
            importlib.reload(module)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


Array = TypeVar("Array", bound=Any)  # a numpy array or a torch tensor


class RasterInputs(NamedTuple, Generic[Array]):
    """Activated Gaussians, of one precision and device; or the derivatives of a loss by them."""

    means: Array  # (N, 3) world units
    quaternions: Array  # (N, 4) w, x, y, z of any length
    scales: Array  # (N, 3) world units
    opacities: Array  # (N,) 0..1
    sh: Array  # (N, K + 1, 3)

    @property
    def sh_degree(self) -> int:
        """Return the degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Render:
    """A picture: `rgb` (H, W, 3), 0 to 1 but not clipped, `transmittance` (H, W), 1 where nothing was drawn."""

    rgb: Floats
    transmittance: Floats

    __repr__ = brief

    @property
    def nbytes(self) -> int:
        return self.rgb.nbytes + self.transmittance.nbytes

    def _repr_png_(self) -> bytes:
        """It as a PNG, for notebooks."""
        return encode_png(to_bytes(self.rgb))

    def save(self, path: str | Path) -> None:
        """Write it as an 8-bit PNG, whole or not at all. Raises ConfigError where that cannot be."""
        save_png(path, self.rgb)


@dataclass(frozen=True, slots=True, eq=False)
class Redraw:
    """A picture of which only some tiles are drawn again, and what the others show."""

    tiles: NDArray[np.bool_]  # (down, across)
    rest: Callable[[], Render]  # the whole picture, which may have to be drawn for it
    rows: NDArray[np.bool_]  # (U,) Gaussians that have gradients; those that come after have them, too


@dataclass(frozen=True, slots=True, eq=False)
class Contribution:
    """What each Gaussian gave to one picture: its blending weights alpha T over all pixels."""

    total: NDArray[np.float64]  # (N,) their sum
    peak: NDArray[np.float64]  # (N,) their maximum, 0..1
    hits: Longs  # (N,) pixels where it was blended


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What each Gaussian gave to one picture, tile by tile, and which part of that inside a mask."""

    picture: Render
    shape: tuple[int, int]  # tiles down and across
    ids: Ints  # (M,) Gaussian of each pair
    tiles: Ints  # (M,) tile of each pair, row by row
    total: Floats  # (M,) sum of the blending weights alpha T over the pixels of the tile
    inside: Floats  # (M,) the same over pixels of the mask


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """Gaussians as a camera sees them, tile by tile: all that a picture is drawn from."""

    size: tuple[int, int]  # width and height of the picture, pixels
    shape: tuple[int, int]  # tiles across and down
    flat: Floats  # (N, 12) projected Gaussians, see `cpu_kernels`
    start: Longs  # (tiles + 1,) first pair of each tile
    ids: Ints  # (M,) Gaussian of each pair, tile by tile, front to back inside a tile
    drawn: NDArray[np.bool_]  # (tiles,) the others have no pairs
    order: Ints  # (V,) front to back
    first_pair: Longs  # (V + 1,) first place in `slots` of each visible Gaussian
    slots: Ints  # (M,) place in `ids` of each pair, Gaussian by Gaussian

    def tiles(self) -> tuple[Floats, Longs, Ints, Ints, int, int]:
        """Return the first argument of every kernel that walks through the tiles.

        Drawn tiles come in an order whose equal static chunks cost the same: dealt out like cards, the dearest first.
        """
        ranked = np.argsort(-np.diff(self.start), kind="stable").astype(np.int32)
        ranked, threads = ranked[self.drawn[ranked]], numba.get_num_threads()
        order = np.concatenate([ranked[i::threads] for i in range(threads)])
        return self.flat, self.start, self.ids, order, *self.shape

    def draw(self, background: Background, rows: NDArray[np.bool_] | None = None) -> Render:
        """Return the picture before a background, without Gaussians that are False in a mask (N,)."""
        if rows is None:
            return _draw(self, background)[0]
        shown = rows[self.ids]
        before = np.concatenate([[0], np.cumsum(shown)])
        return _draw(replace(self, start=before[self.start], ids=self.ids[shown]), background)[0]


@dataclass(frozen=True, slots=True, eq=False)
class Blended:
    """A picture and everything its gradient and statistics need."""

    inputs: RasterInputs[Floats]
    camera: Camera
    picture: Render
    projected: Projected
    visited: Ints  # (tiles,) pairs that were visited before every pixel was opaque
    wanted: NDArray[np.bool_]  # (N,) Gaussians that have gradients


def use_threads(count: int) -> None:
    """Let kernels that this thread calls work on at most `count` threads."""
    numba.set_num_threads(min(count, numba.get_num_threads()))


def activate(g: Gaussians) -> RasterInputs[Floats]:
    """Return Gaussians in stored domain as contiguous float32 arrays that the kernels take."""
    with np.errstate(over="ignore"):  # a scale past float32 is Inf, and Inf is culled
        scales = np.exp(g.log_scales)
    sh = np.concatenate([g.sh_dc[:, None], g.sh_rest], axis=1)
    columns = (g.means, g.quaternions, scales, g.opacities(), sh)
    return RasterInputs(*(np.require(c, np.float32, ["C", "W"]) for c in columns))  # W: else numba compiles again


def render(gaussians: Gaussians, camera: Camera, background: Background | None = None) -> Render:
    """Draw the picture that `camera` sees of the Gaussians before a background; None: the camera's."""
    return Loaded(activate(gaussians)).draw(camera, background)


def measure_contribution(gaussians: Gaussians, camera: Camera) -> Contribution:
    """Measure how much each Gaussian contributes to what `camera` sees."""
    return Loaded(activate(gaussians)).contribution(camera)


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """Activated Gaussians that are ready to be drawn."""

    inputs: RasterInputs[Floats]

    def draw(self, camera: Camera, background: Background | None = None) -> Render:
        """Draw the picture that `camera` sees before a background; None: the camera's."""
        return blend(self.inputs, camera, camera.background if background is None else background).picture

    def contribution(self, camera: Camera) -> Contribution:
        """Measure how much each Gaussian gives to what `camera` sees."""
        blended, shape = blend(self.inputs, camera, camera.background), (camera.height, camera.width)
        pairs = _pair_gradients(blended, np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), True)
        return _contribution(blended.projected, pairs[:, 9:])

    def contribution_and_gradients(self, camera: Camera, pull: Floats) -> tuple[Contribution, RasterInputs[Floats]]:
        """Return the contribution and the derivatives by the inputs of sum(picture * pull), pull (H, W, 3)."""
        blended = blend(self.inputs, camera, camera.background)
        pairs = _pair_gradients(blended, pull, np.zeros(pull.shape[:2], np.float32), True)
        return _contribution(blended.projected, pairs[:, 9:]), _sum_gradients(blended, pairs)[0]

    def weights(self, camera: Camera, mask: NDArray[np.bool_]) -> Weights:
        """Draw the picture that `camera` sees; return what each Gaussian gives to it, in all and in a mask (H, W).

        A blending weight is the derivative of the picture's sum by a Gaussian's colour: one channel asks for all
        pixels, one for those of the mask.
        """
        blended = blend(self.inputs, camera, camera.background)
        asked = np.zeros((*mask.shape, 3), np.float32)
        asked[..., 0], asked[..., 1] = 1.0, mask
        pairs = _pair_gradients(blended, asked, np.zeros(mask.shape, np.float32), True)  # as others: one kernel less
        p = blended.projected
        of_pair = np.repeat(np.arange(len(p.start) - 1, dtype=np.int32), np.diff(p.start))
        return Weights(blended.picture, p.shape[::-1], p.ids, of_pair, pairs[:, 0].copy(), pairs[:, 1].copy())

    def without(self, camera: Camera) -> Without:
        """Return what draws some of the rows for `camera`, again and again; cheaper than loading them each time."""
        projected = project(self.inputs, camera)
        return lambda rows: projected.draw(camera.background, rows).rgb


def project(inputs: RasterInputs[Floats], camera: Camera, tiles: NDArray[np.bool_] | None = None) -> Projected:
    """Project the Gaussians, sort them by depth, assign them to tiles; `tiles` (down, across): to these only."""
    _announce()
    n, size = len(inputs.means), (camera.width, camera.height)
    flat, key, touched = np.zeros((n, 12), np.float32), np.empty(n, np.uint64), np.empty(n, np.int32)
    shape = (-(-camera.width // TILE), -(-camera.height // TILE))
    drawn = np.ones(shape[0] * shape[1], np.bool_) if tiles is None else np.ascontiguousarray(tiles).reshape(-1)
    with _LOCK:
        kernels.project((*inputs, inputs.sh_degree), _seen_by(camera), drawn, flat, key, touched)
        visible = np.sort(key[touched > 0])  # depth, then row: the same order every time
        order = (visible & np.uint64(0xFFFFFFFF)).astype(np.int32)
        first_pair = np.concatenate([[0], np.cumsum(touched[order], dtype=np.int64)])
        start, ids, slots = kernels.bin_tiles(flat, order, first_pair, drawn, *shape)
    return Projected(size, shape, flat, start, ids, drawn, order, first_pair, slots)


def _draw(p: Projected, background: Background, before: Render | None = None) -> tuple[Render, Ints]:
    """Return the picture, and (tiles,) how many pairs of each tile were visited; what is not drawn shows `before`."""
    width, height = p.size
    rgb = np.empty((height, width, 3), np.float32) if before is None else before.rgb.copy()
    transmittance = np.empty((height, width), np.float32) if before is None else before.transmittance.copy()
    visited = np.empty(len(p.start) - 1, np.int32)
    with _LOCK:
        kernels.blend(p.tiles(), np.asarray(background, np.float32), rgb, transmittance, visited)
    return Render(rgb, transmittance), visited


def blend(
    inputs: RasterInputs[Floats], camera: Camera, background: Background, redraw: Redraw | None = None
) -> Blended:
    """Project the Gaussians and blend them front to back; `redraw`: in its tiles only."""
    p = project(inputs, camera, redraw.tiles if redraw else None)
    picture, visited = _draw(p, background, redraw.rest() if redraw else None)
    wanted = np.ones(len(inputs.means), np.bool_)
    if redraw:
        wanted[: len(redraw.rows)] = redraw.rows
    return Blended(inputs, camera, picture, p, visited, wanted)


def gradients(
    blended: Blended, grad_rgb: Floats, grad_transmittance: Floats
) -> tuple[RasterInputs[Floats], Floats, Floats]:
    """Return the derivatives of a loss by the inputs of `blend`, from those by rgb (H, W, 3) and transmittance (H, W).

    After them those by the pixel positions (N, 2), and the sums of the absolute values of single pixels (AbsGS).
    """
    out, sums = _sum_gradients(blended, _pair_gradients(blended, grad_rgb, grad_transmittance, None))
    return out, sums[:, 4:6], sums[:, 9:11]


def _pair_gradients(blended: Blended, grad_rgb: Floats, grad_transmittance: Floats, statistics: bool | None) -> Floats:
    """Return (M, 12) of `kernels.blend_gradient`; `statistics` True and None compile different kernels."""
    if _AHEAD:
        _AHEAD.pop().wait()
    p, picture = blended.projected, blended.picture
    pairs = np.empty((len(p.slots), 12), np.float32)
    given = (picture.rgb, picture.transmittance, blended.visited, grad_rgb, grad_transmittance)
    with _LOCK:
        kernels.blend_gradient(p.tiles(), *given, statistics, pairs)
    return pairs


def _sum_gradients(blended: Blended, pairs: Floats) -> tuple[RasterInputs[Floats], Floats]:
    """Gradients of the inputs, and the (N, 12) sums of the pairs."""
    p, wanted, inputs = blended.projected, blended.wanted, blended.inputs
    sums = np.zeros((len(inputs.means), 12), np.float32)
    out = RasterInputs(*(np.zeros_like(column) for column in inputs))
    scene = (*inputs, inputs.sh_degree)
    with _LOCK:
        kernels.sum_pairs(p.order, p.first_pair, p.slots, wanted, pairs, sums)
        kernels.project_gradient(scene, _seen_by(blended.camera), p.flat, p.order, wanted, sums, tuple(out))
    return out, sums


def _contribution(p: Projected, pairs: Floats) -> Contribution:
    rows = len(p.flat)
    peak = np.zeros(rows, np.float32)
    np.maximum.at(peak, p.ids, pairs[:, 1])
    total, hits = (np.bincount(p.ids, pairs[:, column], rows).astype(np.float64) for column in (0, 2))
    return Contribution(total, peak.astype(np.float64), hits.astype(np.int64))


@contextmanager
def one_thread() -> Iterator[None]:
    """Run kernels on one thread inside: on small pictures threads wait for each other longer than they work."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


def _seen_by(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64], int, int, float, float, float]:
    """Return a camera as the kernels take it: world-to-camera matrix, fx, fy, cx, cy, size, near, far, dilation."""
    view = np.ascontiguousarray(camera.world_to_camera, np.float64)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    return view, intrinsics, camera.width, camera.height, camera.near, FAR_PLANE, DILATION


def compile_ahead() -> None:
    """Let another process compile the kernels of gradients, where numba's cache has none yet, until they are needed."""
    if not _is_cached(kernels.project_gradient):
        code = f"from {__name__} import compile_gradients; compile_gradients()"
        with suppress(OSError):  # they are compiled when they are needed
            _AHEAD.append(subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.DEVNULL))


def compile_gradients() -> None:
    """Compile what gradients and statistics take into numba's cache, by those of an empty scene."""
    inputs = RasterInputs(*(np.zeros((0, *shape), np.float32) for shape in ((3,), (4,), (3,), (), (1, 3))))
    picture = Render(np.zeros((TILE, TILE, 3), np.float32), np.ones((TILE, TILE), np.float32))
    none, start, every = np.zeros(0, np.int32), np.zeros(2, np.int64), np.ones(1, np.bool_)
    flat = np.zeros((0, 12), np.float32)
    p = Projected((TILE, TILE), (1, 1), flat, start, none, every, none, start[:1], none)
    camera = Camera("", TILE, TILE, 1.0, 1.0, 0.0, 0.0, np.eye(4))
    blended = Blended(inputs, camera, picture, p, np.zeros(1, np.int32), every[:0])
    _sum_gradients(blended, _pair_gradients(blended, picture.rgb, picture.transmittance, True))


def _is_cached(kernel: Any) -> bool:
    path = kernel.stats.cache_path
    return not path or any(Path(path).glob(f"cpu_kernels.{kernel.py_func.__name__}-*.nbi"))


@cache
def _announce() -> None:
    """Say once that kernels are compiled, when numba's cache has none yet."""
    if not _is_cached(kernels.project):
        print("compiling the renderer's kernels (about 15 s, once)", file=sys.stderr)
