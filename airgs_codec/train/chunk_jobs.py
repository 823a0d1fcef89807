"""The jobs that a run is trained by, each named by the content of all that it reads.

What rests before each camera comes first, then the first frame of the run, then chunks of frames, which begin with a
keyframe that starts from the first frame and so know nothing of each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from airgs_codec.errors import ConfigError
from airgs_codec.jobs.digest import code_digest, digest
from airgs_codec.jobs.engines import NOTHING, Needs
from airgs_codec.jobs.job import Job, Stored
from airgs_codec.jobs.work import Work
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.usage import Usage
from airgs_codec.train.data.contents import Contents, content_of, read_contents, with_frames, without_masks
from airgs_codec.train.data.multiview import MultiviewScene
from airgs_codec.train.data.pictures import pictures_for
from airgs_codec.train.data.plates import Plate, find_plate, keep_plate, plate_cameras, plate_frames
from airgs_codec.train.frames import Capture, after_first, chunks, train_chunk, train_first
from airgs_codec.train.loss.target import Exposure
from airgs_codec.train.record import FrameRecord, TrainedFrame
from airgs_codec.train.run import Run, check_pictures, finish
from airgs_codec.train.settings import TrainSettings
from airgs_codec.train.usage import group_usage

LIBRARIES = ("torch", "gsplat", "scipy", "opencv-contrib-python-headless")  # whose versions decide results, too

Span = tuple[int, int]  # frames [start, stop)


@dataclass(frozen=True, slots=True, eq=False)
class First:
    """The first frame of a run, which all chunks start from."""

    gaussians: Gaussians
    exposure: Exposure = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """What a job makes of some frames."""

    frames: tuple[TrainedFrame, ...]  # without the first of the run
    usage: dict[Span, Usage]  # of their groups


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What a job reads of a run."""

    scene: MultiviewScene  # frames that do not matter have no shots
    settings: TrainSettings
    device: str  # cpu or cuda

    def capture(self, plates: Sequence[Plate]) -> Capture:
        """What its frames are fitted with; `plates`: of every training camera, or none at all."""
        names = [self.scene.cameras[index].name for index in plate_cameras(self.scene)]
        kept = [keep_plate(plate, len(plates)) for plate in plates]
        capture = Capture.of(self.scene, pictures_for(self.scene, self.settings), self.settings, self.device)
        return replace(capture, plates=dict(zip(names, kept, strict=True)) if kept else {})


@dataclass(frozen=True, eq=False)
class TrainJobs:
    """The jobs of one run."""

    scene: MultiviewScene
    settings: TrainSettings  # without `group_frames`: a chunk says which frames it has
    device: str
    contents: Contents

    @staticmethod
    def of(scene: MultiviewScene, settings: TrainSettings, device: str, work: Work) -> TrainJobs:
        """Reads the files of all pictures. Raises SceneError for one that cannot be read."""
        read = scene if settings.foreground else without_masks(scene)
        return TrainJobs(read, replace(settings, group_frames=None), device, read_contents(read, work))

    @cached_property
    def plates(self) -> list[Job]:
        """What each training camera sees where nothing moves: a `Plate`; no jobs where that cannot be known."""
        frames = plate_frames(self.scene) if self.settings.knows_rest else []
        cameras = plate_cameras(self.scene) if frames else []
        task = self._task(frames)
        return [
            self._job("what rests", task, self.scene.cameras[camera].name, fit_plate, (camera, frames), {})
            for camera in cameras
        ]

    def first(self) -> Job:
        """The first frame of the run: a `TrainedFrame`."""
        return self._job("first frame", self._task([]), "frame 0", fit_first, self._rest, self._needs)

    def chunk(self, span: Span, first: Stored) -> Job:
        """Frames of the run, whose `First` is known: a `Chunk`."""
        task, label = self._task(range(*span)), f"frames {span[0]}-{span[1] - 1}"
        return self._job("chunks of frames", task, label, fit_chunk, (span, first, *self._rest), self._needs)

    @property
    def _rest(self) -> tuple[Stored, ...]:
        return tuple(job.result for job in self.plates)

    @property
    def _needs(self) -> Needs:
        return {"GPU": 1} if self.device == "cuda" else NOTHING

    def _task(self, frames: Iterable[int]) -> Task:
        return Task(with_frames(self.scene, {0, *frames}), self.settings, self.device)

    def _job(
        self, kind: str, task: Task, label: str, function: Callable[..., Any], more: tuple[Any, ...], needs: Needs
    ) -> Job:
        """`more`: arguments after the task, all of which the result is named by."""
        code = code_digest(*LIBRARIES)
        entry = digest(code, kind, task.settings, task.device, content_of(task.scene, self.contents), more)
        return Job(kind, label, entry, function, (task, *more), code, LIBRARIES, needs)


