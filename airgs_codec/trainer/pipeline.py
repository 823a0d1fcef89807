"""The steps of a training run, and who does them: this process frame after frame, or jobs.

What rests before each camera comes first, then the first frame of the run, then chunks of frames, which begin with a
keyframe that starts from the first frame and so know nothing of each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from airgs_codec.errors import AirgsError, ConfigError, SceneError
from airgs_codec.jobs.engines import NOTHING, Needs
from airgs_codec.jobs.job import Job, Stored
from airgs_codec.jobs.work import Work
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.beside import Usage
from airgs_codec.trainer.capture import Capture, First
from airgs_codec.trainer.data.multiview import (
    Contents,
    MultiviewScene,
    content_of,
    read_contents,
    seen_until,
    with_frames,
    without_masks,
)
from airgs_codec.trainer.data.plates import Plate, find_plate, plate_sources
from airgs_codec.trainer.frames import chunks, position_after, train_chunk, train_first
from airgs_codec.trainer.record import FrameRecord, Model, Record, Span, TrainedFrame, open_model
from airgs_codec.trainer.settings import OFF, TrainSettings


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A capture, and the model folder that it is trained into."""

    capture: Capture
    model: Model


def open_run(
    scene: MultiviewScene,
    folder: Path,
    settings: TrainSettings,
    *,
    resume: bool = False,
    device: str = "cpu",
) -> Run:
    """Open a run that goes on where the one in the folder ended; what is raised is what `airgs_codec.train` raises."""
    capture = Capture.of(scene, settings, device)
    check_pictures(capture)
    model = open_model(folder, Record.of(scene, capture.pictures.background, settings), resume)
    model.write_cameras(capture.pictures.cameras())
    return Run(capture, model)


def check_pictures(capture: Capture) -> None:
    """Check that a scene can be trained, as far as its cameras and the headers of all its pictures tell.

    Raises SceneError for pictures that cannot be used, ConfigError for settings that do not fit the scene.
    """
    scene, reference = capture.scene, capture.settings.reference
    names = [camera.name for camera in scene.cameras if not camera.held_out]
    if unseen := [t for t, shots in enumerate(scene.frames) if all(shot.camera.held_out for shot in shots)]:
        raise SceneError(f"{scene.path}: expected training views of frame {unseen[0]}, got none")
    if reference not in (None, *names):
        raise ConfigError(f"reference: expected a training camera of {', '.join(names)}, got {reference}")
    capture.pictures.check()


def train_frames(run: Run, progress: Progress = silent) -> Iterator[FrameRecord]:
    """Train the frames that are not there yet in this process, one after another.

    Yields the record of each when it is on disk. The run is complete, with the usage of its Gaussians, when the
    iterator ends. Raises what `train` does.
    """
    return _train(run, Here(run.capture, progress), progress)


def train_in_jobs(run: Run, work: Work) -> Iterator[FrameRecord]:
    """Train by jobs what `train_frames` would, and yield the record of each frame when it is on disk.

    The first frame is written when it is done, all others when all are. What the model folder has already is not
    trained again, but for a chunk that is there in part. Raises what `train` does, WorkError for workers that die.
    """
    return _train(run, Farm.of(run.capture, work), work.progress)


def _train(run: Run, driver: Here | Farm, progress: Progress) -> Iterator[FrameRecord]:
    model = run.model
    if model.finished():
        return
    if not model.record.frames:
        try:
            first = driver.first()
        except AirgsError:
            model.discard()
            raise
        yield model.commit(first)
    for trained in driver.others(First(model.read(0), model.record.exposure), model):
        yield model.commit(trained)
    usage = dict(driver.usage)
    for span in model.record.spans():
        if span not in usage:
            usage[span] = run.capture.usage(model.read, span, progress)
    model.finish({span: usage[span] for span in model.record.spans()})


@dataclass(frozen=True, eq=False)
class Here:
    """This process: frame after frame, each from where the model folder has come to."""

    capture: Capture
    progress: Progress
    usage: Mapping[Span, Usage] = field(default_factory=dict)  # measured at the end alone

    @cached_property
    def _settled(self) -> Capture:
        return rested(self.capture, self.progress)

    def first(self) -> TrainedFrame:
        seen = first_frames(self.capture.scene, self.capture.settings)
        return train_first(self._settled.within(seen), self.progress)

    def others(self, first: First, model: Model) -> Iterator[TrainedFrame]:
        """Fit the frames behind the last one of the model; each is in it when the next one is asked for."""
        done = len(model.record.frames)
        for start, stop in chunks(model.record.total, self.capture.settings.group_frames):
            if stop > done:
                capture = self._settled.with_first(first).within(range(start, stop))
                at = None if done <= start else position_after(capture, model)
                yield from train_chunk(capture, range(max(start, done), stop), first.gaussians, at, self.progress)


def first_frames(scene: MultiviewScene, settings: TrainSettings) -> range:
    """Frame 0, and what else tells it: its chunk where Gaussians are given, frame 1 where cameras are not in step."""
    return range(chunks(len(scene), settings.group_frames)[0][1] if scene.given else seen_until(scene, 1))


