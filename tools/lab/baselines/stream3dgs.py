"""3DGStream (Sun et al., CVPR 2024): each frame is the one before, moved by a small network, and a few new Gaussians.

A viewer fetches the .ply of the first frame, then for every frame the numbers of a Neural Transformation Cache, a field
that moves and turns Gaussians, and the Gaussians that were added, which are gone at the next frame. U Gaussians of the
first frame, A added ones; N Gaussians, M of them in the box of the field, K SH coefficients past DC.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import write_bytes
from airgs_codec.progress import Progress
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.gaussians import SH_REST, Gaussians, to_matrices
from airgs_codec.trainer.data.pictures import FrameViews, View
from airgs_codec.trainer.fit.grow import Densifier, Growth, strongest
from airgs_codec.trainer.fit.losses import GAUSSIAN_FIELDS, Parameters, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.optimise import EPSILON, PerGaussian, Rates, Resting, Schedule, optimise
from airgs_codec.trainer.fit.trainer import Trainer, fit_first, make_trainer
from airgs_codec.trainer.settings import TrainSettings
from tools.lab.baselines.hashgrid import FieldSettings, HashField, Places
from tools.lab.baselines.method import Footage, Shown, frame_path

OUTPUTS = 7  # of a cache: change of the mean, and of the rotation
# An output of 1 means this change: of means in diagonals of the box, of rotations in components of a quaternion.
MOVE, TURN = 0.005, 0.05
RATE_LAST = 0.1  # share of the learning rate that is left at the end
BETAS = (0.9, 0.99)


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    box: NDArray[np.float64]  # (2, 3) lowest and highest corner, world units

    @property
    def diagonal(self) -> float:
        return float(np.linalg.norm(self.box[1] - self.box[0]))

    def rows(self, g: Gaussians) -> NDArray[np.intp]:
        return np.flatnonzero(((g.means >= self.box[0]) & (g.means <= self.box[1])).all(axis=1))

    def new_cache(self, settings: FieldSettings, seed: int = 0) -> HashField:
        """A cache that moves nothing: its output layer is 0."""
        return HashField(settings, self.box, OUTPUTS, zero=True, seed=seed)


def region_of(g: Gaussians, share: float) -> Region:
    """The box that leaves out as many means on either side of each axis, and keeps a `share` of them along it."""
    rest = (1 - share) / 2
    return Region(np.quantile(g.means.astype(np.float64), [rest, 1 - rest], axis=0))


def apply_cache(g: Gaussians, cache: HashField, region: Region) -> Gaussians:
    rows = region.rows(g)
    with torch.no_grad():
        changes = cache(cache.places(g.means[rows]))
        return to_gaussians(transformed(from_gaussians(g), torch.from_numpy(rows), changes, region.diagonal))


def transformed(
    p: Mapping[str, torch.Tensor], rows: torch.Tensor, changes: torch.Tensor, diagonal: float
) -> Parameters:
    """Gaussians of which `rows` (M,) have moved and turned by `changes` (M, 7) of a cache; 0 changes nothing.

    The rotation is composed as a product of quaternions, and turns SH of the first degree, too; higher ones stay.
    `diagonal`: of the box, world units.
    """
    unit = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=changes.dtype)
    turn = torch.nn.functional.normalize(unit + TURN * changes[:, 3:], dim=1)
    new = {
        "means": p["means"][rows] + MOVE * diagonal * changes[:, :3],
        "quaternions": hamilton(turn, p["quaternions"][rows]),
    }
    if p["sh_rest"].shape[1]:
        new["sh_rest"] = _turned_sh(p["sh_rest"][rows], turn)
    return {name: value.index_copy(0, rows, new[name]) if name in new else value for name, value in p.items()}


def hamilton(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """The product a b of quaternions (M, 4): the rotation by b, then by a."""
    scalar = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(dim=1, keepdim=True)
    vector = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + torch.linalg.cross(a[:, 1:], b[:, 1:])
    return torch.cat([scalar, vector], dim=1)


def rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    twice = 2 * torch.linalg.cross(q[:, 1:], v)
    return v + q[:, :1] * twice + torch.linalg.cross(q[:, 1:], twice)


def _turned_sh(sh: torch.Tensor, turn: torch.Tensor) -> torch.Tensor:
    """Coefficients (M, K, 3) whose first band, -y, z, -x in the order of 3DGS, has turned like a vector."""
    colours = [rotate(turn, torch.stack([-c[:, 2], -c[:, 0], c[:, 1]], dim=1)) for c in sh.unbind(dim=2)]
    first = torch.stack([torch.stack([-v[:, 1], v[:, 2], -v[:, 0]], dim=1) for v in colours], dim=2)
    return torch.cat([first, sh[:, 3:]], dim=1)


@dataclass(slots=True, eq=False)
class CacheDriven:
    """Variables of a fit that learns a cache; Gaussians are watched in its last iterations."""

    base: Gaussians
    cache: HashField
    region: Region
    rate: float  # Adam's, at the beginning
    watched: int  # iterations in which gradients by the places of Gaussians in pictures are collected
    collected: Densifier = field(init=False)
    _base: Parameters = field(init=False)
    _rows: torch.Tensor = field(init=False)
    _places: Places = field(init=False)
    _watching: bool = field(init=False, default=False)
    _absgrad: AbsGrad | None = field(init=False, default=None)
    _adam: torch.optim.Adam = field(init=False)

    def __post_init__(self) -> None:
        rows = self.region.rows(self.base)
        self._base, self._rows = from_gaussians(self.base), torch.from_numpy(rows)
        self._places = self.cache.places(self.base.means[rows])
        self._adam = torch.optim.Adam(self.cache.parameters(), lr=self.rate, betas=BETAS, eps=EPSILON)
        self.collected = Densifier(Growth(len(self.base)), len(self.base), np.random.default_rng(0))

    def current(self, after: float = 0.0) -> Parameters:
        return transformed(self._base, self._rows, self.cache(self._places), self.region.diagonal)

    def watch(self) -> AbsGrad | None:
        self._absgrad = AbsGrad() if self._watching else None
        return self._absgrad

    def penalty(self) -> float:
        return 0.0

    def step(self, iteration: int, iterations: int) -> None:
        if self._absgrad:
            self.collected.collect(self._absgrad)
        self._watching = iteration >= iterations - self.watched
        for group in self._adam.param_groups:
            group["lr"] = self.rate * RATE_LAST ** (iteration / iterations)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)


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
            write_ply(path, fit_first(trainer, FrameViews(0, views), footage.points, progress=progress).gaussians)
            yield Shown("keyframe", read_ply(path), path.stat().st_size)
        first = read_ply(path)
        region = region_of(first, self.options.share)
        moved = read_ply(frame_path(footage.folder, max(0, done - 1))).take(slice(len(first)))
        for t in range(max(1, done), footage.frames):
            target = FrameViews(t, footage.pictures.train(t))
            data = _Fit(self.options, trainer, region).encode(moved, target, progress)
            write_bytes(frame_path(footage.folder, t).with_suffix(".stream"), data)
            shown = decode(moved, data, self.options.cache, region)
            moved = shown.take(slice(len(first)))
            yield Shown("frame", shown, len(data))


def decode(before: Gaussians, data: bytes, cache: FieldSettings, region: Region) -> Gaussians:
    """A frame from the U Gaussians of the one before, moved, and what was fetched for it; added rows come last.

    Raises ConfigError for data that is not a cache of these sizes and whole rows.
    """
    network = region.new_cache(cache)
    size = network.nbytes
    network.load_bytes(data[:size])
    moved = apply_cache(before, network, region)
    return Gaussians.join([moved, _added(data[size:], before.sh_degree)])


def _added(data: bytes, sh_degree: int) -> Gaussians:
    shapes = {"means": (3,), "quaternions": (4,), "log_scales": (3,), "opacity_logits": (), "sh_dc": (3,)}
    shapes["sh_rest"] = (SH_REST[sh_degree], 3)
    widths = [math.prod(shapes[name]) for name in GAUSSIAN_FIELDS]
    if len(data) % (WIRE.itemsize * sum(widths)):
        raise ConfigError(f"expected Gaussians of {WIRE.itemsize * sum(widths)} bytes, got {len(data)} bytes")
    rows = np.frombuffer(data, WIRE).reshape(-1, sum(widths)).astype(np.float32)
    columns = np.split(rows, np.cumsum(widths)[:-1], axis=1)
    return Gaussians(
        *(column.reshape(len(rows), *shapes[name]) for name, column in zip(GAUSSIAN_FIELDS, columns, strict=True))
    )


def _wire(g: Gaussians) -> bytes:
    return np.hstack([getattr(g, name).reshape(len(g), -1) for name in GAUSSIAN_FIELDS]).astype(WIRE).tobytes()


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
        pixels = max(max(view.camera.width, view.camera.height) for view in views)
        score = gradients * pixels / 2
        return strongest(torch.where(score >= self.options.threshold, score, 0.0), self.options.most_added)

    def _add(
        self, moved: Gaussians, new: Gaussians, target: FrameViews, rng: np.random.Generator, progress: Progress
    ) -> Gaussians:
        o = self.options
        resting = Resting(from_gaussians(moved), torch.empty(0, dtype=torch.int64))
        growth = Growth(min(2 * len(new), o.most_added), every=ADD_EVERY)
        base, densifier = from_gaussians(new), Densifier(growth, len(new), rng)
        variables = PerGaussian(base, self.trainer.extent, ADDED_RATES, densifier=densifier, resting=resting)
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
