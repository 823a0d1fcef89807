"""What a fit changes, and the loop that fits it to pictures: first frames, keyframes and frames in a group.

Variables are every Gaussian on its own, where rows may come and go, or six MLPs that move all, one for each attribute
(AirGS, "Training" 2). Every Gaussian has a difference D to base Gaussians, so that the temporal loss is a norm of the
variable itself and vanishes exactly where pictures ask for nothing. A fit may begin with pictures of half the size:
large motion is a small one there, and an iteration costs less.

N Gaussians, A of them active, U of them rows that stay, V views, F features, H x W pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.errors import TrainingError
from airgs_codec.media.image import resize
from airgs_codec.progress import Progress, silent
from airgs_codec.render.cpu import TILE, Render
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.render.cuda import Picture as Drawn
from airgs_codec.scene.camera import with_pixels
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import Target, View
from airgs_codec.trainer.fit.grow import CHECKS, Densifier, is_visible
from airgs_codec.trainer.fit.losses import (
    ATTRIBUTES,
    LAMBDA,
    MOTION,
    Parameters,
    photometric,
    render_views,
    take_and_append,
    to_gaussians,
    zeros_like,
)

BETAS = (0.9, 0.999)
# Adam divides by the size of the gradient: without a floor it would move attributes that pictures do not depend on
# (the rotation of a ball) as far as others, by rounding noise. Gradients of pictures are 1e-8 and more.
EPSILON = 1e-12


class Adam:
    """Adam (Kingma and Ba 2015) over named tensors whose rows may come and go."""

    def __init__(
        self, parameters: Mapping[str, torch.Tensor], rates: Mapping[str, float], epsilon: float = EPSILON
    ) -> None:
        """`parameters` are copied and made leaves; `rates` may be changed between steps through `self.rates`."""
        self._epsilon = epsilon
        self.parameters = {name: p.detach().clone().requires_grad_(True) for name, p in parameters.items()}
        self.rates = dict(rates)
        self._first, self._second = zeros_like(parameters), zeros_like(parameters)  # moments
        self._steps = 0

    @torch.no_grad()
    def step(self, shrink: Mapping[str, torch.Tensor] | None = None) -> None:
        """One step along the gradients, which are cleared.

        `shrink`: weights of an L1 norm of the parameters, in units of the loss, applied by its proximal map in Adam's
        metric: what the pictures do not hold at another value ends at exactly 0.
        """
        self._steps += 1
        bias = [1 - beta**self._steps for beta in BETAS]
        for name, p in self.parameters.items():
            if p.grad is None:
                continue
            first, second = self._first[name], self._second[name]
            first.lerp_(p.grad, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(p.grad, p.grad, value=1 - BETAS[1])
            scale = (second / bias[1]).sqrt_().add_(self._epsilon)
            p.addcdiv_(first, scale, value=-self.rates[name] / bias[0])
            if shrink and name in shrink:
                threshold = self.rates[name] * shrink[name] / scale
                p.copy_(p.sign() * (p.abs() - threshold).clamp_min(0))
            p.grad = None

    def replace_values(self, name: str, values: torch.Tensor) -> None:
        """Give a parameter other values; its moments start at 0 again."""
        self.parameters[name] = values.detach().clone().requires_grad_(True)
        for moments in (self._first, self._second):
            moments[name] = torch.zeros_like(values)

    def replace_rows(self, keep: torch.Tensor, added: Mapping[str, torch.Tensor] | None = None) -> None:
        """Keep the rows of a mask (N,), in order, and append new ones, whose moments start at 0."""
        rows = take_and_append({name: p.detach() for name, p in self.parameters.items()}, keep, added)
        self.parameters = {name: p.requires_grad_(True) for name, p in rows.items()}
        zeros = None if added is None else zeros_like(added)
        self._first, self._second = (take_and_append(m, keep, zeros) for m in (self._first, self._second))


# Adam's steps of 3DGS (Kerbl et al. 2023); of means in units of the scene's extent.
RATES = {
    "means": 1.6e-4, "quaternions": 1e-3, "log_scales": 5e-3, "opacity_logits": 5e-2,
    "sh_dc": 2.5e-3, "sh_rest": 2.5e-3 / 20,
}  # fmt: skip
HIDDEN = -20.0  # logit of the opacity of a row that a picture is drawn without


@dataclass(frozen=True, slots=True)
class Rates:
    """Factors on the learning rates of 3DGS, which are made for 30,000 iterations, and where they decay to."""

    factor: float = 3.0
    means: float = 1.0  # a further factor, for means
    last: float = 1.0  # share of the rate that is left at the end
    means_last: float = 0.01  # the same for means

    def at(self, done: float, extent: float) -> dict[str, float]:
        """Rates when a share `done` of the iterations is past, in a scene of `extent` world units."""
        rates = {name: rate * self.factor * self.last**done for name, rate in RATES.items()}
        rates["means"] = RATES["means"] * self.factor * self.means * self.means_last**done * extent
        rates[MOTION] = rates["means"]
        return rates


@dataclass(frozen=True, slots=True)
class Regularisers:
    """Weights of what is added to the loss of the pictures."""

    opacity: float = 0.0  # of the mean opacity
    scale: float = 0.0  # of the mean scale over the scene's extent
    inflation: float = 0.0  # of the summed opacity of the rows past the first U


@dataclass(frozen=True, slots=True, eq=False)
class Resting:
    """Rows of which only some are fitted; rows that are added come after them."""

    rows: Parameters  # (N, ...) as they are
    active: torch.Tensor  # (A,)

    def taken(self, p: Parameters) -> Parameters:
        """The A rows that are fitted, of a value for each."""
        return {name: value[self.active] for name, value in p.items()}

    def joined(self, fitted: Parameters) -> Parameters:
        """All rows, from the A that are fitted and what was added after them."""
        count = len(self.active)
        if len(fitted["means"]) == count:
            return {name: value.index_copy(0, self.active, fitted[name]) for name, value in self.rows.items()}
        whole = {name: value.index_copy(0, self.active, fitted[name][:count]) for name, value in self.rows.items()}
        return {name: torch.cat([value, fitted[name][count:]]) for name, value in whole.items()}

    def picked(self, values: torch.Tensor) -> torch.Tensor:
        """The inverse of `joined`: of a value for each row, those of the rows that are fitted."""
        n = len(self.rows["means"])
        return torch.cat([values[:n][self.active], values[n:]])


@dataclass(slots=True, eq=False)
class PerGaussian:
    """Base Gaussians and a difference D of every element, fitted by Adam."""

    base: Parameters
    extent: float  # world units
    rates: Rates = field(default_factory=Rates)
    start: Parameters | None = None  # D to begin with; None: 0
    temporal: Parameters | None = None  # weight of |D| of each element, `temporal_weights`; 0 in rows that are new
    until: float = 1.0  # share of the iterations in which it acts
    fixed: int = 0  # U
    regularisers: Regularisers = field(default_factory=Regularisers)
    densifier: Densifier | None = None  # None: no rows are added
    clears: Callable[[Gaussians], NDArray[np.bool_]] | None = None  # rows (N,) that hang in open space and go
    resting: Resting | None = None  # rows that are in the pictures, too, and are not fitted; None: there are none
    dropout: float = 0.0  # share of the rows that a picture is drawn without at the end of the fit
    seed: int = 0  # of the rows that are left out
    adam: Adam = field(init=False)
    cleared: int = field(init=False, default=0)  # rows that hung in open space
    _support: Parameters | None = field(init=False, default=None)  # 1 where D may still change; None: not decided yet
    _absgrad: AbsGrad | None = field(init=False, default=None)
    _generator: torch.Generator = field(init=False)
    _done: float = field(init=False, default=0.0)  # share of the iterations

    def __post_init__(self) -> None:
        self._generator = torch.Generator().manual_seed(self.seed)
        self.adam = Adam(self.start or zeros_like(self.base), self.rates.at(0.0, self.extent))

    def current(self, after: float = 0.0) -> Parameters:
        """The Gaussians as they are now, base + D, differentiable by D, among those that rest.

        So many frames `after` their time they have moved by as much of a MOTION, which is fitted too, or else of D.

        Some are hidden where there is `dropout`: what others hide in a training view is fitted as well, and a view
        between them shows no gap (DropGaussian, Park et al. 2025). Their share rises as the fit goes on.
        """
        fitted = self._fitted()
        if after and MOTION in fitted:
            fitted["means"] = fitted["means"] + after * fitted[MOTION]
        elif after:
            fitted = {name: p + after * self.adam.parameters[name] for name, p in fitted.items()}
        if self.dropout and torch.is_grad_enabled():
            hidden = torch.rand(len(self.base["means"]), generator=self._generator) < self.dropout * self._done
            logits = fitted["opacity_logits"]
            fitted["opacity_logits"] = logits.masked_fill(hidden.to(logits.device), HIDDEN)
        return self.resting.joined(fitted) if self.resting else fitted

    def detached(self) -> Parameters:
        with torch.no_grad():
            return self.current()

    def watch(self) -> AbsGrad | None:
        """Where the absolute gradients of the next picture are wanted; None: rows are not added."""
        self._absgrad = AbsGrad() if self.densifier else None
        return self._absgrad

    def penalty(self) -> torch.Tensor | float:
        """The regularisers.

        L_inf = max(0, N - U) (AirGS, "Training" 3) has no gradient; what can act is the opacity of what was added.
        """
        r = self.regularisers
        total: torch.Tensor | float = 0.0
        if r.opacity or r.inflation:
            opacity = (self.base["opacity_logits"] + self.adam.parameters["opacity_logits"]).sigmoid()
            if r.opacity:
                total = total + r.opacity * opacity.mean()
            if r.inflation and len(opacity) > self.fixed:
                total = total + r.inflation * opacity[self.fixed :].sum()
        if r.scale:
            size = (self.base["log_scales"] + self.adam.parameters["log_scales"]).exp()
            total = total + r.scale / self.extent * size.mean()
        return total

    def step(self, iteration: int, iterations: int) -> None:
        """Move along the gradients; then add rows where it is time to, and remove those that show nothing.

        Raises TrainingError where no row is left.
        """
        if self.densifier and self._absgrad:
            self.densifier.collect(self._absgrad, self.resting.picked if self.resting else None)
        self._done = iteration / iterations
        self._move()
        if self.densifier:
            self._densify(self.densifier, iteration, iterations)

    @torch.no_grad()
    def remove_fainter(self, opacity: float) -> None:
        """Remove rows past the first U whose opacity is under `opacity`. Raises TrainingError where none is left."""
        self._replace(is_visible(self._fitted(), self.fixed, opacity))

    @torch.no_grad()
    def _densify(self, densifier: Densifier, iteration: int, iterations: int) -> None:
        if densifier.growth.due(iteration, iterations):
            self._replace(*densifier.grow(self._fitted(), self.extent, self.fixed, self._done))
        if densifier.growth.removes(iteration, iterations):
            self._replace(is_visible(self._fitted(), self.fixed))
            densifier.restart(len(self.base["means"]))
        if self.clears and iteration in (round(share * iterations) for share in CHECKS):
            free = torch.from_numpy(self.clears(to_gaussians(self.current()))).to(self.base["means"].device)
            free = self.resting.picked(free) if self.resting else free
            free[: self.fixed] = False
            self._replace(~free)
            self.cleared += int(free.sum())
            densifier.restart(len(self.base["means"]))

    def _fitted(self) -> Parameters:
        return {name: p + self.adam.parameters[name] for name, p in self.base.items()}

    def _move(self) -> None:
        """Adam, the temporal loss, and no Gaussian larger than the scene.

        The temporal loss pulls back what does move, too. When it has had its say (`until`), what is still 0 stays so,
        and the rest is fitted without it (the relaxed lasso, Meinshausen 2007). New rows have no temporal loss.
        """
        self.adam.rates = self.rates.at(self._done, self.extent)
        difference = self.adam.parameters
        if self.temporal is None or self._done <= self.until:
            self.adam.step(self.temporal)
        else:
            if self._support is None:
                self._support = {n: ((difference[n] != 0) | (w == 0)).to(w.dtype) for n, w in self.temporal.items()}
            self.adam.step()
        with torch.no_grad():
            for name, mask in (self._support or {}).items():
                difference[name].mul_(mask)
            # Past this size gradients of means and rotations are rounding noise.
            sizes = difference["log_scales"]
            sizes.copy_(torch.minimum(sizes, math.log(self.extent) - self.base["log_scales"]))

    def _replace(self, keep: torch.Tensor, added: Parameters | None = None) -> None:
        if added is None and bool(keep.all()):
            return
        if added is None and not bool(keep.any()) and self.resting is None:
            raise TrainingError("expected pictures that show something, no Gaussian is left")
        zeros = None if added is None else zeros_like(added)
        self.adam.replace_rows(keep, zeros)
        self.base = take_and_append(self.base, keep, added)
        if self.temporal is not None:
            self.temporal = take_and_append(self.temporal, keep, zeros)
        if self._support is not None:
            self._support = take_and_append(self._support, keep, None)


OCTAVES = 5  # of the positional encoding (NeRF, Mildenhall et al. 2020, equation 4)
WIDTH = 64  # of a hidden layer
RATE, RATE_LAST = 1e-2, 0.1  # learning rate, and the share of it that is left at the end
# An output of 1 means this change, about the size of one in a frame; means in units of the scene's extent.
SCALES = {
    "means": 0.006, "quaternions": 0.05, "log_scales": 0.05, "opacity_logits": 0.2, "sh_dc": 0.05, "sh_rest": 0.02,
}  # fmt: skip


class Networks(torch.nn.Module):
    """An MLP for each attribute that has channels, side by side; output layers start at zero, so that nothing moves."""

    centre: torch.Tensor
    spread: torch.Tensor

    def __init__(self, like: Parameters, extent: float, seed: int) -> None:
        """Networks for Gaussians like these, whose statistics standardise the input.

        `extent`: of the scene in world units. `seed`: of the first weights.
        """
        super().__init__()
        self.names = [name for name in ATTRIBUTES if like[name][0].numel()]
        self.extent = extent
        features = self._encode(like)
        inputs, count = features.shape[1], len(self.names)
        draw = torch.Generator().manual_seed(seed)

        def layer(rows: int) -> torch.nn.Parameter:
            return torch.nn.Parameter(torch.randn(count, rows, WIDTH, generator=draw) * math.sqrt(2 / rows))

        self.register_buffer("centre", features.mean(dim=0))
        self.register_buffer("spread", features.std(dim=0) + 1e-4)  # a constant feature: 0, not 0 / 0
        self.first, self.second = layer(inputs), layer(WIDTH)
        self.first_bias = torch.nn.Parameter(torch.zeros(count, 1, WIDTH))
        self.second_bias = torch.nn.Parameter(torch.zeros(count, 1, WIDTH))
        self.last = torch.nn.ParameterList(
            [torch.nn.Parameter(torch.zeros(WIDTH, like[name][0].numel())) for name in self.names]
        )

    def features(self, p: Mapping[str, torch.Tensor]) -> torch.Tensor:
        return (self._encode(p) - self.centre) / self.spread

    def forward(self, features: torch.Tensor) -> dict[str, torch.Tensor]:
        hidden = torch.relu(torch.matmul(features[None], self.first) + self.first_bias)
        hidden = torch.relu(torch.bmm(hidden, self.second) + self.second_bias)
        scales = SCALES | {"means": SCALES["means"] * self.extent}
        return {n: (hidden[i] @ self.last[i]) * scales[n] for i, n in enumerate(self.names)}

    def _encode(self, p: Mapping[str, torch.Tensor]) -> torch.Tensor:
        x = p["means"] / self.extent
        waves = [wave(x * 2**k * math.pi) for k in range(OCTAVES) for wave in (torch.sin, torch.cos)]
        rest = [p[name].reshape(len(x), -1) for name in self.names if name != "means"]
        return torch.cat([x, *waves, *rest], dim=1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Copies of all numbers by name, for a file."""
        return {name: value.cpu().numpy().copy() for name, value in self.state_dict().items()}

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take the numbers that `arrays` of networks of the same sizes gave."""
        self.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})


@dataclass(slots=True, eq=False)
class MlpDriven:
    """Base Gaussians that move as the networks say. The networks' weights go on from frame to frame."""

    base: Parameters
    networks: Networks
    temporal: Parameters  # weight of |change| of each element, `temporal_weights`
    _features: torch.Tensor = field(init=False)
    _changes: Parameters = field(init=False, default_factory=dict)  # of the last `current`, at the time of the frame
    _adam: torch.optim.Adam = field(init=False)

    def __post_init__(self) -> None:
        self._features = self.networks.features(self.base)
        self._adam = torch.optim.Adam(self.networks.parameters(), lr=RATE, betas=BETAS)

    def current(self, after: float = 0.0) -> Parameters:
        """The Gaussians moved by the networks, extrapolated linearly to so many frames `after` their time."""
        self._changes = {n: d.reshape(self.base[n].shape) for n, d in self.networks(self._features).items()}
        return {n: p + (1 + after) * self._changes[n] if n in self._changes else p for n, p in self.base.items()}

    def detached(self) -> Parameters:
        with torch.no_grad():
            return self.current()

    def watch(self) -> AbsGrad | None:
        """None: rows are not added."""
        return None

    def penalty(self) -> torch.Tensor | float:
        """L_temp of the changes that `current` gave last."""
        return sum((self.temporal[name] * d.abs()).sum() for name, d in self._changes.items())

    def step(self, iteration: int, iterations: int) -> None:
        for group in self._adam.param_groups:
            group["lr"] = RATE * RATE_LAST ** (iteration / iterations)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)


