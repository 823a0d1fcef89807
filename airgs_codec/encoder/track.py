"""Tracking: frames that know nothing of each other become Gaussians that move, fitted to pictures drawn of the frames.

What comes out is a model folder as training leaves it, in the place where the work is kept. Frames are tracked in
chunks, which begin with a keyframe and know nothing of each other but the first frame.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.flow import carry
from airgs_codec.analysis.rows import AUTO, KEEP, outlook
from airgs_codec.encoder.prepare import look_at_frames
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import ViewPlan, plan_views
from airgs_codec.jobs.engines import InProcess
from airgs_codec.jobs.job import digest
from airgs_codec.jobs.work import Work
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.places.place import Folder
from airgs_codec.progress import about
from airgs_codec.render.compare import compare, draw_still
from airgs_codec.scene.camera import Camera, resized
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.trainer.settings import TrainSettings

VIEWS = 32
PIXELS = 65_536  # of a picture
MANY = 1 << 30  # Gaussians: what is given has as many as it has
TRIED = 5  # pairs of neighbours that tell whether a scene can be tracked
FOLLOWED_DB = 20.0  # that half of them show, at least
CHUNK = 30  # frames
ROW_S = (2e-4, 1e-3)  # seconds that a Gaussian of a frame takes on two cores: one that is followed, one that is fitted
ALONE_BYTES = (1.6, 0.4)  # about, of a Gaussian of a frame that is coded alone, and of each SH coefficient above band 0
TRACKED_SHARES = (7, 2)  # one byte in so many is left, from a head with noise to a fox whose frames were trained apart


@dataclass(frozen=True, slots=True)
class Tracked:
    """A sequence whose rows go on from frame to frame, as far as they do."""

    sequence: GaussianSequence
    notes: tuple[str, ...] = ()  # what came of it, for people
    views: ViewPlan | None = None  # that it was fitted in; None: it was not


def decide(sequence: GaussianSequence, settings: EncodeSettings) -> tuple[EncodeSettings, str]:
    """Settings that say whether a sequence is tracked; and what its rows are, what that costs and what would change it.

    The line is empty where rows are in order. Raises SceneError for a broken frame.
    """
    apart = replace(settings, track=False)
    if len(sequence) == 1 or settings.rows == KEEP:
        return apart, ""
    found = outlook(sequence, settings.rows)
    alone, rows = _costs(sequence)
    each = f"about {_rough(alone)} kB a frame"
    time = about(*(rows * row_s for row_s in ROW_S))
    less = "about " + " to ".join(_rough(alone / share) for share in TRACKED_SHARES) + " kB a frame"
    offer = f"--track makes one set of moving Gaussians of them first: {time}, then {less}"
    if found.shared:
        return replace(settings, track=bool(settings.track)), found.words
    if settings.track is False or settings.rows != AUTO:
        return apart, f"{found.words}; coded one by one, {each}; {offer}"
    if settings.track is None and find_spec("torch") is None:
        install = "tracking takes a half to a seventh of that and needs torch: pip install 'airgs-codec[train]'"
        return apart, f"{found.words}; coded one by one, {each}; {install}"
    return replace(settings, track=True), f"{found.words}; tracked first: {time}, then {less} in place of {each}" + (
        "" if settings.track else "; --no-track leaves them as they are"
    )


def _rough(kilobytes: float) -> str:
    return f"{kilobytes:.0f}" if kilobytes >= 10 else f"{kilobytes:.1f}"


def _costs(sequence: GaussianSequence) -> tuple[float, int]:
    """About how many kB a frame takes that is coded alone, and how many Gaussians all frames have."""
    rows = sum(header.count for header in sequence.headers)
    further = 3 * ((sequence.sh_degree + 1) ** 2 - 1)
    return rows / len(sequence) * (ALONE_BYTES[0] + ALONE_BYTES[1] * further) / 1e3, rows


@contextmanager
def tracked(sequence: GaussianSequence, settings: EncodeSettings, work: Work) -> Iterator[Tracked]:
    """Track a sequence where its settings say so; it can be read until the block ends.

    Raises SceneError for a broken frame, ConfigError where a device is missing, TrainingError where a loss is not
    finite.
    """
    if settings.track is None:
        settings, _ = decide(sequence, settings)
    if not settings.track or len(sequence) == 1:
        yield Tracked(sequence)
        return
    names, in_order, _ = look_at_frames(sequence, work)
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
        model = within / f"tracked-{digest(names, cameras)[:16]}"
        yield _track(sequence, names, model, cameras, views, work)


def _track(
    sequence: GaussianSequence, names: Sequence[str], folder: Path, cameras: list[Camera], views: ViewPlan, work: Work
) -> Tracked:
    from airgs_codec.trainer.data.multiview import drawn_scene  # torch is loaded where something is tracked
    from airgs_codec.trainer.pipeline import open_run, train_frames, train_in_jobs

    scene = drawn_scene(sequence, names, cameras, views.renderer)
    run = open_run(scene, folder, track_settings(sequence), resume=True, device=views.renderer.device)
    here = isinstance(work.engine, InProcess)
    for frame in train_frames(run) if here else train_in_jobs(run, work):
        work.progress("tracking", frame.frame + 1, len(sequence))
    record = run.model.record
    found = open_sequence(folder, fps=sequence.fps)
    given = replace(found, cameras=sequence.cameras, cameras_path=sequence.cameras_path, alone=True)
    given = replace(given, origin=sequence.origin, stored_at=sequence.origin)
    starts = record.keyframes()
    shown = [frame.psnr for frame in record.frames]
    worst = int(np.argmin(shown))
    note = (
        f"tracked: {len(starts)} key{'s' * (len(starts) > 1)} for {len(shown)} frames; against what was given "
        f"{np.mean(shown):.1f} dB in {len(cameras)} views, {shown[worst]:.1f} at frame {worst}, the worst"
    )
    return Tracked(replace(given, keyframes=None, breaks=tuple(starts[1:]), notes=sequence.notes), (note,), views)


def track_settings(sequence: GaussianSequence) -> TrainSettings:
    """How a sequence is fitted to pictures of itself."""
    return TrainSettings(
        budget=MANY,
        capacity=MANY,
        sh_degree=sequence.sh_degree,
        key_iterations=300,
        frame_iterations=250,
        group_frames=CHUNK,
        min_psnr_db=28.0,
        max_drop_db=10.0,
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
