"""Fits of frames one after another (AirGS, "Training" 1).

A frame is in the group of the one before unless its quality falls, or a chunk of the run begins there. Where the
Gaussians of frames are given, what frames have in common is told from what each has of its own. N Gaussians, V views.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.analysis.flow import carry, unmatched
from airgs_codec.media.metrics import psnr
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.gaussians import Gaussians, mix_rows
from airgs_codec.trainer.capture import Capture
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.fit.active import find_active
from airgs_codec.trainer.fit.first import fit_first
from airgs_codec.trainer.fit.grow import find_wrong
from airgs_codec.trainer.fit.losses import ExposureModel, better, matched_psnr, mean_psnr, mean_ssim
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.parameters import InMotion, Parameters, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.trainer import FrameViews, Group, Trainer
from airgs_codec.trainer.fit.variables import PerGaussian, Rates
from airgs_codec.trainer.record import FrameRecord, Model, Span, TrainedFrame
from airgs_codec.trainer.settings import ON

LOOKED_SHARE = 0.6  # of the iterations of a first frame, which tell whether cameras are exposed differently
WINDOW = 12  # frames that tell it
SHARES = 3  # one view in so many of each of them does
COMMON_RATES = Rates(factor=3.0, means=0.3, last=0.1, means_last=0.1)  # what is given is nearly right
KNOWN_DB = 28.0  # that Gaussians must have which followed a frame
SPREAD_DB = 16.0  # of the mean of squared errors above half of them: noise had 11, motion that was lost 21 to 23
FAINT = 0.01  # of a colour, by which a pixel differs from the background where something is seen
CONJUGATE = torch.tensor([1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """The frame and the group that the next frame is fitted from."""

    before: InMotion
    group: Group


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A frame that was fitted, and the group that it is in."""

    shown: InMotion
    kind: str  # first | frame | key
    psnr: float  # dB, mean over training views
    group: Group
    added: int = 0
    rejected_psnr: float | None = None  # as in `FrameRecord`


def chunks(frames: int, group_frames: int | None) -> list[Span]:
    """The frames of each chunk of a run of so many frames: all, unless `group_frames` cuts it."""
    size = group_frames or frames
    return [(start, min(start + size, frames)) for start in range(0, frames, size)]


def train_first(capture: Capture, progress: Progress = silent) -> TrainedFrame:
    """The first frame of a run, with the exposure of its cameras where it is wanted. Raises what `train` does."""
    begun, trainer, target = time.perf_counter(), capture.trainer, capture.first()
    named, views = capture.told(progress).of(0), target.views
    model = _exposures(target, trainer) if trainer.settings.looks_for_exposure and not capture.scene.given else None
    if capture.scene.given is None:
        found = fit_first(trainer, target, capture.scene.points, model, named)
    else:
        found = InMotion(_given_first(capture, 0, named))
    exposure = model.table([view.camera.name for view in views]) if model and model.differs else {}
    exposed = capture.with_exposure(exposure)
    return replace(_trained(exposed, 0, _begun(exposed, "first", found, exposed.views(0)), begun), exposure=exposure)


def train_chunk(
    capture: Capture, frames: range, first: Gaussians, at: Position | None = None, progress: Progress = silent
) -> Iterator[TrainedFrame]:
    """Fit frames one after another.

    `at`: what the first of them is fitted from, in the group of the frame before unless its quality falls. None: it is
    a keyframe that starts from the Gaussians of the run's `first` frame, so that nothing between them need be known; or
    it is that frame itself, which is not fitted again. Raises what `train` does.
    """
    if at is None and frames.start == 0:
        group = capture.trainer.start_group(first, capture.views(0))
        at, frames = Position(InMotion(first), group), frames[1:]
    told = capture.told(progress)
    for frame in frames:
        begun, named = time.perf_counter(), told.of(frame)
        if at is None:
            before, target = InMotion(first), capture.target(frame, 0)
            steps = capture.trainer.steps(first, capture.views(0))
            fitted = _begun(capture, "key", _new_key(capture, target, before, steps, named), target.views, len(first))
        else:
            fitted = _fit_next(capture, capture.target(frame, frame - 1), at, named)
        shown = fitted.shown
        at = Position(shown if fitted.kind == "frame" else InMotion(shown.gaussians), fitted.group)
        yield _trained(capture, frame, fitted, begun)


