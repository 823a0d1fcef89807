"""Fits of frames one after another (AirGS, "Training" 1), and what they are fitted to.

A frame is in the group of the one before unless its quality falls, or a chunk of the run begins there. Where the
Gaussians of frames are given, what frames have in common is told from what each has of its own. N Gaussians, V views.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
from airgs_codec.trainer.data.pictures import Exposure, FrameViews, Pictures, Plate, View, pictures_for
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
from airgs_codec.trainer.fit.trainer import Group, Trainer, find_active, fit_first, make_trainer
from airgs_codec.trainer.record import FrameRecord, Model, Span, TrainedFrame
from airgs_codec.trainer.settings import ON, TrainSettings

FOLLOWED = 0.6  # what an iteration of a frame that follows another takes, in those of a first frame
CAPACITY = 1.5  # times as many Gaussians as the first frame has may there ever be, unless settings say more
LOOKED_SHARE = 0.6  # of the iterations of a first frame, which tell whether cameras are exposed differently
WINDOW = 12  # frames that tell what given frames have in common
SHARES = 3  # one view in so many of each of them does
COMMON_RATES = Rates(factor=3.0, means=0.3, last=0.1, means_last=0.1)  # what is given is nearly right
KNOWN_DB = 28.0  # that Gaussians must have which followed a frame
SPREAD_DB = 16.0  # of the mean of squared errors above half of them: noise had 11, motion that was lost 21 to 23
FAINT = 0.01  # of a colour, by which a pixel differs from the background where something is seen
CONJUGATE = torch.tensor([1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Capture:
    """A scene, its pictures, what rests in them, and the settings that its frames are fitted with."""

    scene: MultiviewScene
    settings: TrainSettings
    device: str  # cpu or cuda
    pictures: Pictures

    @staticmethod
    def of(scene: MultiviewScene, settings: TrainSettings, device: str, plates: Sequence[Plate] = ()) -> Capture:
        """A scene whose exposure is not known. `device`: cpu or cuda. `plates`: as in `Pictures`."""
        return Capture(scene, settings, device, pictures_for(scene, settings).with_plates(plates))

    @cached_property
    def trainer(self) -> Trainer:
        """What all fits share, opened when a fit asks for it: who only writes what others fitted needs no device."""
        if self.device == "cpu":
            torch.set_num_threads(1)  # the kernels have their own threads, and two pools fight over the cores
        return make_trainer(self.settings, self.pictures.train(0), self.scene.points, self.device)

    def with_first(self, g: Gaussians, exposure: Exposure) -> Capture:
        """The same whose first frame is known, its pictures as the average camera would have exposed them."""
        s = self.settings
        settings = replace(s, capacity=s.capacity or max(s.budget or 1, round(CAPACITY * len(g))))
        pictures = self.pictures.with_exposure(exposure) if exposure else self.pictures
        return replace(self, settings=settings, pictures=pictures)

    def given(self, frame: int) -> Gaussians:
        assert self.scene.given is not None
        return self.scene.given.load([frame]).frames[0]

    def usage(self, read: Callable[[int], Gaussians], span: Span, progress: Progress = silent) -> Usage:
        """The usage of a group over its frames [start, stop), which `read` gives, and all its training views."""
        start, stop = span
        sums = UsageSums(len(read(start)))
        for done, frame in enumerate(range(start, stop), 1):
            loaded = self.trainer.renderer.load(read(frame))
            for view in self.pictures.train(frame):
                sums.add(loaded.contribution(view.camera))
            progress(f"usage of frames {start} to {stop - 1}", done, stop - start)
        return sums.usage()


def told_of_run(capture: Capture, progress: Progress) -> Callable[[int], Progress]:
    """Progress of the whole run, in iterations of a first frame, from that of each frame's fits, ascending.

    Its stage is `training`, and after a colon the frame. Which frames become keyframes is not known before; what they
    take more is added when they do.
    """
    s, frames = capture.settings, len(capture.scene)
    first = s.iterations_from_scratch(sum(not camera.held_out for camera in capture.scene.cameras))
    later, more = FOLLOWED * s.frame_iterations, 0.0

    def of(frame: int) -> Progress:
        planned, cost = (later, FOLLOWED) if frame else (first, 1.0)
        begun = (first + (frame - 1) * later if frame else 0.0) + more
        past, now, earlier = 0.0, ("", 0.0), more

        def tell(stage: str, done: int, total: int) -> None:
            nonlocal past, now, more
            if stage != now[0]:
                past, now = past + now[1], (stage, cost * total)
            more = earlier + max(0.0, past + cost * total - planned)
            whole = first + (frames - 1) * later + more
            progress(f"training: frame {frame} of {frames} ({stage})", round(begun + past + cost * done), round(whole))

        return tell

    return of


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    shown: InMotion
    kind: str  # first | frame | keyframe
    psnr: float  # dB, mean over training views
    group: Group
    added: int = 0
    rejected_psnr: float | None = None  # as in `FrameRecord`


def chunks(frames: int, group_frames: int | None) -> list[Span]:
    """The frames of each chunk of a run of so many frames: all, unless `group_frames` cuts it."""
    size = group_frames or frames
    return [(start, min(start + size, frames)) for start in range(0, frames, size)]


def train_first(capture: Capture, progress: Progress = silent, stop: int | None = None) -> TrainedFrame:
    """The first frame of a run, with the exposures that were asked for; `stop`: where its chunk ends."""
    begun, s, trainer, target = time.perf_counter(), capture.settings, capture.trainer, capture.pictures.first()
    views, told, model = target.views, told_of_run(capture, progress)(0), None
    if capture.scene.given is not None:
        end = stop or chunks(len(capture.scene), s.group_frames)[0][1]
        found = InMotion(_given_first(capture, range(end), told))
    else:
        model = _exposures(target, trainer) if s.looks_for_exposure else None
        found = fit_first(trainer, target, capture.scene.points, model, told)
    exposure = model.table([view.camera.name for view in views]) if model and model.differs else {}
    exposed = replace(capture, pictures=capture.pictures.with_exposure(exposure)) if exposure else capture
    fitted = _begun(trainer, "first", found, exposed.pictures.at_rest(0)[0])
    return replace(_trained(exposed, 0, fitted, begun), exposure=exposure)


def _exposures(target: FrameViews, trainer: Trainer) -> ExposureModel:
    names, s, count = [view.camera.name for view in target.views], trainer.settings, len(target.views)
    looks = None if s.match_exposure == ON else round(LOOKED_SHARE * s.iterations_from_scratch(count))
    again = [names.index(view.camera.name) for view in target.later]
    return ExposureModel(count, trainer.device, names.index(s.reference) if s.reference else None, looks, again)


def train_chunk(
    capture: Capture,
    frames: range,
    first: Gaussians,
    at: tuple[InMotion, Group] | None = None,
    progress: Progress = silent,
) -> Iterator[TrainedFrame]:
    """Fit frames one after another, up to the end of their chunk.

    `at`: the Gaussians that the first of them is fitted from, and their group, which it is in unless its quality falls.
    None: it is a keyframe that starts from the Gaussians of the run's `first` frame, so that nothing between them need
    be known; or it is that frame itself, which is not fitted again. Raises what `train` does.
    """
    trainer, told = capture.trainer, told_of_run(capture, progress)
    if at is None and frames.start == 0:
        at, frames = (InMotion(first), trainer.start_group(first, capture.pictures.at_rest(0)[0])), frames[1:]
    for frame in frames:
        begun, left = time.perf_counter(), range(frame, frames.stop)
        if at is None:
            before, target = InMotion(first), capture.pictures.target(frame, 0)
            key = _new_keyframe(
                capture, target, before, trainer.steps(first, capture.pictures.at_rest(0)[0]), left, told(frame)
            )
            fitted = _begun(trainer, "keyframe", key, target.views, len(first))
        else:
            fitted = _fit_next(capture, capture.pictures.target(frame, frame - 1), *at, left, told(frame))
        at = fitted.shown if fitted.kind == "frame" else InMotion(fitted.shown.gaussians), fitted.group
        yield _trained(capture, frame, fitted, begun)


def position_after(capture: Capture, model: Model) -> tuple[InMotion, Group]:
    """What the frame behind the last finished one of a model is fitted from, and its group."""
    last = model.record.frames[-1].frame
    start = model.record.group_start(last + 1)
    group = capture.trainer.start_group(model.read(start), capture.pictures.at_rest(start)[0])
    if group.networks is not None and last > start:
        group.networks.load(model.networks())
    if last > start:
        group = replace(group, second_psnr=model.record.frames[start + 1].psnr)
    return frame_before(model, last + 1), group


def frame_before(model: Model, frame: int) -> InMotion:
    """What a frame, at least 1, starts from; its velocity is known from the third frame of a group on."""
    before = model.read(frame - 1)
    if frame - 1 == model.record.group_start(frame):
        return InMotion(before)
    return InMotion(before, before.means - model.read(frame - 2).means)


def _fit_next(
    capture: Capture, target: FrameViews, before: InMotion, group: Group, left: range, progress: Progress
) -> _Fitted:
    """A frame in the group of the one before, or a keyframe in its place where its quality falls.

    Where that is no better, and the settings take only better ones, it is the frame as it moved. `left`: it, and the
    frames of its chunk behind it.
    """
    trainer, s, is_given = capture.trainer, capture.settings, capture.scene.given is not None
    g = _follow_given(capture, target, before) if is_given else None
    if g is None or not is_known(trainer, g, target.views):  # what following lacks is more than noise
        g = trainer.fit_frame(target, before if g is None else InMotion(g), group, progress)
    moved = InMotion(g, g.means - before.gaussians.means)
    psnr = mean_psnr(moved, target.views, trainer.renderer)
    second = round(psnr, 3) if group.second_psnr is None else group.second_psnr  # as the record has it
    fitted = _Fitted(moved, "frame", psnr, replace(group, second_psnr=second))
    first = -math.inf if is_given else group.first_psnr
    known = first if group.second_psnr is None else group.second_psnr
    if psnr >= s.min_psnr_db and psnr >= known - s.max_drop_db:
        return fitted
    key = _new_keyframe(capture, target, before, group.steps, left, progress)
    keyframe_psnr = mean_psnr(key, target.views, trainer.renderer)
    if s.keep_better and keyframe_psnr <= psnr:
        return replace(fitted, rejected_psnr=keyframe_psnr)
    return replace(_begun(trainer, "keyframe", key, target.views, len(g)), rejected_psnr=psnr)


def _new_keyframe(
    capture: Capture, target: FrameViews, before: InMotion, steps: Parameters, left: range, progress: Progress
) -> InMotion:
    if capture.scene.given is None:
        return capture.trainer.fit_keyframe(capture.pictures.key(target), before, steps, progress)
    return InMotion(_given_keyframe(capture, target, before, left, progress))


def _begun(trainer: Trainer, kind: str, found: InMotion, views: Sequence[View], before: int | None = None) -> _Fitted:
    group, count = trainer.start_group(found.gaussians, views), len(found.gaussians)
    # A run that goes on reads Gaussians alone, so their group is judged by those, where they are.
    psnr = group.first_psnr if found.velocity is None else mean_psnr(found, views, trainer.renderer)
    return _Fitted(found, kind, psnr, group, added=0 if before is None else count - before)


def _trained(capture: Capture, frame: int, fitted: _Fitted, begun: float) -> TrainedFrame:
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


def _given_keyframe(
    capture: Capture, target: FrameViews, before: InMotion, left: range, progress: Progress
) -> Gaussians:
    """The Gaussians of the frame before with what they lack, or those that are given where that does not show all."""
    trainer, given = capture.trainer, capture.given(target.frame)
    g = _follow_given(capture, target, before)
    g = Gaussians.join([g, given.take(missing(trainer, g, given, target))])
    group = Group(math.inf, trainer.steps(g, target.views), None)
    g = trainer.fit_frame(replace(target, moving=None), InMotion(g), group, progress)
    if mean_psnr(g, target.views, trainer.renderer) >= KNOWN_DB:
        return g
    return _given_first(capture, left, progress)


def _given_first(capture: Capture, frames: range, progress: Progress) -> Gaussians:
    """The Gaussians that are given of the first of some frames, without what is not in those behind it as well."""
    trainer, start = capture.trainer, frames.start
    g, views = capture.given(start), [capture.pictures.at_rest(start)[0]]
    steps, known, floor = trainer.steps(g, views[0]), [g], 0.0
    before = InMotion(g)
    for frame in frames[1:WINDOW]:
        seen = capture.pictures.at_rest(frame)[0]
        target, given, some = FrameViews(frame, seen), capture.given(frame), seen[::2]
        moved = follow(trainer, before, given, target)
        if not is_known(trainer, moved, some):
            moved = trainer.fit_frame(target, InMotion(moved), Group(math.inf, steps, None), progress)
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
    return fit_common(trainer, known, [of[i % SHARES :: SHARES] for i, of in enumerate(views)], progress)


def _follow_given(capture: Capture, target: FrameViews, before: InMotion) -> Gaussians:
    return follow(capture.trainer, before, capture.given(target.frame), target)


def follow(trainer: Trainer, before: InMotion, given: Gaussians, target: FrameViews) -> Gaussians:
    """The frame before, moved as the Gaussians of a target went on; what rests stays, and all where that shows more."""
    g, views = before.gaussians, target.views
    moved = carry(g, given, before.velocity)
    if target.moving is not None:
        active = find_active(g, views, target.moving, trainer.renderer).rows
        moved = mix_rows(moved, g, np.isin(np.arange(len(g)), active))
    return better(g, moved, views[::2], trainer.renderer)


def is_known(trainer: Trainer, g: Gaussians, views: Sequence[View]) -> bool:
    """Whether Gaussians that followed a frame show it but for noise, which is spread: lost motion is in few places."""
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
    """The first of some frames without what is in it alone; `views`: of each. Raises TrainingError."""
    shown = [replace(view, after=float(frame)) for frame, of in enumerate(views) for view in of]
    frames = [from_gaussians(g, trainer.device) for g in poses]
    variables, s = Carried(frames[0], trainer.extent, COMMON_RATES, frames=frames), trainer.settings
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
        """The Gaussians so many frames after the first, a whole number, differentiable by D."""
        here, d = self.frames[round(after)], self.adam.parameters
        turn = multiply(here["quaternions"], self.base["quaternions"] * CONJUGATE.to(here["means"]))
        turn = torch.nn.functional.normalize(turn, dim=1)
        moved = {n: p + d[n] for n, p in self.base.items() if n not in ("means", "quaternions")}
        return moved | {
            "means": here["means"] + rotate(turn, d["means"]),
            "quaternions": here["quaternions"] + multiply(turn, d["quaternions"]),
        }
