"""3D Gaussian Splatting (Kerbl et al. 2023) as its paper has it, and the first baseline: every frame on its own.

Thresholds, opacity reset, no budget; a viewer fetches .ply files. N Gaussians.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch

from airgs_codec.errors import SceneError, TrainingError
from airgs_codec.progress import Progress
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.fit.grow import LOW_OPACITY, is_visible, split_or_clone, strongest
from airgs_codec.trainer.fit.losses import Parameters, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.optimise import Adam, Rates, Schedule, optimise
from airgs_codec.trainer.fit.points import from_points, initial_points, scene_extent
from tools.lab.baselines.method import Footage, Shown, frame_path

ITERATIONS = 30_000  # that the paper's constants are made for
GRADIENT = 2e-4  # mean length of the gradient by places that are -1..1 across the picture, from which rows are added
DENSE = 0.01  # of the scene's extent: Gaussians larger than this are split, others cloned
LARGEST = 0.1  # of the scene's extent: larger Gaussians are removed once opacity has been reset
RESET_OPACITY = 0.01
START_OPACITY = 0.1
SH_EVERY = 1_000  # iterations until each further SH band joins
RATES = Rates(factor=1.0)  # the learning rates of the paper; that of means decays to 1 %, the others stay


@dataclass(frozen=True, slots=True)
class Timetable:
    """When rows are added and removed and opacity is reset, in iterations counted from 1."""

    start: int = 500  # rows are added after this iteration
    stop: int = 15_000  # and before this one
    every: int = 100
    reset: int | None = 3_000  # how often opacity is reset; None: never
    gradient: float = GRADIENT  # from which rows are added

    def scaled(self, factor: float) -> Timetable:
        """The same for a run that is `factor` times as long, but for `every`, and with one reset, half-way to `stop`.

        Were they shrunk, too, rows would multiply before those added last have settled, and opacity would not come back
        before it is reset again.
        """
        stop = round(self.stop * factor)
        reset = None if self.reset is None else max(1, (stop + 1) // 2)
        return replace(self, start=round(self.start * factor), stop=stop, reset=reset)

    def densifies(self, iteration: int) -> bool:
        return self.start < iteration < self.stop and iteration % self.every == 0

    def resets(self, iteration: int) -> bool:
        return self.reset is not None and iteration < self.stop and iteration % self.reset == 0

    def removes_large(self, iteration: int) -> bool:
        return self.reset is not None and iteration > self.reset


class Splats:
    """Gaussians that Adam fits, and the mean gradient by which their number grows: the variables of a fit."""

    def __init__(
        self, start: Gaussians, extent: float, timetable: Timetable, seed: int, rows: int | None, rate: float = 1.0
    ) -> None:
        """`extent`: in world units. `seed`: of what splitting draws. `rows`: most. `rate`: factor on learning rates."""
        self.timetable, self._rows = timetable, rows
        self._rates = replace(RATES, factor=rate)
        self._extent, self._seed = extent, seed
        self._adam = Adam(from_gaussians(start), self._rates.at(0.0, extent))
        self._absgrad = AbsGrad()
        self._restart()

    def current(self, after: float = 0.0) -> Parameters:
        return self._adam.parameters

    def gaussians(self) -> Gaussians:
        return to_gaussians(self._adam.parameters)

    def watch(self) -> AbsGrad:
        self._absgrad = AbsGrad()
        return self._absgrad

    def penalty(self) -> float:
        """0: nothing is added to the loss of the pictures."""
        return 0.0

    def step(self, iteration: int, iterations: int) -> None:
        """Move along the gradients; add and remove rows and reset opacity when the timetable says so.

        Raises TrainingError where no row is left.
        """
        if iteration < self.timetable.stop:
            lengths, seen = self._absgrad.read(signed=True)
            self._sum += lengths
            self._count += seen
        self._adam.rates = self._rates.at(iteration / iterations, self._extent)
        self._adam.step()
        with torch.no_grad():
            if self.timetable.densifies(iteration):
                self._densify(iteration)
            if self.timetable.resets(iteration):
                self._adam.parameters["opacity_logits"].copy_(reset_opacity(self._adam.parameters["opacity_logits"]))
                torch._foreach_zero_([moments["opacity_logits"] for moments in self._adam.moments])

    def _restart(self) -> None:
        self._sum, self._count = torch.zeros(2, len(self._adam.parameters["means"]))

    def _densify(self, iteration: int) -> None:
        p = self._adam.parameters
        mean = self._sum / self._count.clamp_min(1)  # 0 / 0: no picture showed it
        parents, split = chosen(p, mean, self.timetable.gradient, self._extent)
        if self._rows is not None:
            parents = strongest(torch.where(parents, mean, 0.0), self._rows - len(mean))
            split = split & parents
        rng = np.random.default_rng([self._seed, iteration])
        self._adam.replace_rows(*split_or_clone(p, parents, split, 0, rng))
        largest = LARGEST * self._extent if self.timetable.removes_large(iteration) else math.inf
        keep = is_kept(self._adam.parameters, largest)
        if not bool(keep.any()):
            raise TrainingError("expected pictures that show something, no Gaussian is left")
        self._adam.replace_rows(keep)
        self._restart()


def chosen(
    p: Mapping[str, torch.Tensor], mean: torch.Tensor, threshold: float, extent: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """(N,) masks of the rows that get a child, and of those of them that are split, from mean gradients (N,)."""
    parents = mean >= threshold
    return parents, parents & (p["log_scales"].amax(dim=1).exp() > DENSE * extent)


def is_kept(p: Parameters, largest: float) -> torch.Tensor:
    """(N,) mask of rows that are opaque enough to be seen and at most `largest` world units large."""
    return is_visible(p, 0, LOW_OPACITY) & (p["log_scales"].amax(dim=1).exp() <= largest)


def reset_opacity(logits: torch.Tensor) -> torch.Tensor:
    """Logits (N,) of which none is above that of RESET_OPACITY."""
    return logits.clamp_max(math.log(RESET_OPACITY / (1 - RESET_OPACITY)))


@dataclass(frozen=True, slots=True)
class Naive3dgs:
    """3DGS of every frame; the paper's schedule is shrunk to so many iterations."""

    iterations: int = 1_500
    sh_degree: int = 1
    gradient: float = 2 * GRADIENT  # from which rows are added
    rate: float = 3.0  # factor on the learning rates of the paper, which are made for 30,000 iterations
    points: int = 2_400  # fewest to start from; random ones fill up
    rows: int | None = None  # most Gaussians of a frame; None: as many as the gradient asks for
    seed: int = 0

    @property
    def name(self) -> str:
        return "naive3dgs"

    @property
    def settings(self) -> dict[str, object]:
        return asdict(self)

    def frames(self, footage: Footage, done: int, progress: Progress) -> Iterator[Shown]:
        """The frames from number `done` on. Raises SceneError where there is nothing to train on or to start from."""
        torch.set_num_threads(1)  # the renderer has threads of its own
        footage.folder.mkdir(parents=True, exist_ok=True)
        for t in range(done, footage.frames):
            g = self.fit(footage, t, progress)
            path = frame_path(footage.folder, t)
            write_ply(path, g)
            yield Shown("keyframe", g, path.stat().st_size)

    def fit(self, footage: Footage, frame: int, progress: Progress) -> Gaussians:
        """One frame, from the scene's points if it is the first, and from triangulated ones if not."""
        views = footage.pictures.train(frame)
        if not views:
            raise SceneError(f"expected training views of frame {frame}, got none")
        rng = np.random.default_rng([self.seed, frame])
        cloud = initial_points(None if frame else footage.points, views, self.points, rng)
        assert cloud.colours is not None  # `initial_points` gives every point one
        extent = scene_extent([view.camera for view in views], cloud)
        start = from_points(cloud.positions, cloud.colours, self.sh_degree, START_OPACITY, extent)
        timetable = Timetable(gradient=self.gradient).scaled(self.iterations / ITERATIONS)
        splats = Splats(start, extent, timetable, self.seed, self.rows, self.rate)
        schedule = Schedule(f"frame {frame} of {footage.frames}", self.iterations, self._sh_degree)
        optimise(splats, views, schedule, rng, progress=progress)
        return splats.gaussians()

    def _sh_degree(self, done: float) -> int:
        return min(self.sh_degree, int(done * ITERATIONS / SH_EVERY))
