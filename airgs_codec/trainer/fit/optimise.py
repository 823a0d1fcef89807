"""The loop that fits Gaussians to pictures: first frames, keyframes and frames in a group all run through it.

It may begin with pictures of half the size: large motion is a small one there, and an iteration costs less.

N Gaussians, V views, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
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
from airgs_codec.render.differentiable import Picture as Drawn
from airgs_codec.scene.camera import with_pixels
from airgs_codec.trainer.data.pictures import Target, View
from airgs_codec.trainer.fit.losses import LAMBDA, ExposureModel, photometric
from airgs_codec.trainer.fit.parameters import Parameters, render_views

LOOK_EVERY = 50  # iterations on CUDA until it is seen whether losses are finite; rows are added no more often


class Variables(Protocol):
    def current(self, after: float = 0.0) -> Parameters:
        """The Gaussians as they are now, so many frames after their time, differentiable by the variables."""

    def watch(self) -> AbsGrad | None:
        """Where the absolute gradients of the next picture are wanted; None: nowhere."""

    def penalty(self) -> torch.Tensor | float:
        """Return what is added to the loss of the picture."""

    def step(self, iteration: int, iterations: int) -> None:
        """Move along the gradients; this is iteration 1 .. iterations."""


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
