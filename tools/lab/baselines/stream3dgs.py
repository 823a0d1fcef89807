"""3DGStream (Sun et al., CVPR 2024): each frame is the one before, moved by a small network, and a few new Gaussians.

A viewer fetches the .ply of the first frame, then for every frame the numbers of a Neural Transformation Cache and the
Gaussians that were added, which are gone at the next frame. U Gaussians of the first frame, A added ones.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import write_bytes
from airgs_codec.progress import Progress
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.gaussians import SH_REST, Gaussians, join_rows, to_matrices
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.fit.active import Resting
from airgs_codec.trainer.fit.first import fit_first
from airgs_codec.trainer.fit.grow import Densifier, Growth, strongest
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.parameters import ATTRIBUTES, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.trainer import FrameViews, Trainer, make_trainer
from airgs_codec.trainer.fit.variables import PerGaussian, Rates
from airgs_codec.trainer.settings import TrainSettings
from tools.lab.baselines.hashgrid import FieldSettings
from tools.lab.baselines.method import Footage, Shown, frame_path
from tools.lab.baselines.transformation import CacheDriven, Region, apply_cache, region_of

ADDED_RATES = Rates(factor=15.0, last=0.1, means_last=0.1)
SPREAD = math.sqrt(2)  # new means are drawn from N(mu, 2 Sigma) of their parents
START_OPACITY, LOW_OPACITY = 0.1, 0.01  # of what is added; fainter ones are removed
ADD_EVERY = 20  # iterations
WIRE = np.dtype("<f4")  # a number of an added Gaussian


@dataclass(frozen=True, slots=True)
class StreamSettings:
    first: TrainSettings = field(default_factory=TrainSettings)  # of the first frame
    cache: FieldSettings = field(
        default_factory=lambda: FieldSettings(levels=6, features=2, log2_table=11, coarsest=8, growth=1.6)
    )
    share: float = 1.0  # of the means along each axis that the box of the cache spans
    rate: float = 3e-2  # learning rate of the cache at the beginning
    iterations: int = 150  # of the cache
    added_iterations: int = 100  # of what is added
    coarse: float = 0.4  # share of the iterations of the cache, the first ones, that see pictures of half the size
    threshold: float = 1.5e-4  # gradient of the loss by the place in the picture, in halves of its longest side
    most_added: int = 1000  # Gaussians that a frame may add


@dataclass(frozen=True, slots=True)
class Stream3dgs:
    options: StreamSettings = field(default_factory=StreamSettings)

    @property
    def name(self) -> str:
        return "3dgstream"

    @property
    def settings(self) -> dict[str, object]:
        return asdict(self.options)

    def frames(self, footage: Footage, done: int, progress: Progress) -> Iterator[Shown]:
        """Frames from number `done` on; what a viewer fetches for frame t > 0 is kept as NNNNNN.stream.

        The Gaussians that the next frame starts from are the first U rows of the frame that was kept, so that nothing
        else is needed to go on. Raises as `Trainer.fit_first` and `optimise` do.
        """
        path = frame_path(footage.folder, 0)
        views = footage.pictures.train(0)
        trainer = make_trainer(self.options.first, views, footage.points, "cpu")
        if not done:
            begun = time.perf_counter()
            write_ply(path, fit_first(trainer, FrameViews(0, views), footage.points, progress=progress).gaussians)
            yield Shown("key", read_ply(path), path.stat().st_size, time.perf_counter() - begun)
        first = read_ply(path)
        region = region_of(first, self.options.share)
        moved = read_ply(frame_path(footage.folder, max(0, done - 1))).take(slice(len(first)))
        for t in range(max(1, done), footage.frames):
            begun = time.perf_counter()
            target = FrameViews(t, footage.pictures.train(t))
            data = _Fit(self.options, trainer, region).encode(moved, target, progress)
            write_bytes(frame_path(footage.folder, t).with_suffix(".stream"), data)
            shown = decode(moved, data, self.options.cache, region)
            moved = shown.take(slice(len(first)))
            yield Shown("frame", shown, len(data), time.perf_counter() - begun)


def decode(before: Gaussians, data: bytes, cache: FieldSettings, region: Region) -> Gaussians:
    """A frame from the U Gaussians of the one before, moved, and what was fetched for it; added rows come last.

    Raises ConfigError for data that is not a cache of these sizes and whole rows.
    """
    network = region.new_cache(cache)
    size = network.nbytes
    network.load_bytes(data[:size])
    moved = apply_cache(before, network, region)
    return join_rows([moved, _added(data[size:], before.sh_degree)])


def _added(data: bytes, sh_degree: int) -> Gaussians:
    """The rows of `_wire`."""
    shapes = {"means": (3,), "quaternions": (4,), "log_scales": (3,), "opacity_logits": (), "sh_dc": (3,)}
    shapes["sh_rest"] = (SH_REST[sh_degree], 3)
    widths = [math.prod(shapes[name]) for name in ATTRIBUTES]
    if len(data) % (WIRE.itemsize * sum(widths)):
        raise ConfigError(f"expected Gaussians of {WIRE.itemsize * sum(widths)} bytes, got {len(data)} bytes")
    rows = np.frombuffer(data, WIRE).reshape(-1, sum(widths)).astype(np.float32)
    columns = np.split(rows, np.cumsum(widths)[:-1], axis=1)
    return Gaussians(
        *(column.reshape(len(rows), *shapes[name]) for name, column in zip(ATTRIBUTES, columns, strict=True))
    )


def _wire(g: Gaussians) -> bytes:
    return np.concatenate([getattr(g, name).reshape(len(g), -1) for name in ATTRIBUTES], axis=1).astype(WIRE).tobytes()


@dataclass(frozen=True, slots=True)
class _Fit:
    options: StreamSettings
    trainer: Trainer
    region: Region

    def encode(self, before: Gaussians, target: FrameViews, progress: Progress) -> bytes:
        """Return what a viewer fetches for a frame; the second stage adds to what the first one is after its coding."""
        o = self.options
        rng = np.random.default_rng([o.first.seed, target.frame])
        cache = self.region.new_cache(o.cache, o.first.seed)
        driven = CacheDriven(before, cache, self.region, o.rate, watched=len(target.views))
        optimise(driven, target.views, self._schedule("cache", o.iterations, o.coarse), rng, progress=progress)
        data = cache.to_bytes()
        cache.load_bytes(data)
        moved = apply_cache(before, cache, self.region)
        parents = self._parents(driven.collected.mean(), target.views)
        if not bool(parents.any()):
            return data
        return data + _wire(self._add(moved, spawned(moved, parents.numpy(), rng), target, rng, progress))

    def _parents(self, gradients: torch.Tensor, views: Sequence[View]) -> torch.Tensor:
        """(U,) mask of the rows whose gradient (U,), per pixel, is high."""
        pixels = max(max(view.camera.width, view.camera.height) for view in views)
        score = gradients * pixels / 2
        return strongest(torch.where(score >= self.options.threshold, score, 0.0), self.options.most_added)

    def _add(
        self, moved: Gaussians, new: Gaussians, target: FrameViews, rng: np.random.Generator, progress: Progress
    ) -> Gaussians:
        o = self.options
        resting = Resting(from_gaussians(moved), torch.empty(0, dtype=torch.int64))
        growth = Growth(min(2 * len(new), o.most_added), every=ADD_EVERY)
        variables = PerGaussian(
            from_gaussians(new),
            self.trainer.extent,
            ADDED_RATES,
            densifier=Densifier(growth, len(new), rng),
            resting=resting,
        )
        optimise(variables, target.views, self._schedule("added", o.added_iterations), rng, progress=progress)
        variables.remove_fainter(LOW_OPACITY)
        return to_gaussians(variables.detached()).take(slice(len(moved), None))

    def _schedule(self, stage: str, iterations: int, coarse: float = 0.0) -> Schedule:
        first = self.options.first
        return Schedule(stage, iterations, lambda _: first.sh_degree, ssim_weight=first.ssim_weight, coarse=coarse)


def spawned(g: Gaussians, parents: NDArray[np.bool_], rng: np.random.Generator) -> Gaussians:
    """A new Gaussian beside each of the `parents` (U,), of its size and colour, unturned and nearly transparent."""
    p = g.take(parents)
    normal = SPREAD * np.exp(p.log_scales) * rng.standard_normal(p.means.shape)
    offsets = np.einsum("nij,nj->ni", to_matrices(p.quaternions), normal)
    return replace(
        p,
        means=(p.means + offsets).astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (len(p), 1)),
        opacity_logits=np.full(len(p), math.log(START_OPACITY / (1 - START_OPACITY)), np.float32),
        sh_rest=np.zeros_like(p.sh_rest),
    )
