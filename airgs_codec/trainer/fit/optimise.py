"""What a fit changes, and the loop that fits it to pictures: first frames, keyframes and frames in a group.

Variables are every Gaussian on its own, where rows may come and go, or six MLPs that move all, one for each attribute
(AirGS, "Training" 2). Every Gaussian has a difference D to base Gaussians, so that the temporal loss is a norm of the
variable itself and exactly 0 where pictures ask for no change. A fit may begin with pictures of half the size: large
motion is small in them, and an iteration costs less.

N Gaussians, A of them active, U of them rows that stay, V views, F features, H x W pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import islice
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.errors import TrainingError
from airgs_codec.media.image import resize
from airgs_codec.progress import Progress, silent
from airgs_codec.render import cuda
from airgs_codec.render.cpu import TILE, Render
from airgs_codec.render.cuda import AbsGrad
from airgs_codec.scene.camera import with_pixels
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import TARGET_BYTES, Recent, TargetPicture, View
from airgs_codec.trainer.fit.grow import CHECKS, Densifier, is_visible
from airgs_codec.trainer.fit.losses import (
    GAUSSIAN_FIELDS,
    LAMBDA,
    MOTION,
    Parameters,
    photometric,
    render_views,
    take_and_append,
    to_gaussians,
    uploaded,
    zeros_like,
)

BETAS = (0.9, 0.999)
# Adam divides by the size of the gradient: without a floor it would move attributes that pictures do not depend on
# (the rotation of a ball) as far as others, by rounding noise. Gradients of pictures are 1e-8 and more.
EPSILON = 1e-12


class Adam:
    """Adam (Kingma and Ba 2015) over named tensors whose rows may come and go."""

    def __init__(
        self, parameters: Parameters, rates: Mapping[str, float], epsilon: float = EPSILON, second: float = BETAS[1]
    ) -> None:
        """`parameters` are copied and made leaves; `rates` may be changed between steps through `self.rates`."""
        self._epsilon, self._betas, self.rates, self._steps = epsilon, (BETAS[0], second), dict(rates), 0
        self.parameters = {name: p.detach().clone().requires_grad_(True) for name, p in parameters.items()}
        self.moments = zeros_like(parameters), zeros_like(parameters)

    @torch.no_grad()
    def step(self, shrink: Mapping[str, torch.Tensor] | None = None) -> None:
        """Step along the gradients, and clear them.

        `shrink`: weights of an L1 norm of the parameters, in units of the loss, applied by its proximal map in Adam's
        metric: values that no picture asks for become exactly 0.
        """
        self._steps += 1
        bias = [1 - beta**self._steps for beta in self._betas]
        names = [name for name, p in self.parameters.items() if p.grad is not None]
        moved, first, second = ([of[n] for n in names] for of in (self.parameters, *self.moments))
        gradients: list[Any] = [p.grad for p in moved]
        rates = [self.rates[name] for name in names]
        torch._foreach_lerp_(first, gradients, 1 - self._betas[0])
        torch._foreach_mul_(second, self._betas[1])
        torch._foreach_addcmul_(second, gradients, gradients, 1 - self._betas[1])
        scale = torch._foreach_div(second, bias[1])
        torch._foreach_sqrt_(scale)
        torch._foreach_add_(scale, self._epsilon)
        torch._foreach_addcdiv_(moved, first, scale, [-rate / bias[0] for rate in rates])
        if shrink:
            weights = [shrink[n] if n in shrink else torch.zeros_like(self.parameters[n]) for n in names]
            threshold = torch._foreach_div(torch._foreach_mul(weights, rates), scale)
            within = torch._foreach_maximum(moved, torch._foreach_neg(threshold))
            torch._foreach_sub_(moved, torch._foreach_minimum(within, threshold))
        for p in moved:
            p.grad = None

    def replace_rows(self, keep: torch.Tensor, added: Parameters | None = None) -> None:
        """Keep the rows of a mask (N,), in order, and append new ones, whose moments start at 0."""
        rows = take_and_append({name: p.detach() for name, p in self.parameters.items()}, keep, added)
        self.parameters = {name: p.requires_grad_(True) for name, p in rows.items()}
        zeros = None if added is None else zeros_like(added)
        first, second = (take_and_append(moments, keep, zeros) for moments in self.moments)
        self.moments = first, second


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
    last: float = 1.0  # share of the rate at the end
    means_last: float = 0.01  # the same for means, from the start
    late: float = 0.0  # share of the iterations after which the others decay
    second: float = BETAS[1]  # decay of Adam's second moments

    def at(self, done: float, extent: float) -> dict[str, float]:
        """Return the rates when a share `done` of the iterations is past, in a scene of `extent` world units."""
        decay = self.last ** max(0.0, (done - self.late) / (1 - self.late))
        rates = {name: rate * self.factor * decay for name, rate in RATES.items()}
        rates["means"] = RATES["means"] * self.factor * self.means * self.means_last**done * extent
        rates[MOTION] = rates["means"]
        return rates


@dataclass(frozen=True, slots=True, eq=False)
class Resting:
    """Rows of which only some are fitted; rows that are added come after them."""

    rows: Parameters  # (N, ...) as they are
    active: torch.Tensor  # (A,)

    def taken(self, p: Parameters) -> Parameters:
        return {name: value[self.active] for name, value in p.items()}

    def joined(self, fitted: Parameters) -> Parameters:
        """Return all rows, from the A that are fitted and those that were added after them."""
        count = len(self.active)
        if len(fitted["means"]) == count:
            return {name: value.index_copy(0, self.active, fitted[name]) for name, value in self.rows.items()}
        parts = {name: (fitted[name][:count], fitted[name][count:]) for name in self.rows}
        return {n: torch.cat([v.index_copy(0, self.active, parts[n][0]), parts[n][1]]) for n, v in self.rows.items()}

    def picked(self, values: torch.Tensor) -> torch.Tensor:
        """Return the values of the rows that are fitted, of a value for each row: the inverse of `joined`."""
        n = len(self.rows["means"])
        return torch.cat([values[:n][self.active], values[n:]])


@dataclass(slots=True, eq=False)
class PerGaussian:
    """Base Gaussians and a difference D of every element, fitted by Adam."""

    base: Parameters
    extent: float  # world units
    rates: Rates = field(default_factory=Rates)
    start: Parameters | None = None  # initial D; None: 0
    temporal: Parameters | None = None  # weight of |D| of each element, `temporal_weights`; 0 in rows that are new
    until: float = 1.0  # share of the iterations in which it acts
    fixed: int = 0  # U
    opacity_weight: float = 0.0  # in the loss, of the mean opacity
    scale_weight: float = 0.0  # of the mean scale over the scene's extent
    inflation: float = 0.0  # weight of the summed opacity of the rows past the first U
    densifier: Densifier | None = None  # None: no rows are added
    clears: Callable[[Gaussians], NDArray[np.bool_]] | None = None  # rows (N,) that hang in open space and go
    resting: Resting | None = None  # rows that are drawn but not fitted; None: all are fitted
    dropout: float = 0.0  # share of the rows that a picture is drawn without at the end of the fit
    seed: int = 0  # of the rows that are left out
    adam: Adam = field(init=False)
    cleared: int = field(init=False, default=0)  # rows that hung in open space
    _support: Parameters | None = field(init=False, default=None)  # 1 where D may still change; None: not decided yet
    _absgrad: AbsGrad | None = field(init=False, default=None)
    _generator: torch.Generator = field(init=False)
    _drawn: Parameters = field(init=False, default_factory=dict)  # of the last `current`, at the time of the frame
    _done: float = field(init=False, default=0.0)  # share of the iterations

    def __post_init__(self) -> None:
        self._generator = torch.Generator().manual_seed(self.seed)
        start, rates = self.start or zeros_like(self.base), self.rates.at(0.0, self.extent)
        self.adam = Adam(start, rates, second=self.rates.second)

    def current(self, after: float = 0.0) -> Parameters:
        """Return the Gaussians as they are now, base + D, differentiable by D, with those at rest.

        `after`: frames by which they are moved on along MOTION, which is fitted too, or else along D.

        With `dropout` a growing share of rows is hidden: what others hide in a training view is fitted as well, and a
        view between them shows no gap (DropGaussian, Park et al. 2025).
        """
        fitted = self._fitted()
        self._drawn = dict(fitted)
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
        """Return what collects the absolute gradients of the next picture; None: rows are not added."""
        self._absgrad = AbsGrad() if self.densifier else None
        return self._absgrad

    def penalty(self) -> torch.Tensor | float:
        """Return the added opacity that `current` gave last: L_inf = max(0, N - U), in its place, has no gradient."""
        if self.inflation and len(self.base["means"]) > self.fixed:
            return self.inflation * self._drawn["opacity_logits"][self.fixed :].sigmoid().sum()
        return 0.0

    def step(self, iteration: int, iterations: int) -> None:
        """Move along the gradients, then add and remove rows where due. Raises TrainingError where no row is left."""
        if self.densifier and self._absgrad:
            self.densifier.collect(self._absgrad, self.resting.picked if self.resting else None)
        self._done = iteration / iterations
        self._regularise()
        self._move()
        if self.densifier:
            self._densify(self.densifier, iteration, iterations)

    @torch.no_grad()
    def remove_fainter(self, opacity: float) -> None:
        """Remove rows after the first U of less than an opacity. Raises TrainingError where none is left."""
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
        changes = [self.adam.parameters[name] for name in self.base]
        return dict(zip(self.base, torch._foreach_add(list(self.base.values()), changes), strict=True))

    @torch.no_grad()
    def _regularise(self) -> None:
        """Add the gradients of mean opacity and scale, at what `current` gave last, to those of the loss."""
        rows, difference = len(self.base["means"]), self.adam.parameters
        if self.opacity_weight and (by_logits := difference["opacity_logits"].grad) is not None:
            alpha = self._drawn["opacity_logits"].sigmoid()
            by_logits.addcmul_(alpha, 1 - alpha, value=self.opacity_weight / rows)
        if self.scale_weight and (by_sizes := difference["log_scales"].grad) is not None:
            by_sizes.add_(self._drawn["log_scales"].exp(), alpha=self.scale_weight / (self.extent * 3 * rows))

    def _move(self) -> None:
        """Adam, the temporal loss, and no Gaussian larger than the scene.

        The temporal loss pulls back what does move, too. After a share `until`, what is still 0 stays so, and the other
        values are fitted without it (the relaxed lasso, Meinshausen 2007). New rows have no temporal loss.
        """
        self.adam.rates = self.rates.at(self._done, self.extent)
        difference, pulls = self.adam.parameters, self._done <= self.until
        if self.temporal and not pulls and self._support is None:
            self._support = {n: ((difference[n] != 0) | (w == 0)).to(w.dtype) for n, w in self.temporal.items()}
        self.adam.step(self.temporal if pulls else None)
        with torch.no_grad():
            if self._support:
                torch._foreach_mul_([difference[name] for name in self._support], list(self._support.values()))
            # Past this size gradients of means and rotations are rounding noise.
            sizes = difference["log_scales"]
            torch.minimum(sizes, math.log(self.extent) - self.base["log_scales"], out=sizes)

    def _replace(self, keep: torch.Tensor, added: Parameters | None = None) -> None:
        if added is None and bool(keep.all()):
            return
        if added is None and not bool(keep.any()) and self.resting is None:
            raise TrainingError("expected pictures that show something, no Gaussian is left")
        zeros = None if added is None else zeros_like(added)
        self.adam.replace_rows(keep, zeros)
        self.base = take_and_append(self.base, keep, added)
        self.temporal = self.temporal and take_and_append(self.temporal, keep, zeros)
        self._support = self._support and take_and_append(self._support, keep, None)


HIDDEN_WIDTH = 64
MLP_RATES = 1e-2, 0.1  # learning rate, and the share of it at the end
# An output of 1 means this change, about the size of one in a frame; means in units of the scene's extent.
SCALES = {
    "means": 0.006, "quaternions": 0.05, "log_scales": 0.05, "opacity_logits": 0.2, "sh_dc": 0.05, "sh_rest": 0.02,
}  # fmt: skip


class Networks(torch.nn.Module):
    """An MLP for each attribute that has channels; output layers start at zero, so that nothing moves."""

    centre: torch.Tensor
    spread: torch.Tensor
    scales: torch.Tensor

    def __init__(self, like: Parameters, extent: float, seed: int) -> None:
        """Draw weights by a seed for Gaussians like these, whose statistics standardise the input.

        `extent`: of the scene in world units.
        """
        super().__init__()
        self.names, self.extent = [name for name in GAUSSIAN_FIELDS if like[name][0].numel()], extent
        self.shapes = [like[name].shape[1:] for name in self.names]
        features, count, draw = self._encode(like), len(self.names), torch.Generator().manual_seed(seed)

        def layer(rows: int) -> torch.nn.Parameter:
            return torch.nn.Parameter(torch.randn(count, rows, HIDDEN_WIDTH, generator=draw) * math.sqrt(2 / rows))

        def zeros(*shape: int) -> torch.nn.Parameter:
            return torch.nn.Parameter(torch.zeros(*shape))

        self.register_buffer("centre", features.mean(dim=0))
        self.register_buffer("spread", features.std(dim=0) + 1e-4)  # a constant feature: 0, not 0 / 0
        self.first, self.second = layer(features.shape[1]), layer(HIDDEN_WIDTH)
        self.first_bias, self.second_bias = zeros(count, 1, HIDDEN_WIDTH), zeros(count, 1, HIDDEN_WIDTH)
        self.last = zeros(count, HIDDEN_WIDTH, max(shape.numel() for shape in self.shapes))
        scales = [SCALES[name] * (extent if name == "means" else 1) for name in self.names]
        self.register_buffer("scales", torch.tensor(scales)[:, None, None], persistent=False)

    def features(self, p: Mapping[str, torch.Tensor]) -> torch.Tensor:
        return (self._encode(p) - self.centre) / self.spread

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return changes as `padded` gives values."""
        hidden = torch.relu(torch.baddbmm(self.first_bias, features.expand(len(self.first), -1, -1), self.first))
        hidden = torch.relu(torch.baddbmm(self.second_bias, hidden, self.second))
        return torch.bmm(hidden, self.last) * self.scales

    def padded(self, p: Parameters) -> torch.Tensor:
        """Return the attributes one after another, as wide as the widest, with zeros at the ends of rows."""
        flat, widest = [p[name].reshape(len(p[name]), -1) for name in self.names], self.last.shape[2]
        return torch.stack([torch.nn.functional.pad(one, (0, widest - one.shape[1])) for one in flat])

    def attributes(self, padded: torch.Tensor) -> Parameters:
        """Inverse of `padded`."""
        parts = zip(self.names, self.shapes, padded.unbind(), strict=True)
        return {name: part[:, : shape.numel()].reshape(len(part), *shape) for name, shape, part in parts}

    def _encode(self, p: Mapping[str, torch.Tensor]) -> torch.Tensor:
        x = p["means"] / self.extent  # five octaves of the positional encoding (NeRF, Mildenhall et al. 2020, eq. 4)
        waves = [wave(x * 2**k * math.pi) for k in range(5) for wave in (torch.sin, torch.cos)]
        others = [p[name].reshape(len(x), -1) for name in self.names if name != "means"]
        return torch.cat([x, *waves, *others], dim=1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return copies of all numbers by name, for a file."""
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
    _still: torch.Tensor = field(init=False)  # the base, padded, and so are:
    _weights: torch.Tensor = field(init=False)
    _changes: torch.Tensor = field(init=False)  # of the last `current`, at the time of the frame
    _adam: torch.optim.Adam = field(init=False)

    def __post_init__(self) -> None:
        self._features = self.networks.features(self.base)
        self._still, self._weights = self.networks.padded(self.base), self.networks.padded(self.temporal)
        self._adam = torch.optim.Adam(self.networks.parameters(), lr=MLP_RATES[0], betas=BETAS, fused=True)

    def current(self, after: float = 0.0) -> Parameters:
        """Return the Gaussians moved by the networks, extrapolated linearly by `after` frames."""
        self._changes = self.networks(self._features)
        return self.base | self.networks.attributes(torch.add(self._still, self._changes, alpha=1 + after))

    def detached(self) -> Parameters:
        with torch.no_grad():
            return self.current()

    def watch(self) -> AbsGrad | None:
        return None  # rows are not added

    def penalty(self) -> torch.Tensor:
        """Return L_temp of the changes that `current` gave last."""
        return (self._changes.abs() * self._weights).sum()

    def step(self, iteration: int, iterations: int) -> None:
        for group in self._adam.param_groups:
            group["lr"] = MLP_RATES[0] * MLP_RATES[1] ** (iteration / iterations)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)


SAME_EXPOSURE = 0.015  # root mean square of gains off 1, up to which; the drawn fox has 0.003, two rigs 0.028 and 0.053


class ExposureModel:
    """Gains and offsets of V cameras, fitted with the Gaussians.

    Until it is decided whether cameras differ, the halves of pictures have their own: their difference is an error that
    gains have to exceed.
    """

    def __init__(self, views: int, device: str, reference: int | None = None, looks: int | None = None) -> None:
        """Begin with the identity for every camera.

        `reference`: the view whose camera retains it; None: the average camera does. `looks`: steps after which cameras
        of one exposure have the identity for good; None: whatever is found stays.
        """
        self.differs, self._steps, self._reference, self._looks = True, 0, reference, looks
        values = torch.zeros(views, 2, 6, device=device)  # left and right; logarithms of gains, and offsets
        self._adam = Adam({"values": values}, {"values": 2e-3}, 1e-8)

    def apply(self, rgb: torch.Tensor, views: Sequence[int]) -> torch.Tensor:
        """Return rendered pictures (C, H, W, 3) as the cameras of those views would have exposed them."""
        if not self.differs:
            return rgb
        each = self._centred().unbind()
        values = torch.stack([each[view] for view in views])[:, None, _sides(rgb.shape[2], rgb.device)]
        return torch.addcmul(values[..., 3:], rgb, values[..., :3].exp())

    def step(self) -> None:
        if not self.differs:
            return
        self._adam.step()
        if self._steps + 1 == self._looks:
            left, right = self._centred().detach()[..., :3].unbind(1)
            found, error = ((t / 2).square().mean().sqrt().item() for t in (left + right, left - right))
            self.differs = found > max(SAME_EXPOSURE, 2 * error)
        self._steps += 1

    def table(self, names: Sequence[str]) -> dict[str, list[float]]:
        """Return gains r, g, b and offsets r, g, b by the names of the cameras, rounded to 5 digits."""
        rows = self._centred().detach().mean(dim=1).cpu().numpy()
        rows[:, :3] = np.exp(rows[:, :3])
        return {name: [round(float(v), 5) for v in row] for name, row in zip(names, rows, strict=True)}

    def _centred(self) -> torch.Tensor:
        """Return the values (V, 2, 6), equal in both halves after `looks` steps."""
        values = self._adam.parameters["values"]
        kept = values if self._reference is None else values[self._reference, None]
        values = values - kept.mean(dim=0, keepdim=True)
        if self._looks is not None and self._steps < self._looks:
            return values
        return values.mean(dim=1, keepdim=True).expand_as(values)


@lru_cache(maxsize=16)
def _sides(width: int, device: torch.device) -> torch.Tensor:
    """Return (width,) 0 in the left half of a picture, 1 in the right one."""
    return torch.arange(width, device=device) * 2 // width


LOOK_EVERY = 50  # iterations on CUDA until losses are checked; rows are added no more often


class Variables(Protocol):
    """What is fitted: Gaussians, `after` frames past their time, that move along their gradients."""

    def current(self, after: float = 0.0) -> Parameters: ...

    def watch(self) -> AbsGrad | None: ...  # what collects absolute gradients of the next picture; None: nothing

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


class LossCheck:
    """Checks losses for NaN and Inf every few iterations: on a GPU a check has to wait for it."""

    def __init__(self, every: int) -> None:
        self._every, self._pending = every, list[tuple[int, str, torch.Tensor]]()

    def add(self, iteration: int, views: Sequence[View], loss: torch.Tensor, last: bool) -> None:
        """Take the loss of an iteration. Raises TrainingError, at the latest at the `last` one, for the first fault."""
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
    with torch.no_grad():
        place = variables.current()["means"]
    on_device, order = cuda.by_gsplat(place), shuffled(len(views), rng)
    losses, iterations = LossCheck(LOOK_EVERY if on_device else 1), schedule.iterations
    halved = round(schedule.coarse * iterations) if can_be_halved(views) else 0
    coarse = kept_halves(views) if halved else []
    ready = partial(uploaded, device=place.device) if on_device else list[View]
    if not schedule.random_background:
        views, coarse = ready(views), ready(coarse)
    for iteration in range(1, iterations + 1):
        chosen = list(islice(order, min(schedule.views, len(views))))
        seen = [views[i] if iteration > halved else coarse[i] for i in chosen]
        if schedule.random_background:
            seen = ready([view.before(tuple(rng.uniform(size=3).tolist())) for view in seen])
        parts = []
        for places, rgb in drawn(variables, seen, schedule.sh_degree(iteration / iterations)):
            shown = exposure.apply(rgb, [chosen[place] for place in places]) if exposure else rgb
            parts.append(photometric(shown, [seen[place].target for place in places], schedule.ssim_weight))
        loss = (parts[0] if len(parts) == 1 else torch.cat(parts)).mean() + variables.penalty()
        losses.add(iteration, seen, loss, iteration == iterations)
        loss.backward()
        variables.step(iteration, iterations)
        if exposure:
            exposure.step()
        progress(schedule.stage, iteration, iterations)


def drawn(variables: Variables, views: Sequence[View], sh_degree: int) -> Iterator[tuple[list[int], torch.Tensor]]:
    """Draw the Gaussians in views, each when it was taken, with SH up to `sh_degree`.

    Yields which views are drawn at once, those of one time, size and near plane, and their pictures (C, H, W, 3).
    """
    watched, alike = variables.watch(), dict[tuple[float, ...], list[int]]()
    for i, view in enumerate(views):
        alike.setdefault((view.after, view.camera.width, view.camera.height, view.camera.near), []).append(i)
    for (after, *_), places in alike.items():
        cameras, redraws = zip(*((views[i].camera, views[i].redraw) for i in places), strict=True)
        yield places, render_views(variables.current(after), cameras, sh_degree, watched, redraws)[0]


def can_be_halved(views: Sequence[View]) -> bool:
    return all(min(view.camera.width, view.camera.height) >= 160 for view in views)  # smaller ones lose what moves


def halve(view: View) -> View:
    """Return the view at half its size, rounded up. A tile is drawn again where one of the four in it would be."""
    size = -(-view.camera.width // 2), -(-view.camera.height // 2)

    def target() -> TargetPicture:
        whole = view.target
        return TargetPicture(resize(whole.rgb, *size), None if whole.clear is None else resize(whole.clear, *size))

    def rest() -> Render:
        assert view.redraw is not None
        whole = view.redraw.rest()
        return Render(resize(whole.rgb, *size), resize(whole.transmittance, *size))

    shape = -(-size[1] // TILE), -(-size[0] // TILE)
    redraw = view.redraw and replace(view.redraw, tiles=any_in_blocks(view.redraw.tiles, 2, shape), rest=rest)
    return View(with_pixels(view.camera, *size), target, redraw, view.after)


def kept_halves(views: Sequence[View]) -> list[View]:
    """Return views at half their size, which are made once if memory allows."""
    halves = [halve(view) for view in views]
    targets = Recent[int, TargetPicture](lambda i: halves[i].target, TARGET_BYTES // 4)
    return [replace(half, picture=partial(targets.get, i)) for i, half in enumerate(halves)]


def any_in_blocks(mask: NDArray[np.bool_], side: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return (down, across) whether a block of side x side elements has one of the mask."""
    padded = np.zeros((shape[0] * side, shape[1] * side), np.bool_)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(padded.reshape(shape[0], side, shape[1], side).any(axis=(1, 3)))
