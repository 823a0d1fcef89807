"""The steps of a training run, done by this process frame after frame, or by jobs.

The plates of the cameras come first, then the first frame of the run, then chunks of frames, which begin with a
keyframe that starts from the first frame, so that they do not depend on each other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from airgs_codec.errors import AirgsError, ConfigError, SceneError
from airgs_codec.jobs.work import Work
from airgs_codec.places.results import digest
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.files import expecting
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import DrawnSource, MultiviewScene, Shot, with_frames, without_masks
from airgs_codec.trainer.data.pictures import Exposure, Plate, ScenePictures, find_plate, plate_sources
from airgs_codec.trainer.frames import Capture, chunks, position_after, train_chunk, train_first
from airgs_codec.trainer.record import FrameRecord, ModelFolder, Record, Span, TrainedFrame, open_model
from airgs_codec.trainer.settings import OFF, TrainSettings

First = tuple[Gaussians, Exposure]  # the first frame of a run, which all chunks start from
Contents = Mapping[Path | int, str]  # SHA-256 of each file that shows a picture, or frame that is drawn
JOB_VERSION = 2  # of what jobs make of the same pictures and settings: stored results of others are made again


@dataclass(frozen=True, slots=True, eq=False)
class TrainingRun:
    capture: Capture
    model: ModelFolder


def open_run(
    scene: MultiviewScene, folder: Path, settings: TrainSettings, *, resume: bool = False, device: str = "cpu"
) -> TrainingRun:
    """Open a run that goes on where the one in the folder ended. Raises what `airgs_codec.train` does."""
    capture = Capture.of(scene, settings, device)
    names = [camera.name for camera in scene.cameras if not camera.held_out]
    if unseen := [t for t, shots in enumerate(scene.frames) if all(shot.camera.held_out for shot in shots)]:
        raise SceneError(f"{scene.path}: expected training views of frame {unseen[0]}, got none")
    if settings.reference not in (None, *names):
        raise ConfigError(f"reference: expected a training camera of {', '.join(names)}, got {settings.reference}")
    capture.pictures.check()
    model = open_model(folder, Record.of(scene, capture.pictures.background, settings), resume)
    if cameras := scene.given.cameras if scene.given else capture.pictures.cameras():
        model.write_cameras(cameras)
    return TrainingRun(capture, model)


def train_frames(run: TrainingRun, progress: Progress = silent) -> Iterator[FrameRecord]:
    """Train the missing frames in this process, one after another, and yield the record of each when it is on disk.

    The run is complete, with the usage of its Gaussians, when the iterator ends. Raises what `train` does.
    """
    capture, model = run.capture, run.model
    if model.finished():
        return
    if not model.record.complete:
        capture = rested(capture, progress)
    if not model.record.frames:
        yield _commit_first(model, partial(train_first, capture, progress))
    first, done = model.read(0), len(model.record.frames)
    capture = capture.with_first(first, model.record.exposure)
    for start, stop in chunks(model.record.total, capture.settings.group_frames):
        if stop > done:
            at = None if done <= start else position_after(capture, model)
            for trained in train_chunk(capture, range(max(start, done), stop), first, at, progress):
                yield model.commit(trained)
            done = stop
    _finish(run, {}, progress)


def rested(capture: Capture, progress: Progress = silent) -> Capture:
    """Return the capture with the plates of its cameras, found one after another, for the memory of pictures."""
    progress("static parts", 0, 1)
    sources, plates = plate_sources(capture.scene) if capture.settings.finds_plates else [], []
    for done, (camera, frames) in enumerate(sources, 1):
        plates.append(find_plate(capture.pictures, camera, frames))
        progress("static parts", done, len(sources))
    return replace(capture, pictures=capture.pictures.with_plates(plates))


def _commit_first(model: ModelFolder, fit: Callable[[], TrainedFrame]) -> FrameRecord:
    try:
        first = fit()
    except AirgsError:
        model.discard()
        raise
    return model.commit(first)


def _finish(run: TrainingRun, usage: Mapping[Span, Usage], progress: Progress) -> None:
    model, spans = run.model, run.model.record.spans()
    model.finish({span: usage.get(span) or run.capture.usage(model.read, span, progress) for span in spans})


def train_in_jobs(run: TrainingRun, work: Work) -> Iterator[FrameRecord]:
    """Train by jobs what `train_frames` would, and yield the record of each frame when it is on disk.

    The first frame is written when it is done, all others when all are. What the model folder has already is not
    trained again, but for a chunk of which it has a part. Raises what `train` does, WorkError for workers that die.
    """
    model, usage, given = run.model, dict[Span, Usage](), run.capture.settings
    if model.finished():
        return
    work.progress("training", 0, 1)
    scene = run.capture.scene if given.foreground != OFF else without_masks(run.capture.scene)
    settings, device = replace(given, group_frames=None), run.capture.device
    contents = read_contents(scene)

    def done(stage: str, make: Callable[..., Any], asked: Sequence[tuple[Sequence[int], tuple[Any, ...]]]) -> list[Any]:
        """Results of jobs that read the pictures of frame 0 and of some frames, and further values.

        Without a stage, only those that are stored.
        """
        parts = [with_frames(scene, {0, *frames}) for frames, _ in asked]
        calls = [(part, settings, device, *values) for part, (_, values) in zip(parts, asked, strict=True)]
        names = [(content_of(part, contents), call[1:]) for part, call in zip(parts, calls, strict=True)]
        return work.results(stage, make, calls, names, JOB_VERSION) if stage else work.stored(make, names, JOB_VERSION)

    sources = plate_sources(scene) if settings.finds_plates else []
    plates = done("static parts", plate_job, [(frames, (camera, frames)) for camera, frames in sources])
    spans = chunks(model.record.total, given.group_frames)
    if not model.record.frames:
        stop = spans[0][1] if scene.given else 1  # what given Gaussians share depends on their chunk
        yield _commit_first(model, lambda: done("first frame", fit_first, [(range(stop), (stop, *plates))])[0])
    first, finished = (model.read(0), model.record.exposure), len(model.record.frames)
    asked = {span: (range(*span), (span, first, *plates)) for span in spans}
    left = [span for span in spans if span[1] > max(1, finished) or span == (0, 1)]
    for _, known in done("", fit_chunk, [one for span, one in asked.items() if span not in left]):
        usage |= known
    for span, (frames, known) in zip(left, done("training: chunks", fit_chunk, [asked[s] for s in left]), strict=True):
        if span[1] > finished:
            model.cut(max(1, span[0]))
        for trained in frames:
            yield model.commit(trained)
        usage |= known
    _finish(run, usage, work.progress)


def plate_job(scene: MultiviewScene, settings: TrainSettings, device: str, camera: int, frames: Sequence[int]) -> Plate:
    return find_plate(ScenePictures(scene, settings), camera, frames)


def fit_first(scene: MultiviewScene, settings: TrainSettings, device: str, stop: int, *plates: Plate) -> TrainedFrame:
    """Train, as a job, the first frame of a run, whose chunk ends at a frame."""
    return train_first(Capture.of(scene, settings, device, plates), stop=stop)


def fit_chunk(
    scene: MultiviewScene, settings: TrainSettings, device: str, span: Span, first: First, *plates: Plate
) -> tuple[tuple[TrainedFrame, ...], dict[Span, Usage]]:
    """Train, as a job, the frames of a chunk without the first of the run; with the usage of their groups."""
    capture = Capture.of(scene, settings, device, plates).with_first(*first)
    trained = tuple(train_chunk(capture, range(*span), first[0]))
    known = {0: first[0]} | {t.record.frame: t.gaussians for t in trained}
    starts = sorted({span[0], *(t.record.frame for t in trained if t.record.kind == "keyframe")})
    return trained, {group: capture.usage(known.__getitem__, group) for group in pairwise([*starts, span[1]])}


def read_contents(scene: MultiviewScene) -> Contents:
    """Return names of the files of all pictures and masks of a scene, or of the frames that its pictures are drawn of.

    A frame of a video is named by the bytes of the whole video and its number, since decoding all frames takes far
    longer than reading the file: where a video changes, all its frames do. Raises SceneError for a broken file.
    """
    if scene.given:
        return {number: digest(frame) for number, frame in enumerate(scene.given)}
    shots = [shot for shots in scene.frames for shot in shots]
    files = sorted({file for shot in shots for file in (shot.source.path, shot.mask) if file})
    with ThreadPoolExecutor() as pool:
        return dict(zip(files, pool.map(_hash, files), strict=True))


def _hash(path: Path) -> str:
    with expecting(path, "a picture or a video"):
        if not path.is_file():  # a device has no end
            raise ValueError("No such file")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


def content_of(scene: MultiviewScene, contents: Contents) -> list[Any]:
    def shown(shot: Shot) -> list[Any]:
        source, mask = shot.source, shot.mask and contents[shot.mask]
        picture = contents[source.frame if isinstance(source, DrawnSource) else source.path]
        return [shot.camera, shot.lens, picture, source.frame, mask, shot.after]

    frames = [(number, [shown(shot) for shot in shots]) for number, shots in enumerate(scene.frames) if shots]
    return [scene.background, scene.points, frames]