def position_after(capture: Capture, model: Model) -> Position:
    """Return what the frame behind the last finished one of a model is fitted from."""
    last = model.record.frames[-1].frame
    start = model.record.group_start(last + 1)
    group = capture.trainer.start_group(model.read(start), capture.views(start))
    if group.networks is not None and last > start:
        group.networks.load(model.networks())
    if last > start:
        group = replace(group, second_psnr=model.record.frames[start + 1].psnr)
    return Position(frame_before(model, last + 1), group)


def frame_before(model: Model, frame: int) -> InMotion:
    """Return what a frame, at least 1, starts from; its velocity is known from the third frame of a group on."""
    before = model.read(frame - 1)
    if frame - 1 == model.record.group_start(frame):
        return InMotion(before)
    return InMotion(before, before.means - model.read(frame - 2).means)


def _fit_next(capture: Capture, target: FrameViews, at: Position, progress: Progress) -> _Fitted:
    """A frame in the group of the one before, or a keyframe in its place where its quality falls.

    Where that is no better, and the settings take only better ones, it is the frame as it moved.
    """
    trainer, s = capture.trainer, capture.trainer.settings
    before, group = at.before, at.group
    g = _moved(capture, target, at, progress)
    moved = InMotion(g, g.means - before.gaussians.means)
    psnr = mean_psnr(moved, target.views, trainer.renderer)
    second = round(psnr, 3) if group.second_psnr is None else group.second_psnr  # as the record has it
    fitted = _Fitted(moved, "frame", psnr, replace(group, second_psnr=second))
    first = -math.inf if capture.scene.given else group.first_psnr
    known = first if group.second_psnr is None else group.second_psnr
    if psnr >= s.min_psnr_db and psnr >= known - s.max_drop_db:
        return fitted
    key = _new_key(capture, target, before, group.steps, progress)
    key_psnr = mean_psnr(key, target.views, trainer.renderer)
    if s.keep_better and key_psnr <= psnr:
        return replace(fitted, rejected_psnr=key_psnr)
    return replace(_begun(capture, "key", key, target.views, len(g)), rejected_psnr=psnr)


def _moved(capture: Capture, target: FrameViews, at: Position, progress: Progress) -> Gaussians:
    """The Gaussians of the frame before as the target shows them.

    Where they are given, they are followed first; the fit is left out where what that lacks is noise.
    """
    trainer, before = capture.trainer, at.before
    if capture.scene.given is not None:
        g = follow(trainer, before, capture.given(target.frame), target)
        if is_known(trainer, g, target.views):
            return g
        before = InMotion(g)
    return trainer.fit_frame(target, before, at.group, progress)


def _new_key(capture: Capture, target: FrameViews, before: InMotion, steps: Parameters, progress: Progress) -> InMotion:
    """The Gaussians of a keyframe that goes on from another frame, whose values have these steps."""
    if capture.scene.given is None:
        return capture.trainer.fit_keyframe(capture.key(target), before, steps, progress)
    return InMotion(_given_key(capture, target, before, progress))


def _given_key(capture: Capture, target: FrameViews, before: InMotion, progress: Progress) -> Gaussians:
    """The Gaussians of the frame before with what they lack, or those that are given where that does not show all."""
    trainer, given = capture.trainer, capture.given(target.frame)
    g = follow(trainer, before, given, target)
    g = Gaussians.join([g, given.take(missing(trainer, g, given, target))])
    group = Group(math.inf, trainer.steps(g, target.views), None)
    g = trainer.fit_frame(replace(target, moving=None), InMotion(g), group, progress)
    if mean_psnr(g, target.views, trainer.renderer) >= KNOWN_DB:
        return g
    return _given_first(capture, target.frame, progress)


