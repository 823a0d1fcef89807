"""Adding Gaussians where pictures pull hardest, within a budget, and removing those that nothing shows.

N Gaussians. The count follows a ramp to the budget (as Taming 3DGS, Mallick et al. 2024, has it) instead of a threshold
on the gradient, whose right value depends on the resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from airgs_codec.render.absgrad import Pull
from airgs_codec.train.fit.parameters import ATTRIBUTES, Parameters

SPLIT_SHRINK = math.log(1.6)  # 3DGS: children of a split are 1.6 times smaller
LOW_OPACITY = 0.005  # 3DGS; alpha below 1/255 = 0.0039 is not drawn


@dataclass(frozen=True, slots=True)
class Growth:
    """When rows are added and how many there may be."""

    budget: int  # Gaussians at the end
    start: float = 0.1  # share of the iterations
    stop: float = 0.6
    every: int = 50  # iterations

    def target(self, before: int, done: float) -> int:
        """Rows there should be when a share `done` of the iterations is past, starting from `before`.

        Quadratic, flat at the end: early rows have more time to settle.
        """
        share = min(1.0, max(0.0, (done - self.start) / (self.stop - self.start)))
        return round(before + (self.budget - before) * (1 - (1 - share) ** 2)) if self.budget > before else before

    def due(self, iteration: int, total: int) -> bool:
        """Whether rows are added after this iteration (counted from 1)."""
        return self.start * total <= iteration <= self.stop * total and iteration % self.every == 0


class Pulls:
    """Mean pull on each row over the pictures that showed it."""

    def __init__(self, rows: int) -> None:
        """Nothing seen yet."""
        self._sum = torch.zeros(rows)
        self._count = torch.zeros(rows)

    def add(self, pull: Pull) -> None:
        """After a backward pass."""
        pixels, seen = pull.read()
        self._sum += pixels.cpu()
        self._count += seen.cpu()

    def mean(self) -> torch.Tensor:
        """(N,) 0 where no picture showed the row."""
        return self._sum / self._count.clamp_min(1)


def grow(
    p: Parameters, score: torch.Tensor, count: int, large: float, kept: int, rng: np.random.Generator
) -> tuple[torch.Tensor, Parameters | None]:
    """Up to `count` more rows beside those of highest `score` (N,): mask of the rows that go on, and the new rows.

    A row larger than `large` (world units) is split in two smaller ones drawn from it, a smaller one is cloned. The
    first `kept` rows go on in any case, and get one child each.
    """
    device = p["means"].device
    count = min(count, int((score > 0).sum()))
    if count <= 0:
        return torch.ones(len(score), dtype=torch.bool, device=device), None
    hot = torch.zeros(len(score), dtype=torch.bool)
    hot[torch.topk(score, count).indices] = True
    hot = hot.to(device)
    split = hot & (p["log_scales"].amax(dim=1).exp() > large)
    goes = split & (torch.arange(len(split), device=device) >= kept)
    parents = torch.cat([torch.nonzero(rows)[:, 0] for rows in (hot, goes)])  # one that goes leaves two
    moved = split[parents]
    children = {name: p[name][parents].clone() for name in ATTRIBUTES}
    children["means"][moved] += _offsets({name: v[moved] for name, v in children.items()}, rng)
    children["log_scales"][moved] -= SPLIT_SHRINK
    return ~goes, children


def prune(p: Parameters, kept: int, low: float = LOW_OPACITY) -> torch.Tensor:
    """(N,) mask without rows past the first `kept` whose opacity is under `low`."""
    keep = p["opacity_logits"].sigmoid() >= low
    keep[:kept] = True
    return keep


def _offsets(p: Parameters, rng: np.random.Generator) -> torch.Tensor:
    """(n, 3) a draw from each Gaussian, its mean left out."""
    normal = torch.from_numpy(rng.standard_normal((len(p["means"]), 3)).astype(np.float32)).to(p["means"])
    w, x, y, z = torch.nn.functional.normalize(p["quaternions"], dim=1).unbind(1)
    v = normal * p["log_scales"].exp()
    axis = torch.stack([x, y, z], dim=1)
    turned = torch.linalg.cross(axis, v) * 2
    return v + w[:, None] * turned + torch.linalg.cross(axis, turned)
