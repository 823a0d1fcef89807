"""The fits of a run: of its first frame, of a frame in a group, and of a keyframe (AirGS, "Training" 1 to 3).

A fit may change only what moves. A row is active when a good part of its contribution to all pictures falls on pixels
that are not at rest; the other rows are no variables at all and stay as they are, bit for bit.

N Gaussians, A of them active, U of them those of the frame before, P points, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.progress import Progress, silent
from airgs_codec.render import cpu
from airgs_codec.render.backend import CPU, Renderer, open_renderer
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.data.pictures import FrameViews, Masks, Recent, View
from airgs_codec.trainer.fit.grow import (
    LOW_OPACITY,
    Densifier,
    Growth,
    find_wrong,
    growth_of_3dgs,
    in_open_space,
    residual_seeds,
)
from airgs_codec.trainer.fit.losses import (
    GAUSSIAN_FIELDS,
    InMotion,
    Parameters,
    better,
    codec_steps,
    from_gaussians,
    loading,
    mean_psnr,
    temporal_weights,
    to_gaussians,
    to_moving,
    with_motion,
    zeros_like,
)
from airgs_codec.trainer.fit.optimise import (
    ExposureModel,
    MlpDriven,
    Networks,
    PerGaussian,
    Rates,
    Resting,
    Schedule,
    any_in_blocks,
    optimise,
)
from airgs_codec.trainer.fit.points import from_points, initial_points, scene_extent, sparse_cloud
from airgs_codec.trainer.settings import BUDGET, LEAST_BUDGET, MOST_BUDGET, RANDOM, TrainSettings

# Empty space stays empty. Against no weights +0.3 dB in held-out views of a first frame of the fox; a weight of 0.1 in
# place of 0.03 on scales gave basketball 0.2 dB in two splits of its cameras (0.5 with their exposure matched).
FIRST_REGULARISERS: dict[str, Any] = {"opacity_weight": 0.003, "scale_weight": 0.1}
# Few cameras that are far apart leave much of a scene free: the points on its surfaces start opaque, and move little.
DROPOUT = 0.2
# More gave basketball, of 640 x 360 pixels, 0.8 dB in held-out views, and the fox, of 320 x 320, 0.2 to 0.4 for twice
# as many; in a sparse rig they showed less.
GAUSSIAN_PIXELS = 14  # of a picture, for each Gaussian
HIDDEN_OPACITY = 0.02  # fainter rows are removed at the end of a fit within the budget; of a keyframe only added ones
# Second moments that forget ten times sooner gave 0.3 dB in held-out views of the fox after 1,000 iterations.
FIRST_RATES = Rates(factor=6.0, last=0.1, late=0.7, second=0.99)
SPARSE_RATES = Rates(means=0.1)
COARSE = 0.4  # times the share of a frame's iterations that see pictures of half the size
# Of frames that start from the one before.
MOVING_RATES = Rates(factor=15.0, means=0.5, last=0.1, means_last=0.1, late=0.5, second=0.99)
KEYFRAME_RATES = Rates(factor=8.0, last=0.05, means_last=0.05)  # what has appeared has far to go
UNFORESEEN = 1.5  # times as many iterations for a frame to which its velocity does not lead


How = tuple[Schedule, np.random.Generator, ExposureModel | None, Progress]  # arguments of `optimise`


@dataclass(frozen=True, slots=True, eq=False)
class FitGroup:
    """The measures and networks that the frames of a group share."""

    first_psnr: float  # dB, mean over training views of its first frame
    steps: Parameters  # codec steps at its first frame
    networks: Networks | None  # trained on from frame to frame; None: frames move without
    second_psnr: float | None = None  # dB, of its second frame, where that is known


@dataclass(frozen=True, slots=True)
class Trainer:
    """The settings, the extent and the renderer that all fits of a run share."""

    settings: TrainSettings
    extent: float  # of the scene in world units
    renderer: Renderer = CPU

    @property
    def device(self) -> str:
        return self.renderer.device

    def fit_frame(
        self, target: FrameViews, before: InMotion, group: FitGroup, progress: Progress = silent
    ) -> Gaussians:
        """Move the Gaussians of the frame before (AirGS, "Training" 2), and train the networks of the group.

        Where the frame before shows more as it was, it stays: steps of the size of motion lead away from pictures that
        are right to less than a grey level. Raises TrainingError where the loss is not finite.
        """
        s, base = self.settings, from_gaussians(before.gaussians, self.device)
        views, resting = self._scope(before, target, base)
        if resting and not (len(resting.active) and views):
            return before.gaussians
        temporal = temporal_weights(s.temporal, group.steps)
        start, iterations = zeros_like(base), s.frame_iterations
        if group.networks is None:
            if self._is_foreseen(before, target.views[::2]):
                start = self._start(base, before)
            else:
                iterations = round(UNFORESEEN * iterations)
        else:
            by_mlp = iterations if s.deltas == "mlp" else round(0.5 * iterations)
            iterations -= by_mlp
            driven = MlpDriven(base, group.networks, temporal)
            optimise(driven, target.views, self.schedule("MLPs", by_mlp), self.rng(target.frame, 1), progress=progress)
            moved = driven.detached()
            start = {name: moved[name] - base[name] for name in GAUSSIAN_FIELDS}
        base, start, temporal = (resting.taken(p) if resting else p for p in (base, start, temporal))
        fitted = PerGaussian(base, self.extent, MOVING_RATES, start, temporal, s.temporal.until, resting=resting)
        schedule = replace(self.schedule("motion", iterations), coarse=s.coarse)
        optimise(fitted, views, schedule, self.rng(target.frame, 2), progress=progress)
        found = to_gaussians(fitted.detached())
        return better(before.gaussians, found, target.views[::2], self.renderer) if s.keep_better else found

    def fit_keyframe(
        self, target: FrameViews, before: InMotion, steps: Parameters, progress: Progress = silent
    ) -> InMotion:
        """Move the Gaussians of the frame before, and add new ones after its U rows (AirGS, "Training" 3).

        `steps`: codec steps of the frame before. Raises TrainingError where the loss is not finite.
        """
        s, rows = self.settings, len(before.gaussians)
        most = min(round((1 + s.max_growth) * rows), self.capacity) if s.densify == BUDGET else self.capacity
        rng = self.rng(target.frame, 3)
        seeds = self._seeds(target, before, most - rows, rng) if s.seeds else None
        base, temporal = from_gaussians(before.gaussians, self.device), temporal_weights(s.temporal, steps)
        base = with_motion(base, target.views, before.velocity)
        start = self._start(base, before)
        views, resting = self._scope(before, target, base)
        if not views:
            return before
        base, start, temporal = (resting.taken(p) if resting else p for p in (base, start, temporal))
        fixed = len(base["means"])
        if seeds is not None:
            new = with_motion(from_gaussians(seeds, self.device), target.views)
            zeros = zeros_like(new)  # seeds start without a difference, and without a temporal loss
            pairs = ((base, new), (start, zeros), (temporal, zeros))
            base, start, temporal = ({n: torch.cat([v, more[n]]) for n, v in p.items()} for p, more in pairs)
        known: dict[str, Any] = {"start": start, "temporal": temporal, "until": s.temporal.until, "fixed": fixed}
        known |= {"resting": resting, "rates": KEYFRAME_RATES, "inflation": s.inflation}
        how = self.schedule("keyframe", s.keyframe_iterations), rng, None, progress
        return self.fit_growing(base, (target.views, views), most - rows + fixed, how, **known)

    def fit_growing(
        self, base: Parameters, views: Sequence[Sequence[View]], most: int, how: How, **more: Any
    ) -> InMotion:
        """Fit rows to the second ones of the `views`, add others up to `most`, and remove what is hidden.

        Within a budget rows that hang in open space before the first ones are removed, too. `more`: of `PerGaussian`.
        """
        (every, shown), (schedule, rng, *_) = views, how
        within, cameras = self.settings.densify == BUDGET, [view.camera for view in every]
        growth = Growth(most) if within else growth_of_3dgs(most, min(schedule.views, len(every)))
        clears = partial(in_open_space, cameras=cameras, renderer=self.renderer) if within else None
        densifier = Densifier(growth, len(base["means"]), rng)
        variables = PerGaussian(base, self.extent, densifier=densifier, clears=clears, **more)
        optimise(variables, shown, *how)
        variables.remove_fainter(HIDDEN_OPACITY if within else LOW_OPACITY)
        return replace(to_moving(variables.detached()), cleared=variables.cleared)

    def start_group(self, g: Gaussians, views: Sequence[View]) -> FitGroup:
        networks = None
        if self.settings.deltas != "direct":
            networks = Networks(from_gaussians(g, self.device), self.extent, self.settings.seed).to(self.device)
        return FitGroup(mean_psnr(g, views, self.renderer), self.steps(g, views), networks)

    def steps(self, g: Gaussians, views: Sequence[View]) -> Parameters:
        steps = codec_steps(g, [v.camera for v in views], self.renderer)
        return {name: s.to(self.device) for name, s in steps.items()}

    @property
    def capacity(self) -> int:
        return self.settings.capacity or max(MOST_BUDGET, self.settings.budget or 1)

    def rng(self, frame: int, stage: int) -> np.random.Generator:
        """Return random numbers that depend on the stage and the frame alone, so that a run can be resumed."""
        return np.random.default_rng([self.settings.seed, frame, stage])

    def _seeds(self, target: FrameViews, before: InMotion, most: int, rng: np.random.Generator) -> Gaussians | None:
        wrong = find_wrong(before, target.views, self.renderer)
        if target.moving is not None:  # what is at rest is not drawn: nothing could be fitted there
            wrong = Masks(a & b for a, b in zip(wrong, target.moving, strict=True))
        return residual_seeds(before.gaussians, target.views, wrong, most, 0.1 * self.extent, rng)

    def _scope(self, before: InMotion, target: FrameViews, base: Parameters) -> tuple[Sequence[View], Resting | None]:
        """Return the views that a fit is made to, and the rows at rest; None: it may change all."""
        if target.moving is None:
            return target.views, None
        rows, views = find_active(before, target.views, target.moving, self.renderer)
        return views, Resting(base, torch.from_numpy(rows).to(self.device))

    def _is_foreseen(self, before: InMotion, views: Sequence[View]) -> bool:
        """Return whether Gaussians that move on as they did show more than where they were: motions turn."""
        if before.velocity is None or not self.settings.velocity:
            return False
        on = InMotion(before.at(1.0), before.velocity)
        return mean_psnr(on, views, self.renderer) > mean_psnr(before.gaussians, views, self.renderer)

    def _start(self, base: Parameters, before: InMotion) -> Parameters:
        if before.velocity is None or not self.settings.velocity:
            return zeros_like(base)
        return zeros_like(base) | {"means": torch.from_numpy(before.velocity.astype(np.float32)).to(self.device)}

    def schedule(self, stage: str, iterations: int) -> Schedule:
        s = self.settings
        random = s.background == RANDOM
        return Schedule(stage, iterations, lambda _: s.sh_degree, random, s.iteration_views, s.ssim_weight)


def make_trainer(settings: TrainSettings, views: Sequence[View], points: Points | None, device: str) -> Trainer:
    return Trainer(settings, scene_extent([view.camera for view in views], points), open_renderer(device))


def fit_first(
    trainer: Trainer,
    target: FrameViews,
    points: Points | None,
    exposure: ExposureModel | None = None,
    progress: Progress = silent,
) -> InMotion:
    """Fit 3DGS to a first frame from a cloud of points (AirGS, "Training" 1), within any budget of the settings.

    `points`: the cloud; None to find one in the pictures. `exposure`: gains and offsets of the views' cameras, which
    are fitted too. Raises SceneError without points to start from, TrainingError where the loss is not finite or no
    Gaussian remains.
    """
    s, rng, views = trainer.settings, trainer.rng(target.frame, 0), target.views
    within = s.densify == BUDGET
    sparse = sparse_cloud(points, views, s.budget or LEAST_BUDGET, rng) if within else None
    few = s.budget or (LEAST_BUDGET if sparse else usual_budget([view.camera for view in views]))
    fewest, most = (round(0.3 * few), few) if within else (0, s.budget or trainer.capacity)
    cloud, unseen = sparse or (initial_points(points, views, fewest, rng), None)
    most -= len(unseen.positions) if unseen else 0
    chosen, largest = np.sort(rng.permutation(len(cloud.positions))[:most]), 0.1 * trainer.extent
    assert cloud.colours is not None  # both give every point one
    start = from_points(cloud.positions[chosen], cloud.colours[chosen], s.sh_degree, 0.6 if sparse else 0.1, largest)
    base, more = with_motion(from_gaussians(start, trainer.device), views), dict[str, Any](seed=s.seed)
    more |= {"rates": SPARSE_RATES, "dropout": DROPOUT} if sparse else {"rates": FIRST_RATES}
    more |= FIRST_REGULARISERS if s.regularised else {}
    schedule = trainer.schedule("first frame", s.iterations_from_scratch(len(views)))
    schedule = replace(schedule, sh_degree=lambda done: min(s.sh_degree, int(4 * done)), coarse=COARSE * s.coarse)
    found = trainer.fit_growing(base, (views, views), most, (schedule, rng, exposure, progress), **more)
    if not (unseen and len(unseen.positions)):
        return found
    assert unseen.colours is not None
    added = from_points(unseen.positions, unseen.colours, s.sh_degree, 0.95, largest)
    motion = None if found.velocity is None else np.pad(found.velocity, ((0, len(added)), (0, 0)))
    return replace(found, gaussians=Gaussians.join([found.gaussians, added]), velocity=motion)


def usual_budget(cameras: Sequence[Camera]) -> int:
    """Return the Gaussians of a first frame where nobody says how many, by the size of the pictures."""
    pixels = float(np.mean([camera.width * camera.height for camera in cameras]))
    return round(min(max(LEAST_BUDGET, pixels / GAUSSIAN_PIXELS), MOST_BUDGET))


def find_active(
    before: Gaussians | InMotion, views: Sequence[View], moving: Sequence[NDArray[np.bool_]], renderer: Renderer = CPU
) -> tuple[NDArray[np.intp], list[View]]:
    """Find what may change, from the Gaussians of the frame before and what moves (H, W) in each view.

    Returns the rows (A,), ascending, and the views that show them, with the tiles that do. A row is active if a fifth
    of its blending weights over all views falls on moving pixels, and a tile is drawn with 8 pixels of active rows.
    """
    loaded, rows = loading(before, renderer), len(before.gaussians if isinstance(before, InMotion) else before)
    renders = Recent[int, cpu.Render](lambda i: loaded(views[i].after).draw(views[i].camera), 1 << 30)  # bytes
    weights, on_moving, whole = [], np.zeros(rows), np.zeros(rows)
    for place, (view, mask) in enumerate(zip(views, moving, strict=True)):
        w = loaded(view.after).weights(view.camera, mask)
        on_moving += np.bincount(w.ids, w.inside, rows)
        whole += np.bincount(w.ids, w.total, rows)
        renders.put(place, w.picture)
        weights.append((w.shape, w.tiles, w.ids, w.total))
    active = on_moving > 0.2 * np.maximum(whole, 1e-9)
    drawn = []
    for place, (view, mask, (shape, of_pair, ids, total)) in enumerate(zip(views, moving, weights, strict=True)):
        shown = np.bincount(of_pair, total * active[ids], shape[0] * shape[1]).reshape(shape)
        tiles = (shown >= 8) | any_in_blocks(mask, cpu.TILE, shape)
        if tiles.any():
            drawn.append(replace(view, redraw=cpu.Redraw(tiles, partial(renders.get, place), active)))
    return np.flatnonzero(active), drawn