def _given_first(capture: Capture, start: int, progress: Progress) -> Gaussians:
    """The Gaussians that are given of a frame, without what is not in the frames behind it as well."""
    trainer, g = capture.trainer, capture.given(start)
    views = [capture.views(start)]
    steps, frames, floor = trainer.steps(g, views[0]), [g], 0.0
    at = Position(InMotion(g), Group(math.inf, steps, None))
    behind = range(start + 1, min(start + WINDOW, len(capture.scene)))
    for frame in itertools.takewhile(lambda frame: capture.scene.frames[frame], behind):
        seen = capture.views(frame)
        target = FrameViews(frame, seen)
        moved = follow(trainer, at.before, capture.given(frame), target)
        if not is_known(trainer, moved, target.views[::2]):
            moved = trainer.fit_frame(target, InMotion(moved), at.group, progress)
        psnr = mean_psnr(moved, target.views[::2], trainer.renderer)
        if psnr < max(floor, KNOWN_DB):
            break
        floor = max(floor, psnr - capture.settings.max_drop_db)
        if frame == start + 1:  # what is not in the first frame by chance
            given, (g,) = capture.given(frame), frames
            rows = missing(trainer, moved, given, target)
            frames = [Gaussians.join([g, carry(given, g).take(rows)])]
            moved = Gaussians.join([moved, given.take(rows)])
            at = replace(at, group=replace(at.group, steps=trainer.steps(frames[0], views[0])))
        frames.append(moved)
        views.append(seen)
        at = replace(at, before=InMotion(moved, moved.means - frames[-2].means))
    if len(frames) == 1:
        return g
    return fit_common(trainer, frames, [of[i % SHARES :: SHARES] for i, of in enumerate(views)], progress)


def _begun(capture: Capture, kind: str, found: InMotion, views: Sequence[View], before: int | None = None) -> _Fitted:
    """What was found as the first frame of a new group; `before`: Gaussians of the frame that it goes on from."""
    group, count = capture.trainer.start_group(found.gaussians, views), len(found.gaussians)
    # A run that goes on reads Gaussians alone, so their group is judged by those, where they are.
    psnr = group.first_psnr if found.velocity is None else mean_psnr(found, views, capture.trainer.renderer)
    return _Fitted(found, kind, psnr, group, added=0 if before is None else count - before)


def _exposures(target: FrameViews, trainer: Trainer) -> ExposureModel:
    names, s, count = [view.camera.name for view in target.views], trainer.settings, len(target.views)
    looks = None if s.match_exposure == ON else round(LOOKED_SHARE * s.iterations_from_scratch(count))
    again = [names.index(view.camera.name) for view in target.later]
    return ExposureModel(count, trainer.device, names.index(s.reference) if s.reference else None, looks, again)


def _trained(capture: Capture, frame: int, fitted: _Fitted, begun: float) -> TrainedFrame:
    """The frame with its record; `begun`: when its fit was, by `time.perf_counter`."""
    seconds = time.perf_counter() - begun
    held_out, renderer, shown = capture.pictures.held_out(frame), capture.trainer.renderer, fitted.shown
    rejected, networks = fitted.rejected_psnr, fitted.group.networks
    record = FrameRecord(
        frame=frame,
        kind=fitted.kind,
        gaussians=len(shown.gaussians),
        added=fitted.added,
        cleared=shown.cleared,
        psnr=round(fitted.psnr, 3),
        held_out_psnr=round(mean_psnr(shown, held_out, renderer), 3) if held_out else None,
        held_out_matched=round(matched_psnr(shown, held_out, renderer), 3) if held_out else None,
        held_out_ssim=round(mean_ssim(shown, held_out, renderer), 5) if held_out else None,
        rejected_psnr=None if rejected is None else round(rejected, 3),
        seconds=round(seconds, 2),
    )
    return TrainedFrame(shown.gaussians, record, networks.arrays() if networks else None)


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