def train_in_jobs(run: Run, work: Work) -> Iterator[FrameRecord]:
    """Train what `run.train_frames` would, by jobs, and give the record of each frame when it is kept on disk.

    The first frame is kept when it is done, all others when all are. What the model folder has already is not trained
    again, but for a chunk that is there in part. Raises what `run.train` does, WorkError for workers that die.
    """
    model = run.model
    if model.finished():
        return
    jobs = TrainJobs.of(run.scene, run.settings, run.device, work)
    if not model.record.frames:
        yield model.commit(first_frame(jobs, work))
    first = First(model.read(0), model.record.exposure)
    done, usage = len(model.record.frames), dict[Span, Usage]()
    spans = chunks(len(run.scene), run.settings.group_frames)
    left = [span for span in spans if span[1] > max(1, done) or span == (0, 1)]
    made = dict(zip(left, run_chunks(jobs, left, first, work), strict=True))
    stored = work.put(first)
    for span in spans:
        job = made.get(span) or jobs.chunk(span, stored)
        if span not in made and not work.store.has(job.entry):
            continue  # its usage is measured at the end
        chunk = work.result(job)
        if span[1] > done:
            model.keep_first(max(1, span[0]))
            for trained in chunk.frames:
                yield model.commit(trained)
        if all(trained.record == model.record.frames[trained.record.frame] for trained in chunk.frames):
            usage |= chunk.usage
    finish(run, usage, work.progress)


def train_part(scene: MultiviewScene, settings: TrainSettings, device: str, work: Work) -> None:
    """Do the jobs of `train_in_jobs` without a model folder; with the same store, that then only has to write it.

    Several runs with one store share the jobs: `work.part` says which come first here. Each ends when all are done.
    Raises what `train_in_jobs` does, ConfigError on cuda, where no two runs would find the same first frame.
    """
    if device == "cuda":
        raise ConfigError("--part: expected --device cpu, where all parts find the same first frame, got cuda")
    check_pictures(scene, settings)
    jobs = TrainJobs.of(scene, settings, device, work)
    trained = first_frame(jobs, work)
    run_chunks(jobs, chunks(len(scene), settings.group_frames), First(trained.gaussians, trained.exposure), work)


def first_frame(jobs: TrainJobs, work: Work) -> TrainedFrame:
    """The first frame of a run."""
    work.run(jobs.plates)
    trained = work.result(jobs.first())
    assert isinstance(trained, TrainedFrame)
    return trained


def run_chunks(jobs: TrainJobs, spans: Sequence[Span], first: First, work: Work) -> list[Job]:
    """Do the chunks of these frames; gives the job of each, whose result is a `Chunk`."""
    work.run(jobs.plates)
    stored = work.put(first)
    made = [jobs.chunk(span, stored) for span in spans]
    work.run(made)
    return made


def fit_plate(task: Task, camera: int, frames: Sequence[int]) -> Plate:
    """The job of `TrainJobs.plates`."""
    return find_plate(pictures_for(task.scene, task.settings), camera, frames)


def fit_first(task: Task, *plates: Plate) -> TrainedFrame:
    """The job of `TrainJobs.first`."""
    return train_first(task.capture(plates))


def fit_chunk(task: Task, span: Span, first: First, *plates: Plate) -> Chunk:
    """The job of `TrainJobs.chunk`."""
    capture = task.capture(plates).with_exposure(first.exposure)
    at, frames = None, range(*span)
    if span[0] == 0:
        at, frames = after_first(capture, first.gaussians), range(1, span[1])
    trained = tuple(train_chunk(capture, frames, first.gaussians, at))
    known = {0: first.gaussians} | {t.record.frame: t.gaussians for t in trained}
    starts = sorted({span[0], *(t.record.frame for t in trained if t.record.kind == "key")})
    groups = list(zip(starts, [*starts[1:], span[1]], strict=True))
    usage = {group: group_usage(known.__getitem__, capture.pictures, capture.trainer, group) for group in groups}
    return Chunk(trained, usage)
