"""The loop that matches Gaussians to pictures: first frames, keyframes and frames in a group all run through it.

What is fitted is a difference D to base Gaussians, so that the temporal loss is a norm of the variable itself and
vanishes exactly where pictures ask for nothing. N Gaussians, U of them rows that stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch

from airgs_codec.errors import AirgsError
from airgs_codec.render.absgrad import Pull
from airgs_codec.train.data.multiview import View
from airgs_codec.train.fit.densify import Growth, Pulls, grow, prune
from airgs_codec.train.fit.exposure import Tones
from airgs_codec.train.fit.parameters import ATTRIBUTES, RATES, Adam, Parameters, render
from airgs_codec.train.loss.losses import LAMBDA, photometric

SETTLED = 0.65  # of the iterations, then what moves is decided; later than rows are added
LARGE = 0.003  # of the extent: larger Gaussians are split, smaller ones cloned

Tick = Callable[[int, int], None]  # iterations done, of


class TrainingError(AirgsError, RuntimeError):
    """The optimisation went wrong: a loss that is not finite."""


class Variables(Protocol):
    """What an iteration moves."""

    def current(self) -> Parameters:
        """The Gaussians as they are now, differentiable by the variables."""

    def penalty(self) -> torch.Tensor | float:
        """What is added to the loss of the pictures."""

    def step(self, done: float) -> None:
        """Along the gradients; a share `done` of the iterations is past."""


@dataclass(frozen=True, slots=True)
class Rates:
    """Factors on 3DGS's learning rates, made for 30,000 iterations, and where they decay to."""

    factor: float = 3.0
    means: float = 1.0  # another one, for means
    last: float = 1.0  # of the rate at the end
    means_last: float = 0.01

    def at(self, done: float, extent: float) -> dict[str, float]:
        """Rates when a share `done` of the iterations is past, in a scene of `extent` world units."""
        rates = {name: rate * self.factor * self.last**done for name, rate in RATES.items()}
        rates["means"] = RATES["means"] * self.factor * self.means * self.means_last**done * extent
        return rates