EXPOSURE_RATE = 2e-3  # learning rate
ALIKE = (
    0.015  # root mean square of gains off 1, below which cameras are exposed alike; the drawn fox has 0.003, two real
)
# rigs have 0.028 and 0.053
BEYOND = 2.0  # times their error, from which gains are no chance


class ExposureModel:
    """Gains and offsets of V cameras, fitted beside the Gaussians.

    Until it is known whether cameras differ, the halves of pictures have their own: how far these are apart is an
    error that gains have to exceed.
    """

    def __init__(
        self, views: int, device: str, reference: int | None = None, looks: int | None = None, again: Sequence[int] = ()
    ) -> None:
        """The identity for every camera. `reference`: the view whose camera keeps it; None: the average camera does.

        `again`: of each view behind these, the one that has its camera.
        `looks`: steps after which cameras that are alike keep the identity for good; None: whatever is found stays.
        """
        self.differs = True
        self._reference, self._looks, self._of = reference, looks, [*range(views), *again]
        self._logs = torch.zeros(views, 2, 3, device=device, requires_grad=True)  # left and right
        self._offsets = torch.zeros(views, 2, 3, device=device, requires_grad=True)
        self._steps = 0
        self._adam = torch.optim.Adam([self._logs, self._offsets], lr=EXPOSURE_RATE, betas=BETAS)

    def apply(self, rgb: torch.Tensor, view: int) -> torch.Tensor:
        """The rendered picture (H, W, 3) as the camera of that view would have exposed it."""
        if not self.differs:
            return rgb
        side = torch.arange(rgb.shape[1], device=rgb.device) * 2 // rgb.shape[1]
        logs, offsets = (t[self._of[view]][side] for t in self._centred())
        return rgb * logs.exp() + offsets

    def step(self) -> None:
        if not self.differs:
            return
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)
        if self._steps + 1 == self._looks:
            left, right = self._centred()[0].detach().unbind(1)
            found, error = ((t / 2).square().mean().sqrt().item() for t in (left + right, left - right))
            self.differs = found > max(ALIKE, BEYOND * error)
        self._steps += 1

    def table(self, names: Sequence[str]) -> dict[str, list[float]]:
        """Gains r, g, b and offsets r, g, b by the names of the cameras, rounded to 5 digits."""
        logs, offsets = (t.detach().mean(dim=1).cpu().numpy() for t in self._centred())
        rows = np.concatenate([np.exp(logs), offsets], axis=1)
        return {name: [round(float(v), 5) for v in row] for name, row in zip(names, rows, strict=True)}

    def _centred(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Logarithms of gains, and offsets, (V, 2, 3), alike in both halves once that is all there is to know."""
        own = slice(None) if self._reference is None else slice(self._reference, self._reference + 1)
        logs, offsets = (t - t[own].mean(dim=0, keepdim=True) for t in (self._logs, self._offsets))
        if self._looks is not None and self._steps < self._looks:
            return logs, offsets
        return logs.mean(dim=1, keepdim=True).expand_as(logs), offsets.mean(dim=1, keepdim=True).expand_as(offsets)


LOOK_EVERY = 50  # iterations on CUDA until it is seen whether losses are finite; rows are added no more often


class Variables(Protocol):
    """What is fitted: gives Gaussians so many frames after their time, and moves along their gradients."""

    def current(self, after: float = 0.0) -> Parameters: ...

    def watch(self) -> AbsGrad | None: ...  # where absolute gradients of the next picture are wanted; None: nowhere

    def penalty(self) -> torch.Tensor | float: ...  # added to the loss of the picture

    def step(self, iteration: int, iterations: int) -> None: ...  # iteration 1 .. iterations


@dataclass(frozen=True, slots=True)
class Schedule:
    """How long a fit runs, and how much an iteration sees."""

    stage: str  # what is fitted, for progress
    iterations: int
    sh_degree: Callable[[float], int]  # SH degree in use when a share of the iterations is past
    random_background: bool = False  # whether every picture has another one
    views: int = 1  # pictures an iteration, whose losses are averaged
    ssim_weight: float = LAMBDA
    coarse: float = 0.0  # share of the iterations, the first ones, that see pictures of half the size


def shuffled(views: int, rng: np.random.Generator) -> Iterator[int]:
    """Yields view indices in random order, shuffled again after each full pass."""
    while True:
        yield from reversed(rng.permutation(views).tolist())


class Losses:
    """Checks losses for NaN and Inf; on a GPU only now and then, since looking means to wait for it."""

    def __init__(self, every: int) -> None:
        """`every`: iterations between two looks."""
        self._every = every
        self._pending: list[tuple[int, str, torch.Tensor]] = []

    def add(self, iteration: int, views: Sequence[View], loss: torch.Tensor, last: bool) -> None:
        """The loss of an iteration. Raises TrainingError, at the latest at the `last` one, naming the first fault."""
        names = ", ".join(view.camera.name for view in views)
        self._pending.append((iteration, names, loss.detach()))
        if iteration % self._every and not last:
            return
        finite = torch.isfinite(torch.stack([loss for _, _, loss in self._pending])).tolist()
        for good, (at, names, _) in zip(finite, self._pending, strict=True):
            if not good:
                raise TrainingError(f"the loss is not finite at iteration {at} in view {names}")
        self._pending.clear()


def optimise(
    variables: Variables,
    views: Sequence[View],
    schedule: Schedule,
    rng: np.random.Generator,
    exposure: ExposureModel | None = None,
    progress: Progress = silent,
) -> None:
    """Fit `variables` to the V views in random order, each as often as the others, by Adam.

    `exposure`: gains and offsets of the views' cameras, which are fitted too. Raises TrainingError when the loss is not
    finite, on CUDA up to LOOK_EVERY iterations later.
    """
    order = shuffled(len(views), rng)
    losses: Losses | None = None
    count, iterations = min(schedule.views, len(views)), schedule.iterations
    halved = round(schedule.coarse * iterations) if can_be_halved(views) else 0
    whole, views = views, [halve(view) for view in views] if halved else views
    for iteration in range(1, iterations + 1):
        if iteration > halved:
            views = whole
        chosen = list(islice(order, count))
        seen = [views[i] for i in chosen]
        if schedule.random_background:
            seen = [view.before(tuple(rng.uniform(size=3).tolist())) for view in seen]
        sh_degree = schedule.sh_degree(iteration / iterations)
        parts = []
        for index, view, (rgb, _) in zip(chosen, seen, drawn(variables, seen, sh_degree), strict=True):
            shown = exposure.apply(rgb, index) if exposure else rgb
            parts.append(photometric(shown, view.target, schedule.ssim_weight))
        loss = (parts[0] if count == 1 else torch.stack(parts).mean()) + variables.penalty()
        losses = losses or Losses(LOOK_EVERY if loss.is_cuda else 1)
        losses.add(iteration, seen, loss, iteration == iterations)
        loss.backward()
        variables.step(iteration, iterations)
        if exposure:
            exposure.step()
        progress(schedule.stage, iteration, iterations)


def drawn(variables: Variables, views: Sequence[View], sh_degree: int) -> list[Drawn]:
    """What views show of the Gaussians when each was taken, with SH up to `sh_degree`."""
    watched, times = variables.watch(), {view.after for view in views}
    if len(times) == 1:
        cameras, redraws = zip(*((view.camera, view.redraw) for view in views), strict=True)
        return render_views(variables.current(*times), cameras, sh_degree, watched, redraws)
    parts = [AbsGrad() for _ in views]
    if watched:
        watched.collect(parts)
    return [
        render_views(variables.current(view.after), [view.camera], sh_degree, part, [view.redraw])[0]
        for view, part in zip(views, parts, strict=True)
    ]


LEAST = 160  # pixels on the shorter side of a picture that is halved: smaller ones lose what moves in them


def can_be_halved(views: Sequence[View]) -> bool:
    return all(min(view.camera.width, view.camera.height) >= LEAST for view in views)


def halve(view: View) -> View:
    """The view at half its size, or half a pixel more. A tile is drawn again where one of the four in it would be."""
    size = -(-view.camera.width // 2), -(-view.camera.height // 2)

    def target() -> Target:
        whole = view.target
        return Target(resize(whole.rgb, *size), None if whole.clear is None else resize(whole.clear, *size))

    def rest() -> Render:
        assert view.redraw is not None
        whole = view.redraw.rest()
        return Render(resize(whole.rgb, *size), resize(whole.transmittance, *size))

    redraw = view.redraw and replace(view.redraw, tiles=_any_of_four(view.redraw.tiles, size), rest=rest)
    return View(with_pixels(view.camera, *size), target, redraw, view.after)


def _any_of_four(tiles: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
    """(down, across) of pictures of a size, from (down', across') of pictures twice as large."""
    across, down = (-(-pixels // TILE) for pixels in size)
    padded = np.zeros((2 * down, 2 * across), np.bool_)
    padded[: tiles.shape[0], : tiles.shape[1]] = tiles
    return np.asarray(padded.reshape(down, 2, across, 2).any(axis=(1, 3)))
