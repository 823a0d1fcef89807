"""The steps of a training run, done by this process frame after frame, or by jobs.

What rests before each camera comes first, then the first frame of the run, then chunks of frames, which begin with a
keyframe that starts from the first frame and so know nothing of each other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from airgs_codec.errors import AirgsError, ConfigError, SceneError
from airgs_codec.jobs.work import Work
from airgs_codec.places.results import digest
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.files import expecting
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.trainer.data.multiview import Drawn, MultiviewScene, Shot, seen_until, with_frames, without_masks
from airgs_codec.trainer.data.pictures import Exposure, Plate, find_plate, pictures_for, plate_sources
from airgs_codec.trainer.frames import Capture, chunks, position_after, train_chunk, train_first
from airgs_codec.trainer.record import FrameRecord, Model, Record, Span, TrainedFrame, open_model
from airgs_codec.trainer.settings import OFF, TrainSettings

First = tuple[Gaussians, Exposure]  # the first frame of a run, which all chunks start from
Contents = Mapping[Path | int, str]  # SHA-256 of each file that shows a picture, or frame that is drawn
HASHED = 32  # of them that are named by one call
VERSION = 1  # of what jobs make of the same pictures and settings: stored results of others are made again


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    capture: Capture
    model: Model


def open_run(
    scene: MultiviewScene, folder: Path, settings: TrainSettings, *, resume: bool = False, device: str = "cpu"
) -> Run:
    """Open a run that goes on where the one in the folder ended; what is raised is what `airgs_codec.train` raises."""
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
    return Run(capture, model)


def train_frames(run: Run, progress: Progress = silent) -> Iterator[FrameRecord]:
    """Train the frames that are not there yet in this process, one after another.

    Yields the record of each when it is on disk. The run is complete, with the usage of its Gaussians, when the
    iterator ends. Raises what `train` does.
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
    """The capture with the plates of its cameras, found one after another to hold few pictures in memory."""
    sources, plates = plate_sources(capture.scene) if capture.settings.knows_rest else [], []
    for done, (camera, frames) in enumerate(sources, 1):
        plates.append(find_plate(capture.pictures, camera, frames))
        progress("what rests", done, len(sources))
    return replace(capture, pictures=capture.pictures.with_plates(plates))


def _commit_first(model: Model, fit: Callable[[], TrainedFrame]) -> FrameRecord:
    try:
        first = fit()
    except AirgsError:
        model.discard()
        raise
    return model.commit(first)


def _finish(run: Run, usage: Mapping[Span, Usage], progress: Progress) -> None:
    """Complete a run whose frames are all there; `usage`: of the groups of which it is known."""
    model, spans = run.model, run.model.record.spans()
    model.finish({span: usage.get(span) or run.capture.usage(model.read, span, progress) for span in spans})


def train_with(run: Run, work: Work) -> Iterator[FrameRecord]:
    """Train in this process where work is done here, else by jobs; yields and raises what these do."""
    return train_in_jobs(run, work) if work.elsewhere else train_frames(run, work.progress)


def train_in_jobs(run: Run, work: Work) -> Iterator[FrameRecord]:
    """Train by jobs what `train_frames` would, and yield the record of each frame when it is on disk.

    The first frame is written when it is done, all others when all are. What the model folder has already is not
    trained again, but for a chunk that is there in part. Raises what `train` does, WorkError for workers that die.
    """
    model, usage, given = run.model, dict[Span, Usage](), run.capture.settings
    if model.finished():
        return
    scene = run.capture.scene if given.foreground != OFF else without_masks(run.capture.scene)
    settings, device = replace(given, group_frames=None), run.capture.device
    contents = read_contents(scene, work)

    def done(stage: str, make: Callable[..., Any], asked: Sequence[tuple[Sequence[int], tuple[Any, ...]]]) -> list[Any]:
        """What jobs make that read the pictures of frame 0 and of some frames, and further values.

        Without a stage, those of which the results are there.
        """
        parts = [with_frames(scene, {0, *frames}) for frames, _ in asked]
        calls = [(part, settings, device, *values) for part, (_, values) in zip(parts, asked, strict=True)]
        names = [(content_of(part, contents), call[1:]) for part, call in zip(parts, calls, strict=True)]
        return work.results(stage, make, calls, names, VERSION) if stage else work.stored(make, names, VERSION)

    sources = plate_sources(scene) if settings.knows_rest else []
    plates = done("what rests", find_rest, [(frames, (camera, frames)) for camera, frames in sources])
    spans = chunks(model.record.total, given.group_frames)
    if not model.record.frames:
        stop = spans[0][1] if scene.given else 1  # given Gaussians are told by their chunk, cameras that are early by 1
        asked = [(range(seen_until(scene, stop)), (stop, *plates))]
        yield _commit_first(model, lambda: done("first frame", fit_first, asked)[0])
    first, there = (model.read(0), model.record.exposure), len(model.record.frames)
    left = [span for span in spans if span[1] > max(1, there) or span == (0, 1)]
    asked = [(range(span[0], seen_until(scene, span[1])), (span, first, *plates)) for span in spans]
    for _, known in done("", fit_chunk, [one for span, one in zip(spans, asked, strict=True) if span not in left]):
        usage |= known
    asked = [one for span, one in zip(spans, asked, strict=True) if span in left]
    for span, (frames, known) in zip(left, done("chunks of frames", fit_chunk, asked), strict=True):
        if span[1] > there:
            model.cut(max(1, span[0]))
        for trained in frames:
            yield model.commit(trained)
        usage |= known
    _finish(run, usage, work.progress)