@dataclass(slots=True, eq=False)
class Free:
    """A difference of every Gaussian on its own, with rows that may come and go."""

    base: Parameters
    extent: float  # world units
    rates: Rates = field(default_factory=Rates)
    shrink: Parameters | None = None  # weight of |D| an element: `Temporal.weights`, 0 for rows that are new
    kept: int = 0  # rows that stay where they are
    opacity_weight: float = 0.0  # of the mean opacity
    scale_weight: float = 0.0  # of the mean size over the extent
    inflation: float = 0.0  # of the summed opacity of the rows past `kept`
    start: Parameters | None = None  # D to begin with; None: 0
    adam: Adam = field(init=False)
    _support: Parameters | None = field(init=False, default=None)  # 1 where D may still change

    def __post_init__(self) -> None:
        begin = self.start or {name: torch.zeros_like(p) for name, p in self.base.items()}
        self.adam = Adam(begin, self.rates.at(0.0, self.extent))

    def current(self) -> Parameters:
        """base + D."""
        return {name: self.base[name] + self.adam.parameters[name] for name in ATTRIBUTES}

    def penalty(self) -> torch.Tensor | float:
        """Regularisers and the inflation loss.

        L_inf = max(0, N - U) (AirGS, "Training" 3) has no gradient; what can act is the opacity of what was added.
        """
        total: torch.Tensor | float = 0.0
        if self.opacity_weight or self.inflation:
            opacity = (self.base["opacity_logits"] + self.adam.parameters["opacity_logits"]).sigmoid()
            if self.opacity_weight:
                total = total + self.opacity_weight * opacity.mean()
            if self.inflation and len(opacity) > self.kept:
                total = total + self.inflation * opacity[self.kept :].sum()
        if self.scale_weight:
            size = (self.base["log_scales"] + self.adam.parameters["log_scales"]).exp()
            total = total + self.scale_weight / self.extent * size.mean()
        return total

    def step(self, done: float) -> None:
        """Adam, the temporal loss, and no Gaussian larger than the scene.

        The temporal loss pulls back what does move, too. When it has had its say (SETTLED), what is still 0 stays so,
        and the rest is fitted without it (the relaxed lasso, Meinshausen 2007).
        """
        self.adam.rates = self.rates.at(done, self.extent)
        if self.shrink is not None and done > SETTLED:
            if self._support is None:
                self._support = {name: (p != 0).to(p.dtype) for name, p in self.adam.parameters.items()}
                for name, weight in self.shrink.items():  # rows without a temporal loss: new ones
                    self._support[name][weight == 0] = 1
            self.adam.step()
        else:
            self.adam.step(self.shrink)
        with torch.no_grad():
            for name, mask in (self._support or {}).items():
                self.adam.parameters[name].mul_(mask)
            # Past this size gradients of means and rotations are rounding noise.
            sizes = self.adam.parameters["log_scales"]
            sizes.copy_(torch.minimum(sizes, math.log(self.extent) - self.base["log_scales"]))

    def refine(self, growth: Growth, before: int, done: float, pulls: Pulls, rng: np.random.Generator) -> None:
        """Add rows up to the growth's target and remove those that show nothing."""
        now = {name: p.detach() for name, p in self.current().items()}
        wanted = growth.target(before, done) - len(now["means"])
        keep, added = grow(now, pulls.mean(), wanted, LARGE * self.extent, self.kept, rng)
        self._replace(keep, added)
        self._replace(prune(self.detached(), self.kept), None)

    def drop(self, low: float) -> None:
        """Remove rows past `kept` whose opacity is under `low`."""
        self._replace(prune(self.detached(), self.kept, low), None)

    def _replace(self, keep: torch.Tensor, added: Parameters | None) -> None:
        if added is None and bool(keep.all()):
            return
        zeros = None if added is None else {name: torch.zeros_like(p) for name, p in added.items()}
        self.adam.replace_rows(keep, zeros)

        def grown(old: Parameters, new: Parameters | None) -> Parameters:
            return {n: old[n][keep] if new is None else torch.cat([old[n][keep], new[n]]) for n in ATTRIBUTES}

        self.base = grown(self.base, added)
        if self.shrink is not None:
            self.shrink = grown(self.shrink, zeros)
        if self._support is not None:
            self._support = grown(self._support, None)

    def detached(self) -> Parameters:
        """The Gaussians as they are now."""
        return {name: p.detach() for name, p in self.current().items()}


def match(
    variables: Variables,
    views: Sequence[View],
    iterations: int,
    rng: np.random.Generator,
    sh_degree: Callable[[float], int],
    *,
    growth: Growth | None = None,
    weight: float = LAMBDA,
    tones: Tones | None = None,
    tick: Tick = lambda done, of: None,
) -> None:
    """Fit `variables` to `views` in random order; with `growth` (for `Free`) rows are added on the way.

    `tones` of the views are fitted along.

    `sh_degree`: bands in use when a share of the iterations is past. Raises TrainingError when the loss is not finite.
    """
    deck: list[int] = []
    before = len(variables.current()["means"])
    pulls = Pulls(before)
    for iteration in range(1, iterations + 1):
        done = iteration / iterations
        if not deck:
            deck = rng.permutation(len(views)).tolist()
        index = deck.pop()
        view = views[index]
        pull = Pull() if growth else None
        rgb, _ = render(variables.current(), view.camera, sh_degree(done), pull)
        if tones:
            rgb = tones.apply(rgb, index)
        loss = photometric(rgb, view.target, weight).loss + variables.penalty()
        if not math.isfinite(float(loss.detach())):
            raise TrainingError(f"the loss is not finite at iteration {iteration} in view {view.camera.name}")
        loss.backward()
        if pull is not None:
            pulls.add(pull)
        variables.step(done)
        if tones:
            tones.step()
        if growth and growth.due(iteration, iterations):
            assert isinstance(variables, Free)
            variables.refine(growth, before, done, pulls, rng)
            pulls = Pulls(len(variables.base["means"]))
        tick(iteration, iterations)
