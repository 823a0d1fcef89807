"""Adding Gaussians, and removing what shows nothing or hangs in the open space about cameras.

Rows are split or cloned where the loss changes most with their place, within a budget: the count follows a ramp to it,
as in Taming 3DGS (Mallick et al. 2024), instead of a threshold on the gradient, whose right value depends on the
resolution; or else the threshold of 3DGS (Kerbl et al. 2023) decides, and the budget only bounds it.

An object in empty space has no Gaussian near it to clone (21.7 dB against 33.9 with seeds on a test scene). Seeds lie
on the visual hull of what the views cannot explain: a point belongs to it if almost every view that sees it disagrees.
What only far cameras see may stand anywhere before what they look at. Viewers stand where cameras do, and between them.

N Gaussians, of which the first `fixed` stay in any case, P points, V views, H x W pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.media.image import box_mean
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.camera import BLACK, Camera, resized
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.trainer.data.pictures import Masks, View
from airgs_codec.trainer.fit.losses import InMotion, Parameters, loading, rotate
from airgs_codec.trainer.fit.points import from_points, neighbours, project

LOW_OPACITY = 0.005  # 3DGS; alpha below 1/255 = 0.0039 is not drawn
CHECKS = (0.3, 0.5, 0.7, 0.9)  # shares of a fit after which free-hanging rows are removed: others then replace them


@dataclass(frozen=True, slots=True)
class Growth:
    budget: int  # Gaussians at the end; with a threshold the most
    start: float = 0.1  # share of the iterations
    stop: float = 0.6  # share of the iterations
    every: int = 50  # iterations
    large: float = 0.003  # of the scene's extent: larger Gaussians are split, smaller ones cloned
    threshold: float | None = None  # on the mean gradient of a row, as `AbsGrad.read` gives it, signed; None: a ramp

    def target(self, before: int, done: float) -> int:
        """Return the number of rows wanted when a share `done` of the iterations is past, starting from `before`.

        The ramp is quadratic and flat at the end: early rows have more time to settle.
        """
        share = min(1.0, max(0.0, (done - self.start) / (self.stop - self.start)))
        return round(before + (self.budget - before) * (1 - (1 - share) ** 2)) if self.budget > before else before

    def due(self, iteration: int, iterations: int) -> bool:
        return self.start * iterations <= iteration <= self.stop * iterations and iteration % self.every == 0

    def removes(self, iteration: int, iterations: int) -> bool:
        """Return whether faint rows are removed now: when rows are added, with a threshold throughout."""
        return (self.threshold is not None and iteration % self.every == 0) or self.due(iteration, iterations)


def growth_of_3dgs(most: int, pictures: int) -> Growth:
    """Return growth with the constants of 3DGS as shares of its 30,000 iterations, each of some `pictures`."""
    return Growth(most, start=1 / 60, stop=0.5, every=100, large=0.01, threshold=2e-4 / pictures)


class Densifier:
    """The mean gradient of each row since rows were last added, and the rows that follow from it."""

    def __init__(self, growth: Growth, rows: int, rng: np.random.Generator) -> None:
        self.growth, self._before, self._rng = growth, rows, rng
        self.restart(rows)

    def restart(self, rows: int) -> None:
        """Forget what was collected, of what are now `rows`."""
        self._sum, self._count = torch.zeros(rows), torch.zeros(rows)

    def collect(self, absgrad: AbsGrad, picked: Callable[[torch.Tensor], torch.Tensor] | None = None) -> None:
        """Add the gradients of an iteration after its backward pass; `picked` takes those of fitted rows."""
        gradients, seen = absgrad.read(signed=self.growth.threshold is not None)
        if picked:
            gradients, seen = picked(gradients), picked(seen)
        self._sum = self._sum.to(gradients.device) + gradients
        self._count = self._count.to(seen.device) + seen

    def mean(self) -> torch.Tensor:
        """Return (N,) means over the pictures that showed a row; 0 where none did."""
        return self._sum / self._count.clamp_min(1)

    def grow(self, p: Parameters, extent: float, fixed: int, done: float) -> tuple[torch.Tensor, Parameters | None]:
        """Return a mask (N,) of the rows that stay, and the new rows that are due when a share `done` is past."""
        score, limit = self.mean(), self.growth.threshold
        if limit is None:
            wanted = self.growth.target(self._before, done)
        else:
            score, wanted = score * (score >= limit), self.growth.budget
        parents = strongest(score, wanted - len(p["means"])).to(p["means"].device)
        split = parents & (p["log_scales"].amax(dim=1).exp() > self.growth.large * extent)
        return split_or_clone(p, parents, split, fixed, self._rng)


def strongest(score: torch.Tensor, count: int) -> torch.Tensor:
    """Return a mask (N,) of the `count` rows of highest score, none of score 0."""
    count = max(0, min(count, int((score > 0).sum())))
    mask = torch.zeros_like(score, dtype=torch.bool)
    mask[torch.topk(score, count).indices] = True
    return mask


def split_or_clone(
    p: Parameters, parents: torch.Tensor, split: torch.Tensor, fixed: int, rng: np.random.Generator
) -> tuple[torch.Tensor, Parameters | None]:
    """Return a mask (N,) of the rows that stay, and new rows, one more for each of the `parents` (N,), if any.

    Rows in `split` (N,) become two 1.6 times smaller ones drawn from them, as in 3DGS; the other parents are cloned.
    The first `fixed` rows stay in any case, and get one child each.
    """
    if not bool(parents.any()):
        return torch.ones_like(parents), None
    removed = split & (torch.arange(len(split), device=split.device) >= fixed)
    rows = torch.cat([torch.nonzero(mask)[:, 0] for mask in (parents, removed)])  # a removed one has two children
    moved = split[rows]
    children = {name: value[rows].clone() for name, value in p.items()}
    normal = torch.from_numpy(rng.standard_normal((int(moved.sum()), 3)).astype(np.float32)).to(p["means"])
    turns = torch.nn.functional.normalize(children["quaternions"][moved], dim=1)
    children["means"][moved] += rotate(turns, normal * children["log_scales"][moved].exp())
    children["log_scales"][moved] -= math.log(1.6)
    return ~removed, children


def is_visible(p: Parameters, fixed: int, low: float = LOW_OPACITY) -> torch.Tensor:
    """Return a mask (N,) of the first `fixed` rows and of those whose opacity is at least `low`."""
    keep = p["opacity_logits"].sigmoid() >= low
    keep[:fixed] = True
    return keep


CANDIDATES = 200_000  # points that are drawn to find the hull, and drawn again inside it
Mask = NDArray[np.bool_]  # (H, W)
Places = NDArray[np.float64]  # (P, 3)


def find_wrong(g: Gaussians | InMotion, views: Sequence[View], renderer: Renderer = CPU) -> Masks:
    """Return masks of the pixels of views where the pictures of `g` differ by 0.06, in the mean of 3 x 3 pixels."""
    loaded = loading(g, renderer)
    differences = (np.abs(loaded(v.after).draw(v.camera).rgb - v.target.rgb).mean(axis=2) for v in views)
    return Masks(box_mean(difference, 3) > 0.06 for difference in differences)


def residual_seeds(
    g: Gaussians, views: Sequence[View], wrong: Sequence[Mask], most: int, largest: float, rng: np.random.Generator
) -> Gaussians | None:
    """Place up to `most` Gaussians of radius `largest` at most where `g` is `wrong` (H, W); None: nothing appeared."""
    visible = g.means[g.opacities() > 0.1].astype(np.float64)
    low, high = np.quantile(visible if len(visible) else g.means, [0.01, 0.99], axis=0)
    margin = 0.2 * (high - low)
    for _ in range(2):  # coarsely, and again within what was found
        drawn = rng.uniform(low - margin, high + margin, (CANDIDATES, 3))
        hull = _hull_of(_away_from(visible, drawn), views, wrong)
        if len(hull) < 50 or most < 1:  # noise
            return None
        low, high = hull.min(axis=0), hull.max(axis=0)
        margin = 0.05 * (high - low)
    points, colours, disagreement = _surface_of(hull, views)
    chosen = _one_per_cell(points, disagreement, most)
    if not len(chosen):
        return None
    places, shown = (a[chosen].astype(np.float32) for a in (points, colours))
    seeds = from_points(places, shown, g.sh_degree, 0.5, largest)
    sizes = np.minimum(seeds.log_scales, np.median(seeds.log_scales))  # a distant one is no larger than others
    return replace(seeds, log_scales=sizes + np.float32(np.log(0.7)))  # they lie on a surface


def _hull_of(points: Places, views: Sequence[View], wrong: Sequence[Mask]) -> Places:
    seen, agree = np.zeros(len(points)), np.zeros(len(points))
    for view, mask in zip(views, wrong, strict=True):
        rows, columns, inside = project(view.camera, points)
        seen[inside] += 1
        agree[inside] += mask[rows, columns]
    return points[(seen >= 0.5 * len(views)) & (agree >= 0.85 * seen)]


def _away_from(visible: Places, points: Places) -> Places:
    # Within three median spacings of a visible Gaussian, that one can move or change its colour itself.
    if len(visible) < 2:
        return points
    tree = cKDTree(visible)
    clear = 3 * float(np.median(tree.query(visible, k=2)[0][:, 1]))
    return points[tree.query(points, distance_upper_bound=clear)[0] > clear]


def _surface_of(hull: NDArray[np.float64], views: Sequence[View]) -> tuple[NDArray[np.float64], ...]:
    """Return the points of a hull (P, 3) that three views see first at least, or two of fewer than six views.

    Gives them, their mean colours (P, 3), 0..1, and the variance of these over the views, summed over colours (P,).
    A point is seen by a view if no other lies clearly before it in its pixel. Hulls are larger than what is in them:
    where the surface is not that of the object, views see different things behind it.
    """
    size = hull.max(axis=0) - hull.min(axis=0)
    tolerance = 2 * (float(np.prod(size)) / len(hull)) ** (1 / 3)  # twice the points' spacing
    seen, sums, squares = np.zeros(len(hull)), np.zeros((len(hull), 3)), np.zeros((len(hull), 3))
    for view in views:
        rows, columns, inside = project(view.camera, hull)
        depth = hull[inside] @ view.camera.world_to_camera[2, :3] + view.camera.world_to_camera[2, 3]
        nearest = np.full((view.camera.height, view.camera.width), np.inf)
        np.minimum.at(nearest, (rows, columns), depth)
        first = depth <= nearest[rows, columns] + tolerance
        colour = view.target.rgb[rows[first], columns[first]].astype(np.float64)
        seen[inside[first]] += 1
        sums[inside[first]] += colour
        squares[inside[first]] += colour**2
    outside = np.flatnonzero(seen >= (3 if len(views) >= 6 else 2))
    mean = sums[outside] / seen[outside, None]
    return hull[outside], mean, (squares[outside] / seen[outside, None] - mean**2).sum(axis=1)


def _one_per_cell(points: NDArray[np.float64], disagreement: NDArray[np.float64], most: int) -> NDArray[np.intp]:
    """At most `most` of the points, one in each cell of a grid: the one on whose colour views agree best."""
    best = np.argsort(disagreement, kind="stable")
    size = float((points.max(axis=0) - points.min(axis=0)).max()) if len(points) else 0.0
    for cells in range(round(most**0.5) + 2, 0, -1) if size else ():
        cell = np.floor((points[best] - points.min(axis=0)) / (size / cells)).astype(np.int64)
        _, first = np.unique(cell, axis=0, return_index=True)
        if len(first) <= most:
            return np.sort(best[first])
    return best[:most]


def in_open_space(g: Gaussians, cameras: Sequence[Camera], renderer: Renderer = CPU) -> NDArray[np.bool_]:
    """Return (N,) rows that no camera sees from as near as viewers may be, and that are seen from one side, or past.

    The depth of what cameras within 8° see is hardly known: the fit puts it elsewhere as well. A viewer may come
    four times as near as any camera that sees it, and cameras see past it by a quarter of its distance from a viewer.
    """
    loaded, opacities, means = renderer.load(g), g.opacities(), g.means.astype(np.float64)
    nearest, (behind, weight, count) = np.full(len(g), np.inf), np.zeros((3, len(g)))
    towards = np.zeros((len(g), 3))
    for camera in (resized(camera, 0.5) for camera in cameras):
        found = loaded.contribution(camera)
        depths = means @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
        colours = np.repeat(((depths - 0.5) / SH_C0).astype(np.float32)[:, None], 3, axis=1)
        picture = renderer.render(replace(g, sh_dc=colours, sh_rest=g.sh_rest[:, :0]), camera, BLACK)
        rows, columns, inside = project(camera, means)
        opaque = np.maximum(1 - picture.transmittance, np.finfo(np.float32).eps)
        past = (picture.rgb[..., 0] / opaque)[rows, columns] - depths[inside]
        behind[inside] += found.total[inside] * past
        weight[inside] += found.total[inside]
        seen, drawn = found.peak > 0.5 * opacities, found.hits > 0
        to = camera.position - means
        distances = np.linalg.norm(to, axis=1)
        nearest[seen] = np.minimum(nearest, distances)[seen]
        count += drawn
        towards[drawn] += (to / distances[:, None])[drawn]
    at = np.stack([camera.position for camera in cameras])
    between = [(at[a] + at[b]) / 2 for a, b in neighbours(cameras, 3)]  # viewers may go from one to the next
    away = cKDTree(np.concatenate([at, np.reshape(between, (-1, 3))])).query(means)[0]
    one_way = np.linalg.norm(towards, axis=1) > 0.99 * count
    return np.isfinite(nearest) & (nearest > 4 * away) & (one_way | (behind > 0.25 * away * weight))
