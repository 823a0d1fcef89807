"""A training run: frames are trained one after another into a model folder, which may go on where it was cut off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.scene.camera import OPENGL_TO_OPENCV
from airgs_codec.scene.usage import Usage
from airgs_codec.train.data.multiview import MultiviewScene
from airgs_codec.train.data.pictures import Pictures, pictures_for
from airgs_codec.train.data.plates import find_plates
from airgs_codec.train.frames import Capture, Position, chunks, train_chunk, train_first
from airgs_codec.train.record import FrameRecord, Model, Record, open_model
from airgs_codec.train.settings import TrainSettings
from airgs_codec.train.stages import FrameBefore
from airgs_codec.train.usage import group_usage


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A scene, and the model folder that it is trained into."""

    scene: MultiviewScene
    pictures: Pictures  # exposed as they are
    settings: TrainSettings
    device: str  # cpu or cuda
    model: Model

    def capture(self) -> Capture:
        """What the frames are fitted with, before anything is known of plates and exposure.

        Raises ConfigError where the device is not there.
        """
        return Capture.of(self.scene, self.pictures, self.settings, self.device)


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
    pictures = check_pictures(scene, settings)
    wanted = Record(_identity(scene, pictures), settings.table(), len(scene), str(scene.fps))
    model = open_model(folder, wanted, resume)
    model.write_cameras(_as_transforms(pictures.cameras(), scene))
    return Run(scene, pictures, settings, device, model)


def check_pictures(scene: MultiviewScene, settings: TrainSettings) -> Pictures:
    """The pictures of a scene that can be trained, as far as the first frame tells.

    Raises SceneError for pictures that cannot be used, ConfigError for settings that do not fit the scene.
    """
    names = [camera.name for camera in scene.cameras if not camera.held_out]
    if not names:
        raise SceneError(f"{scene.path}: expected training views of the first frame, got none")
    if settings.reference not in (None, *names):
        raise ConfigError(f"--reference: expected a training camera of {', '.join(names)}, got {settings.reference}")
    pictures = pictures_for(scene, settings)
    pictures.check(0)
    return pictures


def train_frames(run: Run, progress: Progress = silent) -> Iterator[FrameRecord]:
    """Train the frames that are not there yet and give the record of each, when it is kept on disk.

    The run is complete, with the usage of its Gaussians, when the iterator ends. Raises what `train` does.
    """
    model = run.model
    if model.finished():
        return
    capture = run.capture()
    if run.settings.knows_rest:
        capture = replace(capture, plates=find_plates(run.scene, run.pictures, progress))
    if not model.record.frames:
        yield model.commit(train_first(capture, progress))
    capture = capture.with_exposure(model.record.exposure)
    done = len(model.record.frames)
    for start, stop in chunks(len(run.scene), run.settings.group_frames):
        if stop > done:
            frames = range(max(start, done), stop)
            at = None if frames.start == start else position_after(capture, model)
            for trained in train_chunk(capture, frames, model.read(0), at, progress):
                yield model.commit(trained)
    finish(run, {}, progress)


def finish(run: Run, known: Mapping[tuple[int, int], Usage], progress: Progress = silent) -> None:
    """Write the usage of the groups of a run whose frames are all there; `known`: of those that were measured."""
    usage, model = dict(known), run.model
    missing = [span for span in model.record.spans() if span not in usage]
    if missing:
        trainer = run.capture().trainer
        usage |= {span: group_usage(model.read, run.pictures, trainer, span, progress) for span in missing}
    model.finish({span: usage[span] for span in model.record.spans()})


def position_after(capture: Capture, model: Model) -> Position:
    """What the frame behind the last finished one is fitted from."""
    last = model.record.frames[-1].frame
    start = model.record.group_start(last + 1)
    group = capture.trainer.start_group(model.read(start), capture.views(start))
    if group.networks is not None and last > start:
        group.networks.load(model.networks())
    return Position(frame_before(model, last + 1), group)


def frame_before(model: Model, frame: int) -> FrameBefore:
    """What a frame, at least 1, starts from; its velocity is known from the third frame of a group on."""
    before = model.read(frame - 1)
    if frame - 1 == model.record.group_start(frame):
        return FrameBefore(before, None)
    return FrameBefore(before, before.means - model.read(frame - 2).means)


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
