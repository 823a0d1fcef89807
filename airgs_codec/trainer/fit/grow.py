"""Adding Gaussians, and removing what shows nothing or hangs in the open space about cameras.

Rows are split or cloned where the loss changes most with their place, within a budget: the count follows a ramp to it,
as in Taming 3DGS (Mallick et al. 2024), instead of a threshold on the gradient, whose right value depends on the
resolution; or else the threshold of 3DGS (Kerbl et al. 2023) decides, and the budget only bounds it.

That only refines what is there; an object in empty space has no Gaussian near it to clone (21.7 dB against 33.9 with
seeds on a test scene). Seeds lie on the visual hull of what the views cannot explain: a point belongs to it if almost
every view that sees it disagrees there.

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

LARGE = 0.003  # of the scene's extent: larger Gaussians are split, smaller ones cloned
SPLIT_SHRINK = math.log(1.6)  # 3DGS: children of a split are 1.6 times smaller
LOW_OPACITY = 0.005  # 3DGS; alpha below 1/255 = 0.0039 is not drawn
CHECKS = (0.3, 0.5, 0.7, 0.9)  # shares of the iterations of a fit at which it is removed: what stays fills in for it
NEARER = 4.0  # times as near as any camera that sees it may a viewer come to a Gaussian
BEHIND = 0.25  # of its distance from a viewer, by which cameras see past what hangs free
ONE_WAY = 0.99  # length of the mean direction to the cameras that see it, from which they tell no depth: 8° off it
CLEARLY = 0.5  # of its opacity, with which a camera sees it
AROUND = 3  # cameras about each one, to which viewers may go
SHRUNK = 0.5  # pictures that tell it have this share of their pixels on either side


@dataclass(frozen=True, slots=True)
class Growth:
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
        return self.start * iterations <= iteration <= self.stop * iterations and iteration % self.every == 0

    def removes(self, iteration: int, iterations: int) -> bool:
        """Whether faint rows are removed after this iteration: by a threshold throughout, else when rows are added."""
        throughout = self.threshold is not None and iteration % self.every == 0
        return throughout or self.due(iteration, iterations)


def growth_of_3dgs(most: int, pictures: int) -> Growth:
    """Growth with the constants of 3DGS as shares of its 30,000 iterations, each of so many `pictures` on average."""
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

    def collect(self, absgrad: AbsGrad, picked: Callable[[torch.Tensor], torch.Tensor] | None = None) -> None:
        """Add the gradients of an iteration's pictures after their backward pass; `picked` takes fitted rows' own."""
        gradients, seen = absgrad.read() if self.growth.threshold is None else absgrad.signed()
        if picked:
            gradients, seen = picked(gradients), picked(seen)
        self._sum = self._sum.to(gradients.device) + gradients
        self._count = self._count.to(seen.device) + seen

    def mean(self) -> torch.Tensor:
        """(N,) mean over the pictures that showed a row; 0 where none did."""
        return self._sum / self._count.clamp_min(1)

    def grow(self, p: Parameters, extent: float, fixed: int, done: float) -> tuple[torch.Tensor, Parameters | None]:
        """Mask (N,) of the rows that go on, and the new rows that are due when a share `done` is past."""
        score, limit = self.mean(), self.growth.threshold
        if limit is None:
            wanted = self.growth.target(self._before, done)
        else:
            score, wanted = score * (score >= limit), self.growth.budget
        parents = strongest(score, wanted - len(p["means"])).to(p["means"].device)
        split = parents & (p["log_scales"].amax(dim=1).exp() > self.growth.large * extent)
        return split_or_clone(p, parents, split, fixed, self._rng)


def strongest(score: torch.Tensor, count: int) -> torch.Tensor:
    """(N,) mask of the `count` rows of highest score; rows of score 0 are never among them."""
    count = max(0, min(count, int((score > 0).sum())))
    mask = torch.zeros_like(score, dtype=torch.bool)
    mask[torch.topk(score, count).indices] = True
    return mask


def split_or_clone(
    p: Parameters, parents: torch.Tensor, split: torch.Tensor, fixed: int, rng: np.random.Generator
) -> tuple[torch.Tensor, Parameters | None]:
    """Mask (N,) of the rows that go on, and one new row more for each of the `parents` (N,); None: there are none.

    Rows in `split` (N,) become two smaller ones drawn from them, the other parents are cloned. The first `fixed` rows
    go on in any case, and get one child each.
    """
    if not bool(parents.any()):
        return torch.ones_like(parents), None
    goes = split & (torch.arange(len(split), device=split.device) >= fixed)
    rows = torch.cat([torch.nonzero(mask)[:, 0] for mask in (parents, goes)])  # one that goes leaves two
    moved = split[rows]
    children = {name: value[rows].clone() for name, value in p.items()}
    normal = torch.from_numpy(rng.standard_normal((int(moved.sum()), 3)).astype(np.float32)).to(p["means"])
    turns = torch.nn.functional.normalize(children["quaternions"][moved], dim=1)
    children["means"][moved] += rotate(turns, normal * children["log_scales"][moved].exp())
    children["log_scales"][moved] -= SPLIT_SHRINK
    return ~goes, children


def is_visible(p: Parameters, fixed: int, low: float = LOW_OPACITY) -> torch.Tensor:
    """(N,) mask of the first `fixed` rows and of those whose opacity is at least `low`."""
    keep = p["opacity_logits"].sigmoid() >= low
    keep[:fixed] = True
    return keep


CANDIDATES = 200_000  # points that are drawn to find the hull, and drawn again inside it
RESIDUAL = 0.06  # mean absolute difference of colours over 3 x 3 pixels, from which a view disagrees
AGREE = 0.85  # share of the views that see a point of the hull, which disagree there
SEEN = 0.5  # share of all views that see a point of the hull
FEWEST = 50  # points of a hull; below that it is noise, and densification has to do
OPACITY = 0.5  # of a seed
VISIBLE = 0.1  # opacity of a Gaussian that counts as being there
CLEAR = 3.0  # median spacings of what is there: nearer to it, it can move or change its colour itself
TIGHT = 0.7  # radius of a seed, over the distance to the nearest ones: they lie on a surface


def find_wrong(g: Gaussians | InMotion, views: Sequence[View], renderer: Renderer = CPU) -> Masks:
    """The pixels of views where the pictures of `g` differ from them."""
    loaded = loading(g, renderer)
    differences = (np.abs(loaded(v.after).draw(v.camera).rgb - v.target.rgb).mean(axis=2) for v in views)
    return Masks(box_mean(difference, 3) > RESIDUAL for difference in differences)


def residual_seeds(
    g: Gaussians,
    views: Sequence[View],
    wrong: Sequence[NDArray[np.bool_]],
    most: int,
    largest: float,
    rng: np.random.Generator,
) -> Gaussians | None:
    """Up to `most` Gaussians of radius `largest` at most where `g` is `wrong` (H, W); None where nothing appeared."""
    coarse = _hull_of(_away_from_visible(rng.uniform(*_box(g), (CANDIDATES, 3)), g), views, wrong)
    if len(coarse) < FEWEST or most < 1:
        return None
    low, high = coarse.min(axis=0), coarse.max(axis=0)
    margin = 0.05 * (high - low)
    drawn = rng.uniform(low - margin, high + margin, (CANDIDATES, 3))
    hull = _hull_of(_away_from_visible(drawn, g), views, wrong)
    if len(hull) < FEWEST:
        return None
    points, colours, disagreement = _surface_of(hull, views)
    chosen = _one_per_cell(points, disagreement, most)
    if not len(chosen):
        return None
    places, shown = (a[chosen].astype(np.float32) for a in (points, colours))
    seeds = from_points(places, shown, g.sh_degree, OPACITY, largest)
    sizes = np.minimum(seeds.log_scales, np.median(seeds.log_scales))  # one that lies apart is no larger than others
    return replace(seeds, log_scales=sizes + np.float32(np.log(TIGHT)))


def _hull_of(
    points: NDArray[np.float64], views: Sequence[View], wrong: Sequence[NDArray[np.bool_]]
) -> NDArray[np.float64]:
    seen, agree = np.zeros(len(points)), np.zeros(len(points))
    for view, mask in zip(views, wrong, strict=True):
        rows, columns, inside = project(view.camera, points)
        seen[inside] += 1
        agree[inside] += mask[rows, columns]
    return points[(seen >= SEEN * len(views)) & (agree >= AGREE * seen)]


def _away_from_visible(points: NDArray[np.float64], g: Gaussians) -> NDArray[np.float64]:
    there = g.means[g.opacities() > VISIBLE].astype(np.float64)
    if len(there) < 2:
        return points
    tree = cKDTree(there)
    clear = CLEAR * float(np.median(tree.query(there, k=2)[0][:, 1]))
    return points[tree.query(points, distance_upper_bound=clear)[0] > clear]


def _surface_of(hull: NDArray[np.float64], views: Sequence[View]) -> tuple[NDArray[np.float64], ...]:
    """The points of a hull (P, 3) that at least three views see first, or two where there are fewer than six views.

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


