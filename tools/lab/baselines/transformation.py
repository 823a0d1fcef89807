"""The Neural Transformation Cache of 3DGStream (Sun et al., CVPR 2024): a field that moves and turns Gaussians.

N Gaussians, M of them in the box of the field, K SH coefficients past DC.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.fit.grow import Densifier, Growth
from airgs_codec.trainer.fit.parameters import EPSILON, Parameters, from_gaussians, to_gaussians
from tools.lab.baselines.hashgrid import FieldSettings, HashField, Places

OUTPUTS = 7  # of a cache: change of the mean, and of the rotation
# An output of 1 means this change: of means in diagonals of the box, of rotations in components of a quaternion.
MOVE, TURN = 0.005, 0.05
RATE_LAST = 0.1  # share of the learning rate that is left at the end
BETAS = (0.9, 0.99)


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Where Gaussians move; those outside rest."""

    box: NDArray[np.float64]  # (2, 3) lowest and highest corner, world units

    @property
    def diagonal(self) -> float:
        """Its length in world units."""
        return float(np.linalg.norm(self.box[1] - self.box[0]))

    def rows(self, g: Gaussians) -> NDArray[np.intp]:
        """(M,) the Gaussians inside."""
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
    """Vectors (M, 3) turned by unit quaternions (M, 4)."""
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
        """0: 3DGStream has the loss of the pictures alone."""
        return 0.0

    def step(self, iteration: int, iterations: int) -> None:
        if self._absgrad:
            self.collected.collect(self._absgrad)
        self._watching = iteration >= iterations - self.watched
        for group in self._adam.param_groups:
            group["lr"] = self.rate * RATE_LAST ** (iteration / iterations)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)
