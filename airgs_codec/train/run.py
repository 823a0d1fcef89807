"""A training run: frame by frame, each in the group of the one before unless it fails there."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from airgs_codec.errors import SceneError
from airgs_codec.media.metrics import mse, psnr, ssim
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, cpu, measure_contribution
from airgs_codec.scene.camera import OPENGL_TO_OPENCV
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.usage import Usage
from airgs_codec.train.data.multiview import Pictures, Scene, View
from airgs_codec.train.fit.deltas import Networks
from airgs_codec.train.fit.exposure import Tones
from airgs_codec.train.fit.parameters import ATTRIBUTES, Parameters
from airgs_codec.train.fit.temporal import static_shares
from airgs_codec.train.record import FrameRecord, Model, open_model, write_cameras
from airgs_codec.train.settings import TrainSettings
from airgs_codec.train.stages import Trainer, make_trainer

Finished = Callable[[FrameRecord], None]


@dataclass(slots=True, eq=False)
class _Group:
    """What the frames of a group are fitted with."""

    start_psnr: float
    steps: Parameters  # codec steps at its first frame
    networks: Networks | None


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    gaussians: Gaussians
    kind: str
    rejected: float | None = None
    added: int = 0


def train(
    scene: Scene,
    folder: Path,
    settings: TrainSettings,
    *,
    resume: bool = False,
    device: str = "cpu",
    progress: Progress = silent,
    finished: Finished = lambda record: None,
) -> Model:
    """Train `scene` into the model folder; with `resume` from where a run there ended.

    Raises SceneError, ConfigError, TrainingError; finished frames stay.
    """
    if device == "cpu":
        torch.set_num_threads(1)  # the kernels have their own threads, and two pools fight over the cores
    pictures = Pictures(scene, settings.max_size, settings.foreground)
    if not pictures.train(0):
        raise SceneError(f"{scene.path}: expected training views of the first frame, got none")
    model = open_model(folder, _fingerprint(scene), settings, len(scene), resume)
    write_cameras(folder, _transforms(pictures.cameras(), scene))
    if model.finished():
        return model
    run = _Run(scene, pictures, model, settings, device, progress)
    for frame in range(len(model.record.frames), len(scene)):
        finished(run.train_frame(frame))
    groups = _spans(model.record.keyframes(), len(scene))
    usage = {span: run.usage(*span) for span in groups}
    model.finish(usage)
    return model


class _Run:
    def __init__(
        self, scene: Scene, pictures: Pictures, model: Model, settings: TrainSettings, device: str, progress: Progress
    ) -> None:
        self._scene, self._pictures, self._model, self._settings = scene, pictures, model, settings
        self._progress = progress
        self._trainer: Trainer = make_trainer(settings, pictures.train(0), scene.points, device)
        self._group: _Group | None = None
        pictures.expose_alike(model.record.exposure)

    def train_frame(self, frame: int) -> FrameRecord:
        """Fit a frame and keep it."""
        begun = time.perf_counter()
        views = self._pictures.train(frame)
        if not views:
            raise SceneError(f"{self._scene.path}: expected training views of frame {frame}, got none")
        fitted = self._fit(frame, views)
        views = self._pictures.train(frame)  # as they are exposed now
        g = fitted.gaussians
        static = {}
        if fitted.kind == "frame" and self._group is not None:
            static = static_shares(self._model.read(frame - 1), g, self._group.steps)
        seconds = time.perf_counter() - begun
        record = FrameRecord(
            frame=frame,
            kind=fitted.kind,
            gaussians=len(g),
            added=fitted.added,
            psnr=round(_psnr(g, views), 3),
            **_held_out(g, self._pictures.held_out(frame)),
            rejected_psnr=None if fitted.rejected is None else round(fitted.rejected, 3),
            static={name: round(share, 4) for name, share in static.items()},
            seconds=round(seconds, 2),
        )
        networks = self._group.networks if self._group else None
        self._model.commit(g, record, networks.arrays() if networks else None, str(self._scene.fps))
        return record

    def _fit(self, frame: int, views: Sequence[View]) -> _Fitted:
        s, trainer = self._settings, self._trainer
        start = None if frame == 0 else self._model.record.group_start()
        if start is None or s.method == "naive3dgs" or (s.method == "v3" and frame - start >= s.group):
            tones = Tones(len(views), trainer.device) if s.match_exposure and frame == 0 else None
            points = self._scene.points if frame == 0 else None  # a given cloud is of the first frame
            first = trainer.first(frame, points, views, tones, self._tick(frame, "first frame"))
            if tones is not None:
                self._model.record.exposure = tones.table([view.camera.name for view in views])
                self._pictures.expose_alike(self._model.record.exposure)
                views = self._pictures.train(frame)
            self._open(first, views)
            return _Fitted(first, "first" if frame == 0 else "key", added=0)
        before = self._model.read(frame - 1)
        velocity = before.means - self._model.read(frame - 2).means if frame - 1 > start else None
        group = self._group or self._reopen(start)
        moved = trainer.frame(frame, before, velocity, group.steps, views, group.networks, self._tick(frame, "frame"))
        quality = _psnr(moved, views)
        if s.method == "v3" or (quality >= s.tau and quality >= group.start_psnr - s.drop):
            return _Fitted(moved, "frame")
        new = trainer.keyframe(frame, before, velocity, group.steps, views, self._tick(frame, "keyframe"))
        self._open(new, views)
        return _Fitted(new, "key", rejected=quality, added=len(new) - len(before))

    def _open(self, g: Gaussians, views: Sequence[View]) -> None:
        """A group that starts at `g`."""
        self._group = _Group(_psnr(g, views), self._trainer.steps(g, views), self._trainer.networks(g))

    def _reopen(self, start: int) -> _Group:
        """The group that a run which ended was in."""
        self._open(self._model.read(start), self._pictures.train(start))
        assert self._group is not None
        if self._group.networks is not None and self._model.record.frames[-1].frame > start:
            self._group.networks.load(self._model.networks())
        return self._group

    def _tick(self, frame: int, what: str) -> Callable[[int, int], None]:
        name = f"frame {frame} of {len(self._scene)}" + (f" ({what})" if what != "frame" else "")
        return lambda done, of: self._progress(name, done, of)

    def usage(self, start: int, stop: int) -> Usage:
        """Usage over all frames of a group and all training views, and what that is worth times the change."""
        first = self._model.read(start)
        steps = self._trainer.steps(first, self._pictures.train(start))
        n = len(first)
        total, peak, hits, moved = np.zeros(n), np.zeros(n), np.zeros(n, np.int64), np.zeros(n)
        for frame in range(start, stop):
            self._progress("usage", frame, len(self._scene))
            g = self._model.read(frame)
            seen = np.zeros(n)
            for view in self._pictures.train(frame):
                c = measure_contribution(g, view.camera)
                total += c.total
                hits += c.hits
                seen = np.maximum(seen, c.peak)
            peak = np.maximum(peak, seen)
            moved = np.maximum(moved, seen * _change(first, g, steps))
        return Usage(total, peak, hits, moved)


def _change(a: Gaussians, b: Gaussians, steps: Parameters) -> np.ndarray:
    """(N,) size of the change from a to b in codec steps, over all channels."""
    square = np.zeros(len(a))
    for name in ATTRIBUTES:
        d = (getattr(b, name) - getattr(a, name)) / steps[name].cpu().numpy()
        square += np.square(d.astype(np.float64)).reshape(len(a), -1).sum(axis=1)
    return np.sqrt(square)


def _psnr(g: Gaussians, views: Sequence[View]) -> float:
    """Mean over views, dB."""
    return float(np.mean([psnr(mse(cpu.render(g, view.camera).rgb, view.target.rgb)) for view in views]))


def _held_out(g: Gaussians, views: Sequence[View]) -> dict[str, float | None]:
    """Mean PSNR (dB) and SSIM over held-out views."""
    if not views:
        return {"held_out_psnr": None, "held_out_ssim": None}
    similar = [ssim(cpu.render(g, view.camera).rgb, view.target.rgb) for view in views]
    return {"held_out_psnr": round(_psnr(g, views), 3), "held_out_ssim": round(float(np.mean(similar)), 5)}


def _spans(starts: Sequence[int], stop: int) -> list[tuple[int, int]]:
    return list(zip(starts, [*starts[1:], stop], strict=True))


def _fingerprint(scene: Scene) -> dict[str, Any]:
    """What a run must not change under way."""
    cameras = [f"{c.name} {c.split} {c.width}x{c.height}" for c in scene.cameras]
    first = scene.frames[0][0].source.where()
    return {"name": scene.path.resolve().name, "first picture": Path(first).name, "cameras": cameras}


def _transforms(cameras: Sequence[Camera], scene: Scene) -> dict[str, Any]:
    """The cameras as a nerfstudio transforms.json without pictures."""
    frames = []
    for c in cameras:
        matrix = np.linalg.inv(c.world_to_camera) @ OPENGL_TO_OPENCV
        intrinsics = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
        entry = {"camera": c.name, "split": c.split, "file_path": "", **intrinsics}
        frames.append({**entry, "near": c.near, "transform_matrix": matrix.tolist()})
    return {"camera_model": "PINHOLE", "fps": float(scene.fps), "frames": frames}