def _box(g: Gaussians) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (3,) of the box that holds all but the farthest hundredths, and a fifth more on every side."""
    visible = g.means[g.opacities() > VISIBLE].astype(np.float64)
    low, high = np.quantile(visible if len(visible) else g.means, [0.01, 0.99], axis=0)
    return low - 0.2 * (high - low), high + 0.2 * (high - low)


def in_open_space(g: Gaussians, cameras: Sequence[Camera], renderer: Renderer = CPU) -> NDArray[np.bool_]:
    """(N,) rows that no camera sees from as near as viewers may be, and that are seen from one side, or seen past.

    At what depth a thing is that one camera sees, or two beside each other, pictures hardly tell: the fit puts it
    elsewhere as well.
    """
    loaded, opacities, means = renderer.load(g), g.opacities(), g.means.astype(np.float64)
    nearest, (behind, weight, count) = np.full(len(g), np.inf), np.zeros((3, len(g)))
    towards = np.zeros((len(g), 3))
    for camera in (resized(camera, SHRUNK) for camera in cameras):
        found = loaded.contribution(camera)
        depths = means @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
        colours = np.repeat(((depths - 0.5) / SH_C0).astype(np.float32)[:, None], 3, axis=1)
        picture = renderer.render(replace(g, sh_dc=colours, sh_rest=g.sh_rest[:, :0]), camera, BLACK)
        rows, columns, inside = project(camera, means)
        opaque = np.maximum(1 - picture.transmittance, np.finfo(np.float32).eps)
        past = (picture.rgb[..., 0] / opaque)[rows, columns] - depths[inside]
        behind[inside] += found.total[inside] * past
        weight[inside] += found.total[inside]
        seen, drawn = found.peak > CLEARLY * opacities, found.hits > 0
        to = camera.position - means
        distances = np.linalg.norm(to, axis=1)
        nearest[seen] = np.minimum(nearest, distances)[seen]
        count += drawn
        towards[drawn] += (to / distances[:, None])[drawn]
    away = cKDTree(_places(cameras)).query(means)[0]
    one_way = np.linalg.norm(towards, axis=1) > ONE_WAY * count
    return np.isfinite(nearest) & (nearest > NEARER * away) & (one_way | (behind > BEHIND * away * weight))


def _places(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """(P, 3) where viewers may be: at cameras, and between neighbours."""
    at = np.stack([camera.position for camera in cameras])
    between = [(at[a] + at[b]) / 2 for a, b in neighbours(cameras, AROUND)]
    return np.concatenate([at, np.reshape(between, (-1, 3))])
