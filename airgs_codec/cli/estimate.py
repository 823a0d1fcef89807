"""How long work will take, stage by stage, and how many bytes it writes: guessed before it begins.

Seconds are of one core that sorts as `pace` does in SORT_S. Factors were fitted to encodes and trainings of scenes of
5,000 to 45,000 Gaussians. N Gaussians a frame, F frames.
"""

from __future__ import annotations

import time

import numpy as np

from airgs_codec._settings import available_cores
from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.views import DECISION_PIXELS
from airgs_codec.scene.gaussians import SH_REST, morton_encode
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.settings import TrainSettings
from airgs_codec.trainer.track import CHUNK_FRAMES, DRAWN_PIXELS, DRAWN_VIEWS, track_settings

SORT_S, PACE_S = 6.2e-3, 0.2  # how long one takes, and how long they are done
CORES = -0.5  # time falls with this power of their number, and of that of processes that share them
LOOKED_AHEAD = 11  # frames that show what the first one that is tracked has by chance
UNREST = 2.0  # bits, where frames cannot tell
Expected = tuple[dict[str, float], float]  # seconds of each stage, in their order, and bytes


def pace() -> float:
    """Return how many times as long work takes on this machine, where others go on to take half of what they do now."""
    numbers, sorts, begun, own = np.random.default_rng(0).random(100_000), 0, time.perf_counter(), time.thread_time()
    while (took := time.perf_counter() - begun) < PACE_S:
        np.sort(numbers, kind="stable")  # a merge sort, which no vector unit speeds up
        sorts += 1
    return float((took * (time.thread_time() - own)) ** 0.5 / sorts / SORT_S * available_cores() ** CORES)


def of_encode(
    sequence: GaussianSequence, s: EncodeSettings, jobs: int, *, goal: bool, lost: bool, track: bool
) -> Expected:
    """Return what `encoder.publish.encode` takes, of rows that are `lost`, or tracked. Raises SceneError."""
    f, sh, spans = len(sequence), 3 * SH_REST[sequence.sh_degree], plan_groups(sequence, s.group_frames).spans
    n, groups = sum(header.count for header in sequence.headers) / f, len(spans)
    own = sum(a == 0 or a in sequence.breaks or sequence.count(a) != sequence.count(a - 1) for a, _ in spans)
    bits = unrest(sequence, *max(spans, key=lambda span: span[1] - span[0]))
    if track:
        groups, own, bits, lost = -(-f // CHUNK_FRAMES), -(-f // CHUNK_FRAMES), UNREST, False
    levels, qualities = (1, 1) if f == 1 else (len(s.levels), len(s.keyframe_factors) + (s.calibrate == "ladder"))
    pixels = sequence.cameras[0].width * sequence.cameras[0].height if sequence.cameras else DRAWN_PIXELS
    drawn_s = 6e-7 * n + 5e-8 * min(pixels, DECISION_PIXELS) + 1e-3
    survey_s = drawn_s * (1.7 * s.decide_pictures * (groups / own) ** 0.5 + s.check_pictures)
    coded_s = groups * (0.5 + 1.2e-5 * n * (1 + qualities)) + f * 1.9e-8 * n * (13 + sh) * (0.5 + levels)
    coded_s = (coded_s + (own - 1) * 1.3 * survey_s) * min(jobs, own, available_cores()) ** CORES
    measured_s = s.measure_pictures * (6e-7 * n + 5e-8 * pixels + 1e-3) * (0.5 + 0.6 * levels) + 0.3
    seconds = {
        "frames": 2e-7 * n * f, "order of rows": 4e-5 * n * f * lost,
        "views": 48 * drawn_s if sequence.cameras else 0.5 + 28 * drawn_s,
        "steps and pruning levels": (3 + 90 * drawn_s + survey_s) * (s.calibrate != "none"),
        "search": 4 * (coded_s + measured_s) * goal, "encoding": coded_s, "measuring": measured_s,
    }  # fmt: skip
    keyframes = (own * (9 + 0.6 * sh) + (groups - own) * (4 + 0.3 * sh)) * n * (1 + qualities) / 4
    slower, size = pace(), 30e3 + (keyframes + 0.11 * bits * n * f * (1 + levels)) * s.quality**-0.7
    before = of_training(sequence, f, track_settings(sequence), s.device, jobs)[0] if track else {}
    return before | {stage: slower * value for stage, value in seconds.items()}, size


def unrest(sequence: GaussianSequence, start: int, stop: int) -> float:
    """Return about how many bits motion in the middle of a group is that neither time nor neighbours foretell."""
    frames = [sequence.read(min(stop - 1, (start + stop) // 2 + i)).means.astype(np.float64) for i in range(3)]
    if stop - start < 3 or len({len(means) for means in frames}) > 1:
        return UNREST * (stop - start > 1)
    with np.errstate(all="ignore"):  # frames come as they were written
        a, b, c = (np.nan_to_num(means, posinf=0, neginf=0) for means in frames)
        away = a - np.median(a, axis=0)
        unit = float(np.median(np.linalg.norm(away, axis=1))) / 1000 or 1.0
        order = np.argsort(morton_encode(np.clip(away / unit + 4096, 0, 8191).astype(np.int64)))
        ways = b - a, c - 2 * b + a, np.diff((c - 2 * b + a)[order], axis=0)
        return min(float(np.log2(1 + np.abs(way) / unit).sum(axis=1).mean()) for way in ways)


def of_training(
    scene: MultiviewScene | GaussianSequence, frames: int, s: TrainSettings, device: str, jobs: int
) -> Expected:
    """Return what a training, or tracking, of some frames takes."""
    slower, tracks = pace(), isinstance(scene, GaussianSequence)
    if isinstance(scene, GaussianSequence):
        views, pixels, read_s, n = DRAWN_VIEWS, DRAWN_PIXELS, 4e-3 * slower, float(scene.count(0))
    else:
        from airgs_codec.trainer.data.pictures import ScenePictures  # torch is loaded late
        from airgs_codec.trainer.fit.trainer import usual_budget

        cameras, given = ScenePictures(scene, s).cameras(), scene.cameras[0]
        views, pixels = sum(not camera.held_out for camera in cameras), cameras[0].width * cameras[0].height
        n, read_s = 0.85 * (s.budget or usual_budget(cameras)), (4e-3 + 1e-8 * given.width * given.height) * slower
    fit_s = (1.2e-3 + 5e-7 * n + 1.15e-7 * pixels) * slower * s.iteration_views
    fit_s = 3.2e-3 + 2.3e-3 * s.iteration_views if device == "cuda" else fit_s
    other_s = 0.5 * s.frame_iterations * fit_s + 6e-7 * slower * views * pixels
    first_s = (s.keyframe_iterations if tracks else s.iterations_from_scratch(views)) * fit_s
    first_s += tracks * min(frames - 1, LOOKED_AHEAD) * other_s
    at_once = min(jobs, -(-frames // (s.group_frames or frames)), available_cores())
    seconds = first_s + other_s * (frames - 1) * at_once**CORES + read_s * views * (min(60, frames + 17) + 16)
    usage_s = (6e-7 * n + 5e-8 * pixels + 1e-3) * slower * views * frames
    return {"training": seconds, "usage": usage_s}, 4 * n * (17 + 3 * SH_REST[s.sh_degree]) * frames
