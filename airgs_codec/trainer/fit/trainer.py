"""What all fits of a run share, and those behind its first frame: of a frame in a group, and of a keyframe.

N Gaussians, U of them those of the frame before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.progress import Progress, silent
from airgs_codec.render.backend import CPU, Renderer, open_renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.data.plates import Masks
from airgs_codec.trainer.fit.active import Resting, Scope, find_active
from airgs_codec.trainer.fit.grow import (
    LOW_OPACITY,
    Densifier,
    Growth,
    find_wrong,
    growth_of_3dgs,
    in_open_space,
    residual_seeds,
)
from airgs_codec.trainer.fit.losses import better, codec_steps, mean_psnr, temporal_weights
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.parameters import (
    ATTRIBUTES,
    InMotion,
    Parameters,
    from_gaussians,
    to_gaussians,
    to_moving,
    with_motion,
    zeros_like,
)
from airgs_codec.trainer.fit.points import scene_extent
from airgs_codec.trainer.fit.variables import MlpDriven, Networks, PerGaussian, Rates, Regularisers
from airgs_codec.trainer.settings import BUDGET, MOST_BUDGET, RANDOM, TrainSettings

HIDDEN_OPACITY = 0.02  # fainter rows are removed at the end of a fit within the budget; of a keyframe only added ones
MOVING_RATES = Rates(factor=10.0, means=0.5, last=0.1, means_last=0.1)  # of frames that start from the one before
KEY_RATES = Rates(factor=8.0, last=0.05, means_last=0.05)  # what has appeared has far to go
UNFORESEEN = 1.5  # times as many iterations for a frame to which its velocity does not lead
MLP_SHARE = 0.5  # of the iterations of mlp+residual


@dataclass(frozen=True, slots=True, eq=False)
class FrameViews:
    """A frame and the views that it is fitted to."""

    frame: int
    views: Sequence[View]
    moving: Sequence[NDArray[np.bool_]] | None = None  # (H, W) of each view, what does not rest now or in the frame
    # before; None: not known, anything may move
    later: Sequence[View] = ()  # of the frame behind, which a first frame is fitted to as well


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """The measures and networks that the frames of a group share."""

    first_psnr: float  # dB, mean over training views of its first frame
    steps: Parameters  # codec steps at its first frame
    networks: Networks | None  # they learn on from frame to frame; None: frames move without
    second_psnr: float | None = None  # dB, of the frame behind it, where that is known


@dataclass(frozen=True, slots=True)
class Trainer:
    """The settings, the extent and the renderer that all fits of a run share."""

    settings: TrainSettings
    extent: float  # of the scene in world units
    renderer: Renderer = CPU

    @property
    def device(self) -> str:
        return self.renderer.device

    def fit_frame(self, target: FrameViews, before: InMotion, group: Group, progress: Progress = silent) -> Gaussians:
        """The Gaussians of the frame before, moved (AirGS, "Training" 2). Networks of the group learn on.

        Where the frame before shows more as it was, it stays: steps that are made for motion lead away from pictures
        that are right to less than a grey level. Raises TrainingError where the loss is not finite.
        """
        s = self.settings
        base = from_gaussians(before.gaussians, self.device)
        scope = self._scope(before, target, base)
        if scope.empty:
            return before.gaussians
        temporal = self._temporal(group.steps)
        start, iterations = None, s.frame_iterations
        if group.networks is None:
            if self._is_foreseen(before, target.views[::2]):
                start = self._start(base, before.velocity)
            else:
                iterations = round(UNFORESEEN * iterations)
        else:
            by_mlp = iterations if s.deltas == "mlp" else round(MLP_SHARE * iterations)
            iterations -= by_mlp
            driven = MlpDriven(base, group.networks, temporal)
            schedule = self.schedule("MLPs", by_mlp, self.full_sh_degree)
            optimise(driven, target.views, schedule, self.rng(target.frame, 1), progress=progress)
            moved = driven.detached()
            start = {name: moved[name] - base[name] for name in ATTRIBUTES}
        fitted = PerGaussian(
            scope.rows(base),
            self.extent,
            MOVING_RATES,
            None if start is None else scope.rows(start),
            None if temporal is None else scope.rows(temporal),
            s.temporal.until,
            resting=scope.resting,
        )
        schedule = self.schedule("motion", iterations, self.full_sh_degree, s.coarse)
        optimise(fitted, scope.views, schedule, self.rng(target.frame, 2), progress=progress)
        found = to_gaussians(fitted.detached())
        return better(before.gaussians, found, target.views[::2], self.renderer) if s.keep_better else found

    def fit_keyframe(
        self, target: FrameViews, before: InMotion, steps: Parameters, progress: Progress = silent
    ) -> InMotion:
        """The Gaussians of the frame before, moved, and new ones (AirGS, "Training" 3). The first U rows stay.

        `steps`: codec steps of the frame before. Raises TrainingError where the loss is not finite.
        """
        s = self.settings
        rows = len(before.gaussians)
        most = min(round((1 + s.max_growth) * rows), self.capacity) if s.densify == BUDGET else self.capacity
        rng = self.rng(target.frame, 3)
        seeds = self._seeds(target, before, most - rows, rng) if s.seeds else None
        base, temporal = from_gaussians(before.gaussians, self.device), self._temporal(steps)
        start = self._start(base, before.velocity)
        base = with_motion(base, target.views, before.velocity)
        start = None if start is None else zeros_like(base) | start
        scope = self._scope(before, target, base)
        if not scope.views:
            return before
        base = scope.rows(base)
        start = None if start is None else scope.rows(start)
        temporal = None if temporal is None else scope.rows(temporal)
        still = rows - len(base["means"])
        rows, most = rows - still, most - still
        if seeds is not None:
            new = with_motion(from_gaussians(seeds, self.device), target.views)
            zeros = zeros_like(new)  # seeds begin where they are, and no temporal loss holds them
            base = _joined(base, new)
            start = None if start is None else _joined(start, zeros)
            temporal = None if temporal is None else _joined(temporal, zeros)
        variables = PerGaussian(
            base,
            self.extent,
            KEY_RATES,
            start,
            temporal,
            s.temporal.until,
            fixed=rows,
            regularisers=Regularisers(inflation=s.inflation),
            densifier=Densifier(self.growth(most, scope.views), len(base["means"]), rng),
            clears=self.clears(target.views),
            resting=scope.resting,
        )
        schedule = self.schedule("keyframe", s.key_iterations, self.full_sh_degree)
        optimise(variables, scope.views, schedule, rng, progress=progress)
        variables.remove_fainter(self.least_opacity)
        return replace(to_moving(variables.detached()), cleared=variables.cleared)

    def start_group(self, g: Gaussians, views: Sequence[View]) -> Group:
        """The group whose first frame is `g`, seen by the training views of that frame."""
        return Group(mean_psnr(g, views, self.renderer), self.steps(g, views), self.networks(g))

    def steps(self, g: Gaussians, views: Sequence[View]) -> Parameters:
        """Codec steps where the Gaussians are, on the device; see `codec_steps`."""
        steps = codec_steps(g, [v.camera for v in views], renderer=self.renderer)
        return {name: s.to(self.device) for name, s in steps.items()}

    def networks(self, g: Gaussians) -> Networks | None:
        if self.settings.deltas == "direct":
            return None
        return Networks(from_gaussians(g, self.device), self.extent, self.settings.seed).to(self.device)

    @property
    def capacity(self) -> int:
        return self.settings.capacity or max(MOST_BUDGET, self.settings.budget or 1)

    @property
    def least_opacity(self) -> float:
        """Return the opacity under which rows are removed at the end of a fit that added some."""
        return HIDDEN_OPACITY if self.settings.densify == BUDGET else LOW_OPACITY

    def growth(self, most: int, views: Sequence[View]) -> Growth:
        s = self.settings
        return Growth(most) if s.densify == BUDGET else growth_of_3dgs(most, min(s.iteration_views, len(views)))

    def clears(self, views: Sequence[View]) -> Callable[[Gaussians], NDArray[np.bool_]] | None:
        """What finds rows that hang in open space; None: 3DGS keeps them."""
        if self.settings.densify != BUDGET:
            return None
        return partial(in_open_space, cameras=[view.camera for view in views], renderer=self.renderer)

    def _seeds(self, target: FrameViews, before: InMotion, most: int, rng: np.random.Generator) -> Gaussians | None:
        """Up to `most` new Gaussians of a keyframe, where the pictures of the frame before are wrong; None: nowhere."""
        wrong = find_wrong(before, target.views, self.renderer)
        if target.moving is not None:  # what rests is not drawn: nothing could be fitted there
            wrong = Masks(a & b for a, b in zip(wrong, target.moving, strict=True))
        return residual_seeds(before.gaussians, target.views, wrong, most, 0.1 * self.extent, rng)

    def rng(self, frame: int, stage: int) -> np.random.Generator:
        """Its own random numbers for every stage of every frame, so that a run can go on anywhere."""
        return np.random.default_rng([self.settings.seed, frame, stage])

    def _temporal(self, steps: Parameters) -> Parameters | None:
        temporal = self.settings.temporal
        return temporal_weights(temporal, steps) if temporal.weight else None

    def _scope(self, before: InMotion, target: FrameViews, base: Parameters) -> Scope:
        if target.moving is None:
            return Scope(target.views)
        active = find_active(before, target.views, target.moving, self.renderer)
        return Scope(active.views, Resting(base, torch.from_numpy(active.rows).to(self.device)))

    def _is_foreseen(self, before: InMotion, views: Sequence[View]) -> bool:
        """Whether Gaussians that move on as they did are nearer to the pictures than where they were.

        Where a motion turns, its start is worse than none, and there is further to go.
        """
        if before.velocity is None or not self.settings.velocity:
            return False
        on = InMotion(before.at(1.0), before.velocity)
        return mean_psnr(on, views, self.renderer) > mean_psnr(before.gaussians, views, self.renderer)

    def _start(self, base: Parameters, velocity: NDArray[np.float32] | None) -> Parameters | None:
        """A difference that goes on as the Gaussians moved before; None: 0."""
        if velocity is None or not self.settings.velocity:
            return None
        return zeros_like(base) | {"means": torch.from_numpy(velocity.astype(np.float32)).to(self.device)}

    def schedule(self, stage: str, iterations: int, sh_degree: Callable[[float], int], coarse: float = 0.0) -> Schedule:
        """A fit of so many iterations, as the settings have it; see `Schedule`."""
        s = self.settings
        return Schedule(stage, iterations, sh_degree, s.background == RANDOM, s.iteration_views, s.ssim_weight, coarse)

    def full_sh_degree(self, done: float) -> int:
        return self.settings.sh_degree


def make_trainer(settings: TrainSettings, views: Sequence[View], points: Points | None, device: str) -> Trainer:
    """The trainer of a scene whose first frame is seen by these views; `device`: cpu or cuda."""
    return Trainer(settings, scene_extent([view.camera for view in views], points), open_renderer(device))


def _joined(a: Parameters, b: Parameters) -> Parameters:
    return {name: torch.cat([value, b[name]]) for name, value in a.items()}
