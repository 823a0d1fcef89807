"""Tracking: frames that share no rows become Gaussians that move, fitted to pictures drawn of the frames.

It is a training run whose pictures are drawn. Frames are tracked in chunks, which begin with a keyframe and share only
the first frame.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.flow import carry
from airgs_codec.analysis.grouping import count_runs
from airgs_codec.analysis.region import SEEN, region_around, see, seeing
from airgs_codec.analysis.rows import AUTO, IN_ORDER, KEEP, compare_order, first_look
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.jobs.work import Work
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.package.region import DECIDING, draw_views, with_background
from airgs_codec.places.results import digest
from airgs_codec.progress import Progress, silent
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import compare, draw_still
from airgs_codec.scene.camera import Camera, resized, training_views
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.trainer.data.multiview import MultiviewScene, drawn_scene
from airgs_codec.trainer.settings import TrainSettings

DRAWN_VIEWS, DRAWN_PIXELS = 32, 65_536
CHUNK_FRAMES = 30
SAVES = "takes a thirteenth to a half of the bytes"  # docs/results/size.md


def decide(sequence: GaussianSequence, wanted: bool | None = None, rows: str = AUTO) -> tuple[bool, str]:
    """Return whether a sequence is tracked, and a sentence on its rows and the alternative.

    `wanted`: None to look at the first frames. `rows`: as in `analysis.rows`. The sentence is empty where rows are in
    order. Raises SceneError for a broken frame.
    """
    if len(sequence) == 1 or rows == KEEP:
        return False, ""
    shared, words = first_look(sequence, rows)
    if shared:
        return bool(wanted), words
    if wanted is False or rows != AUTO:
        return False, f"{words}; coded one by one; --track makes one set of moving Gaussians of them first: it {SAVES}"
    if wanted is None and find_spec("torch") is None:
        return False, f"{words}; coded one by one; tracking {SAVES}, needs torch: pip install 'airgs-codec[train]'"
    return True, f"{words}; tracked first, which {SAVES}{'' if wanted else '; --no-track leaves them as they are'}"


def track_settings(sequence: GaussianSequence) -> TrainSettings:
    return TrainSettings(
        budget=1 << 30, capacity=1 << 30, sh_degree=sequence.sh_degree, keyframe_iterations=300, frame_iterations=250,
        group_frames=CHUNK_FRAMES, min_psnr_db=28.0, max_drop_db=10.0,
    )  # fmt: skip


def pictured(sequence: GaussianSequence, renderer: Renderer, progress: Progress = silent) -> MultiviewScene:
    """Return the scene that views about its cameras show of a sequence, for a run that fits Gaussians that move.

    Raises SceneError for a broken frame and where nothing can be tracked, ConfigError where no view shows anything.
    """
    progress("views to track", 0, 1)
    cameras = _views_of(sequence, renderer)
    if reason := why_not(sequence, cameras, renderer):
        raise SceneError(f"{sequence.folder}: not tracked: {reason}")
    return drawn_scene(sequence, cameras, renderer)


def why_not(sequence: GaussianSequence, cameras: Sequence[Camera], renderer: Renderer) -> str:
    """Return why a sequence cannot be tracked, empty where it can. Raises SceneError for a broken frame.

    It cannot where the rows of half of five pairs of frames, moved, show less than 20 dB of the next frame.
    """
    starts = {start for start, _ in count_runs(sequence)}
    frames = pairwise(sequence.read(number) for number in range(len(sequence)))
    if len({header.count for header in sequence.headers}) == 1 and all(
        number in starts or compare_order(a, b) == IN_ORDER for number, (a, b) in enumerate(frames, 1)
    ):
        return "its rows are in order already"
    tried = evenly_spaced(len(sequence) - 1, 5)
    shown = float(np.median([_followed(sequence, number, cameras[::4], renderer) for number in tried]))
    if shown < 20:
        return f"{shown:.1f} dB is all that a frame shows of the next one; each is coded by itself"
    return ""


def _views_of(sequence: GaussianSequence, renderer: Renderer) -> list[Camera]:
    middle = sequence.load([len(sequence) // 2]).frames[0]
    sight = see(sequence.cameras, middle, renderer)
    if sight.cameras and sight.share >= SEEN:
        cameras = training_views(sight.cameras)
    else:
        cameras = find_viewpoints([sequence.read(i) for i in evenly_spaced(len(sequence), 5)]).cameras
    region = with_background(region_around(cameras, middle), sequence.background)
    found = seeing(draw_views(region, DRAWN_VIEWS, DECIDING), middle, renderer)
    if not found:
        raise ConfigError(f"{sequence.folder}: expected views that show the middle frame, got {DRAWN_VIEWS} of nothing")
    small = (resized(camera, (DRAWN_PIXELS / (camera.width * camera.height)) ** 0.5) for camera in found)
    return [replace(camera, name=f"view{number:02d}", split="train") for number, camera in enumerate(small)]


def _followed(sequence: GaussianSequence, number: int, cameras: Sequence[Camera], renderer: Renderer) -> float:
    a, b = (sequence.load([n]).frames[0] for n in (number, number + 1))
    given, moved = (draw_still(g, renderer) for g in (b, carry(a, b)))
    errors = compare(given, moved, [(number, camera) for camera in cameras], Picture.mse)
    return psnr(float(np.mean(list(errors))))


@contextmanager
def tracked(
    sequence: GaussianSequence, renderer: Renderer, work: Work, folder: Path | None = None
) -> Iterator[GaussianSequence]:
    """Track a sequence, and return it with a note on the result until the block ends, as it was if that is impossible.

    The model stays in `folder`, by default a temporary one. Raises SceneError for a broken frame, ConfigError where a
    device is missing, TrainingError where a loss is not finite.
    """
    # torch is loaded only where something is tracked
    from airgs_codec.trainer.pipeline import content_of, open_run, read_contents, train_frames, train_in_jobs

    work.progress("views to track", 0, 1)
    cameras = _views_of(sequence, renderer)
    if reason := why_not(sequence, cameras, renderer):
        yield replace(sequence, notes=(*sequence.notes, f"not tracked: {reason}"))
        return
    scene = drawn_scene(sequence, cameras, renderer)
    with tempfile.TemporaryDirectory(prefix="airgs-track-") as temporary:
        name = digest(content_of(scene, read_contents(scene)))
        model = (folder or Path(temporary)) / f"tracked-{name[:16]}"
        run = open_run(scene, model, track_settings(sequence), resume=True, device=renderer.device)
        for _ in train_in_jobs(run, work) if work.elsewhere else train_frames(run, work.progress):
            pass
        found = open_sequence(model, fps=sequence.fps).at_origin(sequence.origin)
        given = replace(found, cameras=sequence.cameras, cameras_path=sequence.cameras_path, alone=True)
        breaks, notes = tuple(run.model.record.keyframes()[1:]), (*sequence.notes, run.model.record.quality())
        sound, credit = sequence.sound_track, sequence.attribution
        yield replace(given, keyframes=None, breaks=breaks, notes=notes, sound_track=sound, credit=credit)
