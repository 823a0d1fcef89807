"""Fits to Gaussians that are given frame by frame: what frames have in common is told from what each has of its own.

N Gaussians, V views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.analysis.flow import carry, unmatched
from airgs_codec.media.metrics import psnr
from airgs_codec.progress import Progress
from airgs_codec.scene.gaussians import Gaussians, mix_rows
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.fit.active import find_active
from airgs_codec.trainer.fit.grow import find_wrong
from airgs_codec.trainer.fit.losses import better
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.parameters import Parameters, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.trainer import FrameViews, InMotion, Trainer
from airgs_codec.trainer.fit.variables import PerGaussian, Rates

COMMON_RATES = Rates(factor=3.0, means=0.3, last=0.1, means_last=0.1)  # what is given is nearly right
KNOWN_DB = 28.0  # that Gaussians must have which followed a frame
SPREAD_DB = 16.0  # of the mean of squared errors above half of them: noise had 11, motion that was lost 21 to 23
FAINT = 0.01  # of a colour, by which a pixel differs from the background where something is seen
CONJUGATE = torch.tensor([1.0, -1.0, -1.0, -1.0])


def follow(trainer: Trainer, before: InMotion, given: Gaussians, target: FrameViews) -> Gaussians:
    """The frame before, moved as the Gaussians of a target went on; what rests stays, and all where that shows more."""
    g, views = before.gaussians, target.views
    moved = carry(g, given, before.velocity)
    if target.moving is not None:
        active = find_active(g, views, target.moving, trainer.renderer).rows
        moved = mix_rows(moved, g, np.isin(np.arange(len(g)), active))
    return better(g, moved, views[::2], trainer.renderer)


def is_known(trainer: Trainer, g: Gaussians, views: Sequence[View]) -> bool:
    """Whether Gaussians that followed a frame show it, but for the noise of what is given.

    Noise is spread over all that is seen. What was not followed is in few places: there the mean of squared errors is
    far above their median.
    """
    loaded, errors, shown = trainer.renderer.load(g), [], []
    for view in views:
        drawn, target, behind = loaded.draw(view.camera).rgb, view.target.rgb, view.camera.background
        seen = (np.abs(np.stack([drawn, target]) - np.asarray(behind, np.float32)) > FAINT).any(axis=(0, 3))
        error = ((np.clip(drawn, 0, 1) - target) ** 2).mean(axis=2)
        shown.append(psnr(float(error.mean())))
        errors.append(error[seen])
    found = np.concatenate(errors)
    spread = not len(found) or float(found.mean()) <= 10 ** (SPREAD_DB / 10) * float(np.median(found))
    return spread and float(np.mean(shown)) >= KNOWN_DB


def missing(trainer: Trainer, g: Gaussians, given: Gaussians, target: FrameViews) -> NDArray[np.intp]:
    """The rows of the given Gaussians of a target that `g` lacks where its pictures are wrong."""
    wrong = find_wrong(g, target.views, trainer.renderer)
    rows = find_active(given, target.views, wrong, trainer.renderer).rows
    return np.intersect1d(rows, unmatched(g, given))


def fit_common(
    trainer: Trainer, poses: Sequence[Gaussians], views: Sequence[Sequence[View]], progress: Progress
) -> Gaussians:
    """The first of some frames without what is in it alone; `views`: of each frame.

    Raises TrainingError where the loss is not finite.
    """
    shown = [replace(view, after=float(frame)) for frame, of in enumerate(views) for view in of]
    frames = [from_gaussians(g, trainer.device) for g in poses]
    variables = Carried(frames[0], trainer.extent, COMMON_RATES, frames=frames)
    s = trainer.settings
    schedule = Schedule("what frames share", s.key_iterations, lambda _: s.sh_degree, ssim_weight=s.ssim_weight)
    optimise(variables, shown, schedule, np.random.default_rng(s.seed), None, progress)
    return to_gaussians(variables.detached())


@dataclass(slots=True, eq=False)
class Carried(PerGaussian):
    """One D for several frames in which the base Gaussians are at other places: what all frames show is no noise.

    `base` is as in the first of them. D of means and rotations turns with a row.
    """

    frames: Sequence[Parameters] = ()  # the base Gaussians in each frame

    def current(self, after: float = 0.0) -> Parameters:
        """The Gaussians so many frames after the first, a whole number, differentiable by D."""
        here, d = self.frames[round(after)], self.adam.parameters
        turn = multiply(here["quaternions"], self.base["quaternions"] * CONJUGATE.to(here["means"]))
        turn = torch.nn.functional.normalize(turn, dim=1)
        moved = {n: p + d[n] for n, p in self.base.items() if n not in ("means", "quaternions")}
        return moved | {
            "means": here["means"] + rotate(turn, d["means"]),
            "quaternions": here["quaternions"] + multiply(turn, d["quaternions"]),
        }


def multiply(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """The Hamilton product of quaternions (N, 4)."""
    aw, av, bw, bv = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    vector = aw * bv + bw * av + torch.linalg.cross(av, bv)
    return torch.cat([aw * bw - (av * bv).sum(dim=1, keepdim=True), vector], dim=1)


def rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Vectors (N, 3) turned by unit quaternions (N, 4)."""
    turned = 2 * torch.linalg.cross(q[:, 1:], v)
    return v + q[:, :1] * turned + torch.linalg.cross(q[:, 1:], turned)
