"""3D Gaussian Splatting (Kerbl et al. 2023) as its paper has it: thresholds, opacity reset, no budget. N Gaussians."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from airgs_codec.errors import TrainingError
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.fit.grow import LOW_OPACITY, is_visible, split_or_clone
from airgs_codec.trainer.fit.parameters import Adam, Parameters, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.variables import Rates

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

    def __init__(self, start: Gaussians, extent: float, timetable: Timetable, seed: int, rate: float = 1.0) -> None:
        """`extent`: of the scene in world units. `seed`: of what splitting draws. `rate`: factor on learning rates."""
        self.timetable = timetable
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
            lengths, seen = self._absgrad.signed()
            self._sum += lengths
            self._count += seen
        self._adam.rates = self._rates.at(iteration / iterations, self._extent)
        self._adam.step()
        with torch.no_grad():
            if self.timetable.densifies(iteration):
                self._densify(iteration)
            if self.timetable.resets(iteration):
                self._adam.replace_values("opacity_logits", reset_opacity(self._adam.parameters["opacity_logits"]))

    def _restart(self) -> None:
        self._sum, self._count = torch.zeros(2, len(self._adam.parameters["means"]))

    def _densify(self, iteration: int) -> None:
        p = self._adam.parameters
        mean = self._sum / self._count.clamp_min(1)  # 0 / 0: no picture showed it
        parents, split = chosen(p, mean, self.timetable.gradient, self._extent)
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
