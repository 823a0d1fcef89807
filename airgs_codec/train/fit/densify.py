"""Adding Gaussians where the loss changes most with their place, within a budget, and removing what shows nothing.

N Gaussians, of which the first `kept` stay in any case. The count follows a ramp to the budget, as in Taming 3DGS
(Mallick et al. 2024), instead of a threshold on the gradient, whose right value depends on the resolution; or else the
threshold of 3DGS (Kerbl et al. 2023) decides, and the budget only bounds it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from airgs_codec.render.absgrad import AbsGrad
from airgs_codec.train.fit.parameters import Parameters

LARGE = 0.003  # of the scene's extent: larger Gaussians are split, smaller ones cloned
SPLIT_SHRINK = math.log(1.6)  # 3DGS: children of a split are 1.6 times smaller
LOW_OPACITY = 0.005  # 3DGS; alpha below 1/255 = 0.0039 is not drawn


@dataclass(frozen=True, slots=True)
class Growth:
    """When rows are added and removed, which, and how many there may be."""

    budget: int  # Gaussians at the end; with a threshold the most
    start: float = 0.1  # share of the iterations
    stop: float = 0.6  # share of the iterations
    every: int = 50  # iterations
    large: float = LARGE  # of the scene's extent
    threshold: float | None = None  # on the mean gradient of a row, as `AbsGrad.signed` gives it; None: a ramp

    def target(self, before: int, done: float) -> int:
        """Rows there should be when a share `done` of the iterations is past, starting from `before`.

        The ramp is quadratic and flat at the end: early rows have more time to settle.
        """
        share = min(1.0, max(0.0, (done - self.start) / (self.stop - self.start)))
        return round(before + (self.budget - before) * (1 - (1 - share) ** 2)) if self.budget > before else before

    def due(self, iteration: int, iterations: int) -> bool:
        """Whether rows are added after this iteration, counted from 1."""
        return self.start * iterations <= iteration <= self.stop * iterations and iteration % self.every == 0

    def removes(self, iteration: int, iterations: int) -> bool:
        """Whether faint rows are removed after this iteration: by a threshold throughout, else when rows are added."""
        throughout = self.threshold is not None and iteration % self.every == 0
        return throughout or self.due(iteration, iterations)


def growth_of_3dgs(most: int, pictures: int) -> Growth:
    """Growth with the constants of 3DGS, its 500 to 15,000 of 30,000 iterations as shares; up to `most` Gaussians.

    `pictures`: an iteration sees so many, whose losses are averaged, and so their gradients are smaller.
    """
    return Growth(most, start=1 / 60, stop=0.5, every=100, large=0.01, threshold=2e-4 / pictures)


class Densifier:
    """The mean gradient of each row since rows were last added, and the rows that follow from it."""

    def __init__(self, growth: Growth, rows: int, rng: np.random.Generator) -> None:
        """For a fit that begins with so many `rows`."""
        self.growth = growth
        self._before = rows
        self._rng = rng
        self.restart(rows)

    def restart(self, rows: int) -> None:
        """Forget what was collected; from now on there are so many `rows`."""
        self._sum = torch.zeros(rows)
        self._count = torch.zeros(rows)

    def collect(self, absgrad: AbsGrad) -> None:
        """Add the gradients of an iteration's pictures, after their backward pass, on their device."""
        gradients, seen = absgrad.read() if self.growth.threshold is None else absgrad.signed()
        self._sum = self._sum.to(gradients.device) + gradients
        self._count = self._count.to(seen.device) + seen

    def mean(self) -> torch.Tensor:
        """(N,) mean over the pictures that showed a row; 0 where none did."""
        return self._sum / self._count.clamp_min(1)

    def grow(self, p: Parameters, extent: float, kept: int, done: float) -> tuple[torch.Tensor, Parameters | None]:
        """Mask (N,) of the rows that go on, and new rows, as many as are due when a share `done` is past.

        `extent`: of the scene in world units.
        """
        score, limit = self.mean(), self.growth.threshold
        if limit is None:
            wanted = self.growth.target(self._before, done)
        else:
            score, wanted = score * (score >= limit), self.growth.budget
        parents = strongest(score, wanted - len(p["means"])).to(p["means"].device)
        split = parents & (p["log_scales"].amax(dim=1).exp() > self.growth.large * extent)
        return split_or_clone(p, parents, split, kept, self._rng)


def strongest(score: torch.Tensor, count: int) -> torch.Tensor:
    """(N,) mask of the `count` rows of highest score; rows of score 0 are never among them."""
    count = max(0, min(count, int((score > 0).sum())))
    mask = torch.zeros_like(score, dtype=torch.bool)
    mask[torch.topk(score, count).indices] = True
    return mask


def split_or_clone(
    p: Parameters, parents: torch.Tensor, split: torch.Tensor, kept: int, rng: np.random.Generator
) -> tuple[torch.Tensor, Parameters | None]:
    """Mask (N,) of the rows that go on, and one new row more for each of the `parents` (N,); None: there are none.

    Rows in `split` (N,) become two smaller ones drawn from them, the other parents are cloned. The first `kept` rows
    go on in any case, and get one child each.
    """
    if not bool(parents.any()):
        return torch.ones_like(parents), None
    goes = split & (torch.arange(len(split), device=split.device) >= kept)
    rows = torch.cat([torch.nonzero(mask)[:, 0] for mask in (parents, goes)])  # one that goes leaves two
    moved = split[rows]
    children = {name: value[rows].clone() for name, value in p.items()}
    children["means"][moved] += _offsets({name: v[moved] for name, v in children.items()}, rng)
    children["log_scales"][moved] -= SPLIT_SHRINK
    return ~goes, children


def is_visible(p: Parameters, kept: int, low: float = LOW_OPACITY) -> torch.Tensor:
    """(N,) mask of the first `kept` rows and of those whose opacity is at least `low`."""
    keep = p["opacity_logits"].sigmoid() >= low
    keep[:kept] = True
    return keep


def _offsets(p: Parameters, rng: np.random.Generator) -> torch.Tensor:
    """(n, 3) a draw from each Gaussian, relative to its mean."""
    normal = torch.from_numpy(rng.standard_normal((len(p["means"]), 3)).astype(np.float32)).to(p["means"])
    w, x, y, z = torch.nn.functional.normalize(p["quaternions"], dim=1).unbind(1)
    v = normal * p["log_scales"].exp()
    axis = torch.stack([x, y, z], dim=1)
    turned = torch.linalg.cross(axis, v) * 2
    return v + w[:, None] * turned + torch.linalg.cross(axis, turned)
