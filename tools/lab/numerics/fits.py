"""Where the trainer's steps are stable: small fits over learning rates and what makes a scene stiff.

The map of an axis has a panel for each method and a row for each factor on the trainer's rates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import torch

from airgs_codec.render import cpu
from airgs_codec.trainer.data.pictures import TargetPicture, View
from airgs_codec.trainer.fit import losses
from airgs_codec.trainer.fit.losses import Parameters, from_gaussians, photometric, render_views, to_gaussians
from airgs_codec.trainer.fit.optimise import Adam, PerGaussian, Schedule, optimise
from airgs_codec.trainer.fit.points import limited
from airgs_codec.trainer.fit.trainer import MOVING_RATES
from airgs_codec.trainer.settings import TrainSettings
from tools.lab.numerics.outcome import INVISIBLE, UNFIT, Case, Judged, fit_end, grid
from tools.lab.numerics.problems import AXES, EXTENT, Axis, Problem, needles

METHODS = TRAINER, COMMON, DESCENT, UNSCALED = (
    "the trainer's Adam", "Adam, epsilon 1e-8", "gradient descent", "descent, no scaling",
)  # fmt: skip
FACTORS = (0.1, 1.0, 10.0, 100.0)  # on the trainer's learning rates
ITERATIONS = 30
COMMON_EPSILON = 1e-8  # Adam's, in Kingma and Ba and in torch

Steps = Callable[[Adam], Adam]


class Descent(Adam):
    """Gradient descent: a step is a rate times a unit times the gradient, whatever the size of the gradient."""

    def __init__(self, parameters: Parameters, rates: Mapping[str, float], units: Mapping[str, float]):
        super().__init__(parameters, rates)
        self._units = dict(units)

    @torch.no_grad()
    def step(self, shrink: Mapping[str, torch.Tensor] | None = None) -> None:
        """One step along the gradients, which are cleared; `shrink` as in Adam."""
        for name, p in self.parameters.items():
            if p.grad is None:
                continue
            length = self.rates[name] * self._units[name]
            p.sub_(length * p.grad)
            if shrink and name in shrink:
                p.copy_(p.sign() * (p.abs() - length * shrink[name]).clamp_min(0))
            p.grad = None


@cache
def methods() -> dict[str, Steps]:
    """The trainer's way to step, and those that were rejected.

    Gradient descent has units in which its first step on round Gaussians in the middle of the scene is as long as
    Adam's: one for each attribute, or that of the means for all.
    """
    units = gradient_units()
    alike = dict.fromkeys(units, units["means"])
    return {
        TRAINER: lambda adam: adam,
        COMMON: lambda adam: Adam(adam.parameters, adam.rates, COMMON_EPSILON),
        DESCENT: lambda adam: Descent(adam.parameters, adam.rates, units),
        UNSCALED: lambda adam: Descent(adam.parameters, _at_rate_of_means(adam), alike),
    }


def _at_rate_of_means(adam: Adam) -> dict[str, float]:
    return dict.fromkeys(adam.rates, adam.rates["means"])


def gradient_units() -> dict[str, float]:
    """1 over the root mean square of the gradients of each attribute at the start of the mildest fit."""
    problem = needles(1.0)
    parameters = {name: p.requires_grad_(True) for name, p in from_gaussians(problem.start).items()}
    loss(parameters, views_of(problem)).backward()
    sizes = {n: float(p.grad.square().mean().sqrt()) for n, p in parameters.items() if p.grad is not None and p.numel()}
    return {name: 1 / sizes[name] if sizes.get(name) else 1.0 for name in parameters}


def views_of(problem: Problem) -> list[View]:
    return [View(c, TargetPicture(np.clip(cpu.render(problem.target, c).rgb, 0, 1))) for c in problem.cameras]


def loss(parameters: Parameters, views: Sequence[View]) -> torch.Tensor:
    pictures, _ = render_views(parameters, [view.camera for view in views], 0)
    return photometric(pictures, [view.target for view in views]).mean()


def fit(
    problem: Problem, steps: Steps, factor: float, iterations: int = ITERATIONS, keep_better: bool = True
) -> Judged:
    """End of a fit, its loss over that at the start, and a note. Raises TrainingError as the trainer does.

    `keep_better`: a frame after another one is taken only where it shows no less, as in the trainer.
    """
    views = views_of(problem)
    base = from_gaussians(problem.start)
    variables = PerGaussian(
        base,
        limited(EXTENT, np.stack([camera.position for camera in problem.cameras]), problem.start.means),
        replace(problem.rates, factor=problem.rates.factor * factor),
        temporal=_price_of_changes(problem) if problem.temporal else None,
    )
    variables.adam = steps(variables.adam)
    with torch.no_grad():
        before = float(loss(base, views))
    optimise(variables, views, Schedule("fit", iterations, lambda done: 0), np.random.default_rng(0))
    after = variables.detached()
    if keep_better and problem.rates == MOVING_RATES:  # a frame after another one
        shown = losses.better(problem.start, to_gaussians(after), views)
        after = base if shown is problem.start else after
    finite = all(bool(torch.isfinite(p).all()) for p in after.values())
    with torch.no_grad():
        left = float(loss(after, views))
    moved = after is not base and any(bool((p.detach() != 0).any()) for p in variables.adam.parameters.values())
    end = fit_end(before, left, finite)
    words = ""
    if not any(view.target.rgb.any() for view in views):
        end, words = UNFIT, "nothing is drawn"
    elif not moved and max(before, left) >= INVISIBLE:
        end, words = UNFIT, "nothing moves"
    return end, left / before if before else 1.0, words


def _price_of_changes(problem: Problem) -> Parameters:
    return losses.temporal_weights(TrainSettings().temporal, losses.codec_steps(problem.start, problem.cameras))


def judge(axis: Axis, name: str, factor: str, value: float) -> Judged:
    return fit(axis.make(value), methods()[name], float(factor), keep_better=name == TRAINER)


def cases() -> list[Case]:
    rows = [f"{factor:g}" for factor in FACTORS]
    return [
        Case(
            part="trainer", name=f"train-{axis.name}", title=axis.title, own=(TRAINER, "1"),
            points=grid(METHODS, rows, axis.values), judge=partial(judge, axis),
        )
        for axis in AXES
    ]  # fmt: skip