def find_rest(scene: MultiviewScene, settings: TrainSettings, device: str, camera: int, frames: Sequence[int]) -> Plate:
    """A job: what one camera sees at rest."""
    return find_plate(pictures_for(scene, settings), camera, frames)


def fit_first(scene: MultiviewScene, settings: TrainSettings, device: str, stop: int, *plates: Plate) -> TrainedFrame:
    """A job: the first frame of a run, whose chunk ends at a frame."""
    return train_first(Capture.of(scene, settings, device, plates), stop=stop)


def fit_chunk(
    scene: MultiviewScene, settings: TrainSettings, device: str, span: Span, first: First, *plates: Plate
) -> tuple[tuple[TrainedFrame, ...], dict[Span, Usage]]:
    """A job: the frames of a chunk without the first of the run, and the usage of their groups."""
    capture = Capture.of(scene, settings, device, plates).with_first(*first)
    trained = tuple(train_chunk(capture, range(*span), first[0]))
    known = {0: first[0]} | {t.record.frame: t.gaussians for t in trained}
    starts = sorted({span[0], *(t.record.frame for t in trained if t.record.kind == "keyframe")})
    groups = list(zip(starts, [*starts[1:], span[1]], strict=True))
    return trained, {group: capture.usage(known.__getitem__, group) for group in groups}


def read_contents(scene: MultiviewScene, work: Work) -> Contents:
    """Names of the files of all pictures and masks of a scene, or of the frames that its pictures are drawn from.

    A frame of a video is named by the bytes of the whole video and its number, since decoding all frames takes far
    longer than reading the file: where a video changes, all its frames do. Raises SceneError for what cannot be read.
    """
    shots, given = [shot for shots in scene.frames for shot in shots], scene.given
    named: list[Path | int] = [*range(len(given or ()))]
    named = named or sorted({file for shot in shots for file in (shot.source.path, shot.mask) if file})
    parts = [named[at : at + HASHED] for at in range(0, len(named), HASHED)]
    digests = work.results("pictures", hash_all, [(part, given) for part in parts])
    return dict(zip(named, (digest for part in digests for digest in part), strict=True))


def hash_all(named: Sequence[Path | int], given: GaussianSequence | None) -> list[str]:
    """SHA-256 of files, or of frames of a sequence, hexadecimal. Raises SceneError."""
    if given:
        return [digest(given.read(number)) for number in named if isinstance(number, int)]
    digests = []
    for path in (path for path in named if isinstance(path, Path)):
        with expecting(path, "a picture or a video"):
            if not path.is_file():  # a device has no end
                raise ValueError("No such file")
            with path.open("rb") as file:
                digests.append(hashlib.file_digest(file, "sha256").hexdigest())
    return digests


def content_of(scene: MultiviewScene, contents: Contents) -> list[Any]:
    def shown(shot: Shot) -> list[Any]:
        source, mask = shot.source, shot.mask and contents[shot.mask]
        picture = contents[source.frame if isinstance(source, Drawn) else source.path]
        return [shot.camera, shot.lens, picture, source.frame, mask, shot.after]

    frames = [(number, [shown(shot) for shot in shots]) for number, shots in enumerate(scene.frames) if shots]
    return [scene.background, scene.points, frames]


def name_of(scene: MultiviewScene, work: Work) -> str:
    return digest(content_of(scene, read_contents(scene, work)))
