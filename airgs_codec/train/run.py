"""A training run: each frame is in the group of the one before unless its quality falls (AirGS, "Training" 1)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.scene.camera import OPENGL_TO_OPENCV
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.multiview import MultiviewScene
from airgs_codec.train.data.pictures import Pictures, View, pictures_for
from airgs_codec.train.data.plates import Masks, Plates, find_moving, find_plates, settle
from airgs_codec.train.fit.exposure import ExposureModel
from airgs_codec.train.fit.temporal import static_shares
from airgs_codec.train.loss.target import Exposure
from airgs_codec.train.quality import mean_psnr, mean_ssim
from airgs_codec.train.record import FrameRecord, Model, Record, open_model
from airgs_codec.train.settings import TrainSettings
from airgs_codec.train.stages import FrameBefore, FrameViews, Group, Trainer, make_trainer
from airgs_codec.train.usage import group_usage


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What every frame of a run is trained with."""

    scene: MultiviewScene
    pictures: Pictures
    model: Model
    trainer: Trainer
    plates: Plates = field(default_factory=dict)  # of every training camera; none: nothing is known to rest
    _moving: dict[int, Masks] = field(init=False, default_factory=dict)  # of the last frame that was a target

    def views(self, frame: int) -> list[View]:
        """The training views of a frame. Raises SceneError when there are none, or a picture cannot be read."""
        views = self.pictures.train(frame)
        if not views:
            raise SceneError(f"{self.scene.path}: expected training views of frame {frame}, got none")
        return settle(views, self.plates, self.pictures.exposure).views if self.plates else views

    def target(self, frame: int) -> FrameViews:
        """A frame that one comes before, as it is fitted. Raises what `views` does."""
        if not self.plates:
            return FrameViews(frame, self.views(frame))
        exposure = self.pictures.exposure
        before = self._moving.pop(frame - 1, None)  # pictures of a frame that is past may be out of memory
        if before is None:
            before = find_moving(self.pictures.train(frame - 1), self.plates, exposure)
        now = settle(self.pictures.train(frame), self.plates, exposure)
        self._moving[frame] = now.moving
        return FrameViews(frame, now.views, Masks(a | b for a, b in zip(before, now.moving, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A frame that was fitted, and the group that it is in."""

    gaussians: Gaussians
    kind: str  # first | frame | key
    psnr: float  # dB, mean over training views
    group: Group
    added: int = 0
    rejected_psnr: float | None = None  # as in `FrameRecord`
    static: dict[str, float] = field(default_factory=dict)  # as in `FrameRecord`
    exposure: Exposure = field(default_factory=dict)  # found with this frame


def train(
    scene: MultiviewScene,
    folder: Path,
    settings: TrainSettings,
    *,
    resume: bool = False,
    device: str = "cpu",
    progress: Progress = silent,
) -> Model:
    """Train a multi-view scene into a model folder, which `open_sequence` opens and `encode` encodes.

    `resume`: go on where a run in the folder ended. `device`: cpu or cuda. Finished frames stay whatever happens, and a
    run that was stopped and resumed ends with the same files as one that was not.

    Raises SceneError for pictures that cannot be used, ConfigError for a folder that holds something else, and
    TrainingError when a loss is not finite or a frame shows nothing.
    """
    run = open_run(scene, folder, settings, resume=resume, device=device)
    for _ in train_frames(run, progress):
        pass
    return run.model


def open_run(
    scene: MultiviewScene, folder: Path, settings: TrainSettings, *, resume: bool = False, device: str = "cpu"
) -> Run:
    """A run that goes on where the one in the folder ended; arguments and errors are those of `train`."""
    if device == "cpu":
        torch.set_num_threads(1)  # the kernels have their own threads, and two pools fight over the cores
    names = [camera.name for camera in scene.cameras if not camera.held_out]
    if not names:
        raise SceneError(f"{scene.path}: expected training views of the first frame, got none")
    if settings.reference not in (None, *names):
        raise ConfigError(f"--reference: expected a training camera of {', '.join(names)}, got {settings.reference}")
    pictures = pictures_for(scene, settings)
    pictures.check(0)
    model = open_model(folder, Record(_identity(scene, pictures), settings.table(), len(scene), str(scene.fps)), resume)
    if model.record.exposure:
        pictures = pictures.with_exposure(model.record.exposure)
    model.write_cameras(_as_transforms(pictures.cameras(), scene))
    return Run(scene, pictures, model, make_trainer(settings, pictures.train(0), scene.points, device))


def train_frames(run: Run, progress: Progress = silent) -> Iterator[FrameRecord]:
    """Train the frames that are not there yet and give the record of each, when it is kept on disk.

    The run is complete, with the usage of its Gaussians, when the iterator ends. Raises what `train` does.
    """
    model = run.model
    if model.finished():
        return
    if run.trainer.settings.knows_rest:
        run = replace(run, plates=find_plates(run.scene, run.pictures.with_exposure({}), progress))
    group = _last_group(run) if model.record.frames else None
    for frame in range(len(model.record.frames), len(run.scene)):
        begun = time.perf_counter()
        fitted = _fit(run, frame, group, _named(progress, frame, len(run.scene)))
        if fitted.exposure:
            run = replace(run, pictures=run.pictures.with_exposure(fitted.exposure))
        group = fitted.group
        record = _record(run, frame, fitted, time.perf_counter() - begun)
        networks = group.networks.arrays() if group.networks else None
        model.commit(fitted.gaussians, record, networks, fitted.exposure)
        yield record
    spans = model.record.spans()
    model.finish({span: group_usage(model, run.pictures, run.trainer, span, progress) for span in spans})


def frame_before(model: Model, frame: int) -> FrameBefore:
    """What a frame, at least 1, starts from; its velocity is known from the third frame of a group on."""
    before = model.read(frame - 1)
    if frame - 1 == model.record.group_start(frame):
        return FrameBefore(before, None)
    return FrameBefore(before, before.means - model.read(frame - 2).means)


def _fit(run: Run, frame: int, group: Group | None, progress: Progress) -> Fitted:
    s = run.trainer.settings
    if group is None:
        return _fit_first(run, progress)
    target, before = run.target(frame), frame_before(run.model, frame)
    moved = run.trainer.fit_frame(target, before, group, progress)
    psnr = mean_psnr(moved, target.views, run.trainer.renderer)
    static = static_shares(before.gaussians, moved, group.steps)
    fitted = Fitted(moved, "frame", psnr, group, static=static)
    if psnr >= s.min_psnr_db and psnr >= group.first_psnr - s.max_drop_db:
        return fitted
    return _fit_keyframe(run, target, before, fitted, progress)


def _fit_first(run: Run, progress: Progress) -> Fitted:
    """The first frame of the run."""
    views, trainer = run.views(0), run.trainer
    model = _exposures(views, trainer) if trainer.settings.match_exposure else None
    g = trainer.fit_first(FrameViews(0, views), run.scene.points, model, progress)
    exposure = model.table([view.camera.name for view in views]) if model else {}
    if exposure:
        views = replace(run, pictures=run.pictures.with_exposure(exposure)).views(0)
    group = trainer.start_group(g, views)
    return Fitted(g, "first", group.first_psnr, group, exposure=exposure)


def _exposures(views: Sequence[View], trainer: Trainer) -> ExposureModel:
    names, reference = [view.camera.name for view in views], trainer.settings.reference
    return ExposureModel(len(views), trainer.device, None if reference is None else names.index(reference))


def _fit_keyframe(run: Run, target: FrameViews, before: FrameBefore, moved: Fitted, progress: Progress) -> Fitted:
    """A keyframe in the place of a frame that `moved` in its group.

    Where that is as good, and the settings keep only better ones, the frame as it moved.
    """
    g = run.trainer.fit_keyframe(target, before, moved.group.steps, progress)
    psnr = mean_psnr(g, target.views, run.trainer.renderer)
    if run.trainer.settings.keep_better and psnr <= moved.psnr:
        return replace(moved, rejected_psnr=psnr)
    added = len(g) - len(before.gaussians)
    group = run.trainer.start_group(g, target.views)
    return Fitted(g, "key", psnr, group, added=added, rejected_psnr=moved.psnr)


def _last_group(run: Run) -> Group:
    """The group that a run which goes on was in."""
    record = run.model.record
    last = record.frames[-1].frame
    start = record.group_start(last + 1)
    group = run.trainer.start_group(run.model.read(start), run.views(start))
    if group.networks is not None and last > start:
        group.networks.load(run.model.networks())
    return group


def _record(run: Run, frame: int, fitted: Fitted, seconds: float) -> FrameRecord:
    held_out, renderer = run.pictures.held_out(frame), run.trainer.renderer
    rejected = fitted.rejected_psnr
    return FrameRecord(
        frame=frame,
        kind=fitted.kind,
        gaussians=len(fitted.gaussians),
        added=fitted.added,
        psnr=round(fitted.psnr, 3),
        held_out_psnr=round(mean_psnr(fitted.gaussians, held_out, renderer), 3) if held_out else None,
        held_out_ssim=round(mean_ssim(fitted.gaussians, held_out, renderer), 5) if held_out else None,
        rejected_psnr=None if rejected is None else round(rejected, 3),
        static={name: round(share, 4) for name, share in fitted.static.items()},
        seconds=round(seconds, 2),
    )


def _named(progress: Progress, frame: int, frames: int) -> Progress:
    """Progress whose stages say of which frame they are."""
    return lambda stage, done, total: progress(f"frame {frame} of {frames} ({stage})", done, total)


def _identity(scene: MultiviewScene, pictures: Pictures) -> dict[str, Any]:
    """What of a scene must not change between the sessions of a run."""
    cameras = [f"{c.name} {c.split} {c.width}x{c.height} near {c.near:g}" for c in scene.cameras]
    first = scene.frames[0][0].source.where()
    named = {"name": scene.path.resolve().name, "first picture": Path(first).name, "cameras": cameras}
    return {**named, "background": list(pictures.background)}


def _as_transforms(cameras: Sequence[Camera], scene: MultiviewScene) -> dict[str, Any]:
    """The cameras as a nerfstudio transforms.json without pictures."""
    frames = []
    for c in cameras:
        matrix = np.linalg.inv(c.world_to_camera) @ OPENGL_TO_OPENCV
        intrinsics = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
        entry = {"camera": c.name, "split": c.split, "file_path": "", **intrinsics}
        frames.append({**entry, "near": c.near, "transform_matrix": matrix.tolist()})
    return {"camera_model": "PINHOLE", "fps": float(scene.fps), "frames": frames}
