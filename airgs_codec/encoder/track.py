"""Tracking: frames that know nothing of each other become Gaussians that move, fitted to pictures drawn of the frames.

What comes out is a model folder as training leaves it, in the place where the work is kept.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.flow import carry
from airgs_codec.encoder.prepare import look_at_frames
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import ViewPlan, plan_views
from airgs_codec.errors import ConfigError
from airgs_codec.jobs.job import digest
from airgs_codec.jobs.work import Work
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.places.place import Folder
from airgs_codec.render.compare import compare, draw_still
from airgs_codec.scene.camera import Camera, resized
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.train.settings import Temporal, TrainSettings

VIEWS = 16
PIXELS = 65_536  # of a picture
MANY = 1 << 30  # Gaussians: what is given has as many as it has
TRIED = 5  # pairs of neighbours that tell whether a scene can be tracked
FOLLOWED_DB = 20.0  # that half of them show, at least


@dataclass(frozen=True, slots=True)
class Tracked:
    """A sequence whose rows go on from frame to frame, as far as they do."""

    sequence: GaussianSequence
    notes: tuple[str, ...] = ()  # what came of it, for people
    views: ViewPlan | None = None  # that it was fitted in; None: it was not


def expect_trackable(settings: EncodeSettings, work: Work) -> None:
    """Raise ConfigError where a sequence that is tracked could not be encoded in the way that is asked for."""
    if settings.track and work.part.count > 1:
        raise ConfigError("--part: expected a sequence that is not tracked first, got --track: one run tracks it")
    if settings.track and settings.rows != "auto":
        raise ConfigError(f"--rows {settings.rows}: expected none with --track, which leaves rows in order")


@contextmanager
def tracked(sequence: GaussianSequence, settings: EncodeSettings, work: Work) -> Iterator[Tracked]:
    """Track a sequence; it can be read until the block ends.

    Raises SceneError for a broken frame, ConfigError where a device is missing, TrainingError where a loss is not
    finite.
    """
    names, in_order = look_at_frames(sequence, work)
    if in_order and len({header.count for header in sequence.headers}) == 1:
        yield Tracked(sequence, ("not tracked: its rows are in order already",))
        return
    views = plan_views(sequence, settings)
    cameras = [_small(camera, number) for number, camera in enumerate(views.deciding[:VIEWS])]
    shown = float(np.median([_followed(sequence, n, cameras, views) for n in _tried(sequence)]))
    if shown < FOLLOWED_DB:
        note = f"not tracked: {shown:.1f} dB is all that a frame shows of the next one; each is coded by itself"
        yield Tracked(sequence, (note,))
        return
    with tempfile.TemporaryDirectory(prefix="airgs-track-") as temporary:
        place = work.store.place
        within = place.path if isinstance(place, Folder) else Path(temporary)
        yield _track(sequence, within / f"tracked-{digest(names, cameras)[:16]}", cameras, views, work)


def _track(sequence: GaussianSequence, folder: Path, cameras: list[Camera], views: ViewPlan, work: Work) -> Tracked:
    from airgs_codec.train.data.drawn import drawn_scene  # torch is loaded where something is tracked
    from airgs_codec.train.pipeline import open_run, train_frames

    scene = drawn_scene(sequence, cameras, views.renderer)
    run = open_run(scene, folder, track_settings(sequence), resume=True, device=views.renderer.device)
    for frame in train_frames(run):
        work.progress("tracking", frame.frame + 1, len(sequence))
    record = run.model.record
    found = open_sequence(folder, fps=sequence.fps)
    given = replace(found, cameras=sequence.cameras, cameras_path=sequence.cameras_path, alone=True)
    starts = record.keyframes()
    shown = [frame.psnr for frame in record.frames]
    worst = int(np.argmin(shown))
    note = (
        f"tracked: {len(starts)} key{'s' * (len(starts) > 1)} for {len(shown)} frames; against what was given "
        f"{np.mean(shown):.1f} dB in {len(cameras)} views, {shown[worst]:.1f} at frame {worst}, the worst"
    )
    return Tracked(replace(given, keyframes=None, breaks=tuple(starts[1:])), (note,), views)


def track_settings(sequence: GaussianSequence) -> TrainSettings:
    """How a sequence is fitted to pictures of itself."""
    return TrainSettings(
        budget=MANY,
        capacity=MANY,
        sh_degree=sequence.sh_degree,
        key_iterations=300,
        frame_iterations=100,
        min_psnr_db=28.0,
        max_drop_db=6.0,
        temporal=Temporal(weight=5e-3),  # what differs from frame to frame is noise more often than motion
    )


def _small(camera: Camera, number: int) -> Camera:
    share = (PIXELS / (camera.width * camera.height)) ** 0.5
    return replace(resized(camera, share), name=f"view{number:02d}", split="train")


def _tried(sequence: GaussianSequence) -> list[int]:
    return evenly_spaced(len(sequence) - 1, TRIED)


def _followed(sequence: GaussianSequence, number: int, cameras: list[Camera], views: ViewPlan) -> float:
    """dB of a frame that went where the next one is, against that."""
    a, b = (sequence.load([n]).frames[0] for n in (number, number + 1))
    there, shown = (draw_still(g, views.renderer) for g in (b, carry(a, b)))
    errors = compare(there, shown, [(number, camera) for camera in cameras[::4]], Picture.mse)
    return psnr(float(np.mean(list(errors))))
