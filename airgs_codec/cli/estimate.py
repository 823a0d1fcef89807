"""How long work will take, stage by stage, and how many bytes it writes: guessed before it begins.

Seconds are those of a core that sorts as `pace` does in SORT_S. N Gaussians a frame, F frames.
"""

from __future__ import annotations

import time
import zlib
from dataclasses import fields

import numpy as np

from airgs_codec._settings import available_cores
from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.views import DECISION_PIXELS
from airgs_codec.scene.gaussians import SH_REST
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.settings import TrainSettings
from airgs_codec.trainer.track import CHUNK_FRAMES, DRAWN_PIXELS, DRAWN_VIEWS, track_settings

SORT_S, SORTS = 6.2e-3, 30  # how long one takes, and their number
CORES = -0.5  # time falls with this power of their number
KEYFRAME = 25  # frames that take as long as it to encode
TRACKED_BYTES = 2.0  # a Gaussian and frame, where frames cannot tell before they are tracked
LOOKED_AHEAD = 11  # frames that show what the first one that is tracked has by chance
Expected = tuple[dict[str, float], float]  # seconds of each stage, in their order, and bytes


def pace() -> float:
    """Return how many times as long work takes on this machine, as busy as it is."""
    numbers, begun_s = np.random.default_rng(0).random((SORTS, 100_000)), time.perf_counter()
    np.sort(numbers, kind="stable")  # a merge sort, which no vector unit speeds up
    return (time.perf_counter() - begun_s) / SORTS / SORT_S * available_cores() ** CORES


def picture_s(n: float, pixels: float) -> float:
    return 6e-7 * n + 5e-8 * pixels + 1e-3


def of_encode(sequence: GaussianSequence, s: EncodeSettings, *, goal: bool, lost: bool, track: bool) -> Expected:
    """Return what `encoder.publish.encode` takes, of rows that are `lost`, or tracked. Raises SceneError."""
    f, sh, spans = len(sequence), 3 * SH_REST[sequence.sh_degree], plan_groups(sequence, s.group_frames).spans
    n, groups = sum(header.count for header in sequence.headers) / f, len(spans)
    own = sum(a == 0 or a in sequence.breaks or sequence.count(a) != sequence.count(a - 1) for a, _ in spans)
    groups, own = (-(-f // CHUNK_FRAMES),) * 2 if track else (groups, own)
    levels, finds = (1 if f == 1 else len(s.levels)), s.calibrate != "none"
    pixels = sequence.cameras[0].width * sequence.cameras[0].height if sequence.cameras else DRAWN_PIXELS
    seen_s, surveyed = picture_s(n, min(pixels, DECISION_PIXELS)), 2 * (s.decide_pictures + s.check_pictures)
    coded_s = 2e-8 * n * (13 + sh) * (f + KEYFRAME * groups) * (0.5 + levels) + 0.5 * groups
    coded_s += surveyed * seen_s * (own - finds)
    measured_s = 0.3 + 0.6 * s.measure_pictures * picture_s(n, pixels) * (1 + levels)
    seconds = {
        "frames": 2e-7 * n * f, "order of rows": 4e-5 * n * f * (lost and not track), "views": 0.3 + 40 * seen_s,
        "steps and pruning levels": finds * (3 + (70 + surveyed) * seen_s), "search": 4 * (coded_s + measured_s) * goal,
        "encoding": coded_s, "measuring": measured_s,
    }  # fmt: skip
    moved = TRACKED_BYTES if track else moved_bytes(sequence, *max(spans, key=lambda span: span[1] - span[0]))
    keyframes = n * (9 + 0.6 * sh) * (own + groups) / 2 * len(s.keyframe_factors) / 2
    size = 30e3 + (keyframes + 0.15 * moved * n * f * (1 + levels)) * s.quality**-0.7 * (1.0 if finds else 1.3)
    slower = pace()
    before = of_training(sequence, f, track_settings(sequence), s.device)[0] if track else {}
    return before | {stage: slower * value for stage, value in seconds.items()}, size


def moved_bytes(sequence: GaussianSequence, start: int, stop: int) -> float:
    """Return what zlib makes of how a Gaussian changes in a frame, in 30ths of the spread of each value."""
    frames = [sequence.read(min(stop - 1, (start + stop) // 2 + i)) for i in range(3)]
    n = len(frames[0])
    if stop - start < 3 or any(len(g) != n for g in frames):
        return TRACKED_BYTES * (stop - start > 1)
    values = [np.hstack([getattr(g, field.name).reshape(n, -1) for field in fields(g)]) for g in frames]
    a, b, c = (np.nan_to_num(v.astype(float), posinf=0, neginf=0) for v in values)  # frames come as they were written
    spread = np.subtract(*np.percentile(a, (75, 25), axis=0))
    steps = (np.clip(np.rint(way / np.where(spread > 0, spread, 1) * 30), -127, 127) for way in (b - a, c - 2 * b + a))
    return min(sum(len(zlib.compress(s.astype(np.int8).tobytes())) for s in way.T) for way in steps) / n


def of_training(scene: MultiviewScene | GaussianSequence, frames: int, s: TrainSettings, device: str) -> Expected:
    """Return what a training, or tracking, of some frames takes."""
    slower, tracks = pace(), isinstance(scene, GaussianSequence)
    if isinstance(scene, GaussianSequence):
        views, pixels, read_s, n = DRAWN_VIEWS, DRAWN_PIXELS, 4e-3, float(scene.count(0))
    else:
        from airgs_codec.trainer.data.pictures import ScenePictures  # torch is loaded late
        from airgs_codec.trainer.fit.trainer import usual_budget

        cameras, given = ScenePictures(scene, s).cameras(), scene.cameras[0]
        views, pixels = sum(not camera.held_out for camera in cameras), cameras[0].width * cameras[0].height
        n, read_s = 0.85 * (s.budget or usual_budget(cameras)), 4e-3 + 1e-8 * given.width * given.height
    fit_s = (1.2e-3 + 5e-7 * n + 1.15e-7 * pixels) * s.iteration_views
    fit_s = (3.2e-3 + 2.3e-3 * s.iteration_views) / slower if device == "cuda" else fit_s
    other_s = 0.5 * s.frame_iterations * fit_s + 6e-7 * views * pixels
    first_s = (s.keyframe_iterations if tracks else s.iterations_from_scratch(views)) * fit_s
    first_s += tracks * min(frames - 1, LOOKED_AHEAD) * other_s
    seconds = first_s + other_s * (frames - 1) + read_s * views * (min(60, frames + 17) + 16)
    expected = {"training": slower * seconds, "usage": slower * picture_s(n, pixels) * views * frames}
    return expected, 4 * n * (17 + 3 * SH_REST[s.sh_degree]) * frames
