"""Fits of frames one after another (AirGS, "Training" 1), and what they are fitted to.

A frame is in the group of the one before unless its quality falls, or a chunk of the run begins there. Where the
Gaussians of frames are given, what frames share is separated from what only one has. N Gaussians, V views.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.analysis.flow import carry, unmatched
from airgs_codec.analysis.sensitivity import UsageSums
from airgs_codec.media.metrics import psnr
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.gaussians import Gaussians, mix_rows
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.data.pictures import Exposure, FrameViews, Plate, ScenePictures, View
from airgs_codec.trainer.fit.grow import find_wrong
from airgs_codec.trainer.fit.losses import (
    InMotion,
    Parameters,
    better,
    from_gaussians,
    matched_psnr,
    mean_psnr,
    mean_ssim,
    multiply,
    rotate,
    to_gaussians,
)
from airgs_codec.trainer.fit.optimise import ExposureModel, PerGaussian, Rates, Schedule, optimise
from airgs_codec.trainer.fit.trainer import FitGroup, Trainer, find_active, fit_first, make_trainer
from airgs_codec.trainer.record import FrameRecord, ModelFolder, Span, TrainedFrame
from airgs_codec.trainer.settings import ON, TrainSettings

KNOWN_DB = 28.0  # that Gaussians must have which followed a frame
SPREAD_DB = 16.0  # of the mean of squared errors above half of them: noise had 11, motion that was lost 21 to 23
Position = tuple[InMotion, FitGroup]  # what a frame is fitted from, and its group
CONJUGATE = torch.tensor([1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Capture:
    """A scene, its pictures with their plates, and the settings that its frames are fitted with."""

    scene: MultiviewScene
    settings: TrainSettings
    device: str  # cpu or cuda
    pictures: ScenePictures

    @staticmethod
    def of(scene: MultiviewScene, settings: TrainSettings, device: str, plates: Sequence[Plate] = ()) -> Capture:
        """Return the capture of a scene of unknown exposure. `plates`: as in `ScenePictures`."""
        return Capture(scene, settings, device, ScenePictures(scene, settings).with_plates(plates))

    @cached_property
    def trainer(self) -> Trainer:
        """Return what all fits share, opened when needed: a process that only writes results needs no device."""
        if self.device == "cpu":
            torch.set_num_threads(1)  # the kernels have their own threads, and two pools fight over the cores
        return make_trainer(self.settings, self.pictures.train(0), self.scene.points, self.device)

    def with_first(self, g: Gaussians, exposure: Exposure) -> Capture:
        """Return the capture with the exposure of a run, and a capacity of 1.5 times its first frame unless given."""
        s = self.settings
        settings = replace(s, capacity=s.capacity or max(s.budget or 1, round(1.5 * len(g))))
        pictures = self.pictures.with_exposure(exposure) if exposure else self.pictures
        return replace(self, settings=settings, pictures=pictures)

    def given(self, frame: int) -> Gaussians:
        assert self.scene.given is not None
        return self.scene.given.load([frame]).frames[0]

    def usage(self, read: Callable[[int], Gaussians], span: Span, progress: Progress = silent) -> Usage:
        """Measure the usage of a group over its frames [start, stop), as `read`, and all its training views."""
        start, stop = span
        sums = UsageSums(len(read(start)))
        for done, frame in enumerate(range(start, stop), 1):
            loaded = self.trainer.renderer.load(read(frame))
            for view in self.pictures.train(frame):
                sums.add(loaded.contribution(view.camera))
            progress(f"usage: frames {start} to {stop - 1}", done, stop - start)
        return sums.usage()


def progress_of(capture: Capture, progress: Progress) -> Callable[[int], Progress]:
    """Return what gives each frame, ascending, a progress in iterations of the whole run.

    Its stage is `training`, and after a colon the frame. Iterations beyond the plan, as of keyframes, are added to it.
    """
    s, frames = capture.settings, len(capture.scene)
    first = s.iterations_from_scratch(sum(not camera.held_out for camera in capture.scene.cameras))
    plan, spent = [first, *[s.frame_iterations] * (frames - 1)], [0] * frames

    def report(frame: int, stage: str, done: int, total: int) -> None:
        spent[frame] += 1
        plan[frame] = max(plan[frame], spent[frame] + total - done)
        progress(f"training: frame {frame} of {frames} ({stage})", sum(plan[:frame]) + spent[frame], sum(plan))

    return lambda frame: partial(report, frame)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    shown: InMotion
    kind: str  # first | frame | keyframe
    psnr: float  # dB, mean over training views
    group: FitGroup
    added: int = 0
    rejected_psnr: float | None = None  # as in `FrameRecord`


def chunks(frames: int, group_frames: int | None) -> list[Span]:
    """Return the frames of each chunk of a run: all in one, unless `group_frames` cuts it."""
    size = group_frames or frames
    return [(start, min(start + size, frames)) for start in range(0, frames, size)]


def train_first(capture: Capture, progress: Progress = silent, stop: int | None = None) -> TrainedFrame:
    """Train the first frame of a run, and find exposures where they are wanted; `stop`: where its chunk ends."""
    begun, s, views = time.perf_counter(), capture.settings, capture.pictures.at_rest(0)[0]
    trainer, report, exposure = capture.trainer, progress_of(capture, progress)(0), {}
    if capture.scene.given is not None:
        found = InMotion(_given_first(capture, range(stop or chunks(len(capture.scene), s.group_frames)[0][1]), report))
    else:
        names, model = [view.camera.name for view in views], None
        if s.looks_for_exposure:
            looks = None if s.match_exposure == ON else round(0.6 * s.iterations_from_scratch(len(views)))
            reference = names.index(s.reference) if s.reference else None
            model = ExposureModel(len(views), trainer.device, reference, looks)
        found = fit_first(trainer, FrameViews(0, views), capture.scene.points, model, report)
        exposure = model.table(names) if model and model.differs else {}
    if exposure:
        capture = replace(capture, pictures=capture.pictures.with_exposure(exposure))
    fitted = _begun(trainer, "first", found, capture.pictures.at_rest(0)[0])
    return replace(_trained(capture, 0, fitted, begun), exposure=exposure)


def train_chunk(
    capture: Capture, frames: range, first: Gaussians, at: Position | None = None, progress: Progress = silent
) -> Iterator[TrainedFrame]:
    """Fit frames one after another, up to the end of their chunk.

    `at`: the Gaussians that the first of them is fitted from, and their group, which it is in unless its quality falls.
    None: it is a keyframe that starts from the Gaussians of the run's `first` frame, whatever is between them; or it is
    that frame itself, which is not fitted again. Raises what `train` does.
    """
    trainer, report, start = capture.trainer, progress_of(capture, progress), capture.pictures.at_rest(0)[0]
    if at is None and frames.start == 0:
        at, frames = (InMotion(first), trainer.start_group(first, start)), frames[1:]
    for frame in frames:
        begun, left = time.perf_counter(), range(frame, frames.stop)
        if at is None:
            target = capture.pictures.target(frame, 0)
            key = _new_keyframe(capture, target, InMotion(first), trainer.steps(first, start), left, report(frame))
            fitted = _begun(trainer, "keyframe", key, target.views, len(first))
        else:
            fitted = _fit_next(capture, capture.pictures.target(frame, frame - 1), *at, left, report(frame))
        at = fitted.shown if fitted.kind == "frame" else InMotion(fitted.shown.gaussians), fitted.group
        yield _trained(capture, frame, fitted, begun)


def position_after(capture: Capture, model: ModelFolder) -> Position:
    """Return what the frame after the last finished one of a model is fitted from, and its group."""
    last = model.record.frames[-1].frame
    start = model.record.group_start(last + 1)
    group = capture.trainer.start_group(model.read(start), capture.pictures.at_rest(start)[0])
    if last > start:
        group = replace(group, second_psnr=model.record.frames[start + 1].psnr)
        if group.networks is not None:
            group.networks.load(model.networks())
    return frame_before(model, last + 1), group


def frame_before(model: ModelFolder, frame: int) -> InMotion:
    """Return what a frame, at least 1, starts from; its velocity is known from the third frame of a group on."""
    before = model.read(frame - 1)
    if frame - 1 == model.record.group_start(frame):
        return InMotion(before)
    return InMotion(before, before.means - model.read(frame - 2).means)


def _fit_next(
    capture: Capture, target: FrameViews, before: InMotion, group: FitGroup, left: range, progress: Progress
) -> _Fitted:
    """Return a frame in the group of the one before, or a keyframe in its place where its quality falls.

    Where that is no better, and the settings take only better ones, it is the frame as it moved. `left`: it, and the
    later frames of its chunk.
    """
    trainer, s, is_given = capture.trainer, capture.settings, capture.scene.given is not None
    g = follow(trainer, before, capture.given(target.frame), target) if is_given else None
    if g is None or not is_known(trainer, g, target.views):  # its error is more than noise
        g = trainer.fit_frame(target, before if g is None else InMotion(g), group, progress)
    moved = InMotion(g, g.means - before.gaussians.means)
    psnr = mean_psnr(moved, target.views, trainer.renderer)
    second = round(psnr, 3) if group.second_psnr is None else group.second_psnr  # as the record has it
    fitted = _Fitted(moved, "frame", psnr, replace(group, second_psnr=second))
    first = -math.inf if is_given else group.first_psnr
    usual = first if group.second_psnr is None else group.second_psnr
    if psnr >= s.min_psnr_db and psnr >= usual - s.max_drop_db:
        return fitted
    key = _new_keyframe(capture, target, before, group.steps, left, progress)
    keyframe_psnr = mean_psnr(key, target.views, trainer.renderer)
    if s.keep_better and keyframe_psnr <= psnr:
        return replace(fitted, rejected_psnr=keyframe_psnr)
    return replace(_begun(trainer, "keyframe", key, target.views, len(g)), rejected_psnr=psnr)


def _new_keyframe(
    capture: Capture, target: FrameViews, before: InMotion, steps: Parameters, left: range, progress: Progress
) -> InMotion:
    """Fit a keyframe. Where Gaussians are given: those of the frame before and what is missing, if that shows all."""
    if capture.scene.given is None:
        return capture.trainer.fit_keyframe(target, before, steps, progress)
    trainer, given = capture.trainer, capture.given(target.frame)
    g = follow(trainer, before, given, target)
    g = Gaussians.join([g, given.take(missing(trainer, g, given, target))])
    group = FitGroup(math.inf, trainer.steps(g, target.views), None)
    g = trainer.fit_frame(replace(target, moving=None), InMotion(g), group, progress)
    shows_all = mean_psnr(g, target.views, trainer.renderer) >= KNOWN_DB
    return InMotion(g if shows_all else _given_first(capture, left, progress))


def _begun(trainer: Trainer, kind: str, found: InMotion, views: Sequence[View], before: int | None = None) -> _Fitted:
    group, count = trainer.start_group(found.gaussians, views), len(found.gaussians)
    # A run that is resumed reads Gaussians without velocity, so their group is judged by those.
    psnr = group.first_psnr if found.velocity is None else mean_psnr(found, views, trainer.renderer)
    return _Fitted(found, kind, psnr, group, added=0 if before is None else count - before)


def _trained(capture: Capture, frame: int, fitted: _Fitted, begun: float) -> TrainedFrame:
    seconds, held_out = round(time.perf_counter() - begun, 2), capture.pictures.held_out(frame)
    shown, rejected, networks = fitted.shown, fitted.rejected_psnr, fitted.group.networks
    measures, renderer = ((mean_psnr, 3), (matched_psnr, 3), (mean_ssim, 5)), capture.trainer.renderer
    unseen = [round(of(shown, held_out, renderer), digits) if held_out else None for of, digits in measures]
    figures: list[Any] = [len(shown.gaussians), fitted.added, round(fitted.psnr, 3), *unseen]
    figures += [None if rejected is None else round(rejected, 3), seconds, shown.cleared]
    record = FrameRecord(frame, fitted.kind, *figures)
    return TrainedFrame(shown.gaussians, record, networks.arrays() if networks else None)


def _given_first(capture: Capture, frames: range, progress: Progress) -> Gaussians:
    """Return the Gaussians that are given of the first of some frames, without what the next ones do not show."""
    trainer, start = capture.trainer, frames.start
    g, views = capture.given(start), [capture.pictures.at_rest(start)[0]]
    steps, known, floor, before = trainer.steps(g, views[0]), [g], 0.0, InMotion(g)
    for frame in frames[1:12]:
        seen = capture.pictures.at_rest(frame)[0]
        target, given, some = FrameViews(frame, seen), capture.given(frame), seen[::2]
        moved = follow(trainer, before, given, target)
        if not is_known(trainer, moved, some):
            moved = trainer.fit_frame(target, InMotion(moved), FitGroup(math.inf, steps, None), progress)
        psnr = mean_psnr(moved, some, trainer.renderer)
        if psnr < max(floor, KNOWN_DB):
            break
        floor = max(floor, psnr - capture.settings.max_drop_db)
        if frame == start + 1:  # what is not in the first frame by chance
            rows = missing(trainer, moved, given, target)
            known = [Gaussians.join([g, carry(given, g).take(rows)])]
            moved = Gaussians.join([moved, given.take(rows)])
            steps = trainer.steps(known[0], views[0])
        known.append(moved)
        views.append(seen)
        before = InMotion(moved, moved.means - known[-2].means)
    if len(known) == 1:
        return g
    return fit_common(trainer, known, [of[i % 3 :: 3] for i, of in enumerate(views)], progress)


def follow(trainer: Trainer, before: InMotion, given: Gaussians, target: FrameViews) -> Gaussians:
    """Move the frame before to the Gaussians given for a target, but for what is at rest; or all stays, if better."""
    g, views = before.gaussians, target.views
    moved = carry(g, given, before.velocity)
    if target.moving is not None:
        active, _ = find_active(g, views, target.moving, trainer.renderer)
        moved = mix_rows(moved, g, np.isin(np.arange(len(g)), active))
    return better(g, moved, views[::2], trainer.renderer)


def is_known(trainer: Trainer, g: Gaussians, views: Sequence[View]) -> bool:
    """Return whether Gaussians that followed a frame show it but for noise, which is spread, as lost motion is not."""
    loaded, errors, shown = trainer.renderer.load(g), [], []
    for view in views:
        drawn, target, behind = loaded.draw(view.camera).rgb, view.target.rgb, view.camera.background
        seen = (np.abs(np.stack([drawn, target]) - np.asarray(behind, np.float32)) > 0.01).any(axis=(0, 3))
        error = ((np.clip(drawn, 0, 1) - target) ** 2).mean(axis=2)
        shown.append(psnr(float(error.mean())))
        errors.append(error[seen])
    found = np.concatenate(errors)
    spread = not len(found) or float(found.mean()) <= 10 ** (SPREAD_DB / 10) * float(np.median(found))
    return spread and float(np.mean(shown)) >= KNOWN_DB


def missing(trainer: Trainer, g: Gaussians, given: Gaussians, target: FrameViews) -> NDArray[np.intp]:
    """Return the rows of the given Gaussians of a target that are missing in `g` where its pictures are wrong."""
    wrong = find_wrong(g, target.views, trainer.renderer)
    rows, _ = find_active(given, target.views, wrong, trainer.renderer)
    return np.intersect1d(rows, unmatched(g, given))


def fit_common(
    trainer: Trainer, poses: Sequence[Gaussians], views: Sequence[Sequence[View]], progress: Progress
) -> Gaussians:
    """Return the first of some frames without what only it has; `views`: of each. Raises TrainingError."""
    shown = [replace(view, after=float(frame)) for frame, of in enumerate(views) for view in of]
    frames = [from_gaussians(g, trainer.device) for g in poses]
    rates = Rates(factor=3.0, means=0.3, last=0.1, means_last=0.1)  # what is given is nearly right
    variables, s = Carried(frames[0], trainer.extent, rates, frames=frames), trainer.settings
    schedule = Schedule("what frames share", s.keyframe_iterations, lambda _: s.sh_degree, ssim_weight=s.ssim_weight)
    optimise(variables, shown, schedule, np.random.default_rng(s.seed), None, progress)
    return to_gaussians(variables.detached())


@dataclass(slots=True, eq=False)
class Carried(PerGaussian):
    """One D for several frames in which the base Gaussians are at other places: what all frames show is no noise.

    `base` is as in the first of them. D of means and rotations turns with a row.
    """

    frames: Sequence[Parameters] = ()  # the base Gaussians in each frame

    def current(self, after: float = 0.0) -> Parameters:
        """Return the Gaussians `after` frames past the first, a whole number, differentiable by D."""
        here, d = self.frames[round(after)], self.adam.parameters
        turn = multiply(here["quaternions"], self.base["quaternions"] * CONJUGATE.to(here["means"]))
        turn = torch.nn.functional.normalize(turn, dim=1)
        moved = {n: p + d[n] for n, p in self.base.items() if n not in ("means", "quaternions")}
        moved["quaternions"] = here["quaternions"] + multiply(turn, d["quaternions"])
        return moved | {"means": here["means"] + rotate(turn, d["means"])}