def rested(capture: Capture, progress: Progress = silent) -> Capture:
    """The capture with the plates of its cameras.

    Camera after camera, so that no more pictures are in memory than one plate is made of.
    """
    sources, plates = plate_sources(capture.scene) if capture.settings.knows_rest else [], []
    for done, (camera, frames) in enumerate(sources, 1):
        plates.append(find_plate(capture.pictures, camera, frames))
        progress("what rests", done, len(sources))
    return capture.with_plates(plates)


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """The part of a run that a job reads."""

    scene: MultiviewScene  # frames that do not matter have no shots
    settings: TrainSettings
    device: str  # cpu or cuda

    def capture(self) -> Capture:
        return Capture.of(self.scene, self.settings, self.device)


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """The frames of a chunk without the first of the run, and the usage of their groups."""

    frames: tuple[TrainedFrame, ...]
    usage: dict[Span, Usage]


def find_rest(task: Task, camera: int, frames: Sequence[int]) -> Plate:
    """A job: what one camera sees at rest. Raises SceneError for a picture that cannot be read."""
    return find_plate(task.capture().pictures, camera, frames)


def fit_first(task: Task, *plates: Plate) -> TrainedFrame:
    """A job: the first frame of a run. Raises what `train` does."""
    return train_first(task.capture().with_plates(plates))


def fit_chunk(task: Task, span: Span, first: First, *plates: Plate) -> Chunk:
    """A job: the frames of a chunk, and the usage of their groups. Raises what `train` does."""
    capture = task.capture().with_plates(plates).with_first(first)
    trained = tuple(train_chunk(capture, range(*span), first.gaussians))
    known = {0: first.gaussians} | {t.record.frame: t.gaussians for t in trained}
    starts = sorted({span[0], *(t.record.frame for t in trained if t.record.kind == "key")})
    groups = list(zip(starts, [*starts[1:], span[1]], strict=True))
    return Chunk(trained, {group: capture.usage(known.__getitem__, group) for group in groups})


@dataclass(frozen=True, eq=False)
class Farm:
    """Jobs, each named by the content of all that it reads."""

    scene: MultiviewScene
    settings: TrainSettings
    device: str
    work: Work
    usage: dict[Span, Usage] = field(default_factory=dict)  # of chunks whose frames the model has

    @staticmethod
    def of(capture: Capture, work: Work) -> Farm:
        """The farm that trains what a capture would."""
        scene = capture.scene if capture.settings.foreground != OFF else without_masks(capture.scene)
        return Farm(scene, capture.settings, capture.device, work)

    @property
    def needs(self) -> Needs:
        return {"GPU": 1} if self.device == "cuda" else NOTHING

    @cached_property
    def contents(self) -> Contents:
        """The names of what all pictures show. Raises SceneError for a file that cannot be read."""
        return read_contents(self.scene, self.work)

    @cached_property
    def plates(self) -> tuple[Stored, ...]:
        jobs = self.rest_jobs()
        self.work.run(jobs)
        return tuple(job.result for job in jobs)

    def first(self) -> TrainedFrame:
        trained = self.work.result(self.first_job(*self.plates))
        assert isinstance(trained, TrainedFrame)
        return trained

    def others(self, first: First, model: Model) -> Iterator[TrainedFrame]:
        """Fit the chunks that the model does not have whole, all before the first of their frames is given."""
        reads = (self.work.put(first), *self.plates)
        jobs = {span: self.chunk_job(span, *reads) for span in chunks(len(self.scene), self.settings.group_frames)}
        done = len(model.record.frames)
        left = {span for span in jobs if span[1] > max(1, done) or span == (0, 1)}
        self.work.run([job for span, job in jobs.items() if span in left])
        for (start, stop), job in jobs.items():
            if (start, stop) not in left and not self.work.store.has(job.entry):
                continue  # its usage is measured at the end
            chunk: Chunk = self.work.result(job)
            if stop > done:
                model.cut(max(1, start))
                yield from chunk.frames
            if all(trained.record == model.record.frames[trained.record.frame] for trained in chunk.frames):
                self.usage.update(chunk.usage)

    def rest_jobs(self) -> list[Job]:
        """The plate of each training camera; none where nothing is known to rest."""
        sources = plate_sources(self.scene) if self.settings.knows_rest else []
        return [
            self._job("what rests", self.scene.cameras[camera].name, frames, find_rest, camera, frames, needs=NOTHING)
            for camera, frames in sources
        ]

    def first_job(self, *plates: Stored) -> Job:
        return self._job("first frame", "frame 0", first_frames(self.scene, self.settings), fit_first, *plates)

    def chunk_job(self, span: Span, *reads: Stored) -> Job:
        """A chunk; `reads`: the `First`, and plates."""
        frames = range(span[0], seen_until(self.scene, span[1]))
        return self._job("chunks of frames", f"frames {span[0]}-{span[1] - 1}", frames, fit_chunk, span, *reads)

    def _job(
        self,
        kind: str,
        label: str,
        frames: Sequence[int],
        make: Callable[..., Any],
        *arguments: Any,
        needs: Needs | None = None,
    ) -> Job:
        """A job that reads the pictures of frame 0 and of these frames."""
        settings = replace(self.settings, group_frames=None)  # a chunk says which frames it has
        task = Task(with_frames(self.scene, {0, *frames}), settings, self.device)
        content = (settings, self.device, content_of(task.scene, self.contents), arguments)
        return Job.of(kind, label, make, (task, *arguments), content, self.needs if needs is None else needs)
