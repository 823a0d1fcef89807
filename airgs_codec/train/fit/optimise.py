"""The loop that fits Gaussians to pictures: first frames, keyframes and frames in a group all run through it.

N Gaussians, V views.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from airgs_codec.errors import TrainingError
from airgs_codec.progress import Progress, silent
from airgs_codec.render.absgrad import AbsGrad
from airgs_codec.train.data.pictures import View
from airgs_codec.train.fit.exposure import ExposureModel
from airgs_codec.train.fit.parameters import Parameters, render
from airgs_codec.train.loss.photometric import photometric


class Variables(Protocol):
    """What an iteration moves."""

    def current(self) -> Parameters:
        """The Gaussians as they are now, differentiable by the variables."""

    def watch(self) -> AbsGrad | None:
        """Where the absolute gradients of the next picture are wanted; None: nowhere."""

    def penalty(self) -> torch.Tensor | float:
        """What is added to the loss of the picture."""

    def step(self, iteration: int, iterations: int) -> None:
        """Move along the gradients; this is iteration 1 .. iterations."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """How long a fit runs."""

    stage: str  # what is fitted, for progress
    iterations: int
    sh_degree: Callable[[float], int]  # SH degree in use when a share of the iterations is past
    random_background: bool = False  # whether every iteration has another one


def optimise(
    variables: Variables,
    views: Sequence[View],
    schedule: Schedule,
    rng: np.random.Generator,
    exposure: ExposureModel | None = None,
    progress: Progress = silent,
) -> None:
    """Fit `variables` to the V views in random order, each as often as the others.

    `exposure`: gains and offsets of the views' cameras, which are fitted too. Raises TrainingError when the loss is not
    finite.
    """
    deck: list[int] = []
    for iteration in range(1, schedule.iterations + 1):
        deck = deck or rng.permutation(len(views)).tolist()
        index = deck.pop()
        view = views[index]
        if schedule.random_background:
            view = view.before(tuple(rng.uniform(size=3).tolist()))
        sh_degree = schedule.sh_degree(iteration / schedule.iterations)
        rgb, _ = render(variables.current(), view.camera, sh_degree, variables.watch(), view.redraw)
        seen = exposure.apply(rgb, index) if exposure else rgb
        loss = photometric(seen, view.target).loss + variables.penalty()
        if not math.isfinite(float(loss.detach())):
            raise TrainingError(f"the loss is not finite at iteration {iteration} in view {view.camera.name}")
        loss.backward()
        variables.step(iteration, schedule.iterations)
        if exposure:
            exposure.step()
        progress(schedule.stage, iteration, schedule.iterations)
