"""What a run takes, before it begins and as it goes on: iterations, seconds and memory.

A unit is an iteration of a first frame on the CPU; those of other frames begin with small pictures and draw what moves.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from airgs_codec.progress import Progress
from airgs_codec.trainer.data.pictures import PICTURE_BYTES, TARGET_BYTES, View
from airgs_codec.trainer.fit.active import REST_BYTES
from airgs_codec.trainer.fit.first import START_OPACITY, usual_budget
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.parameters import from_gaussians
from airgs_codec.trainer.fit.points import SPARSE_DEGREES, degrees_apart, from_points, looked_at
from airgs_codec.trainer.fit.trainer import Trainer
from airgs_codec.trainer.fit.variables import PerGaussian
from airgs_codec.trainer.settings import LEAST_BUDGET, TrainSettings

FOLLOWED = 0.6  # units of an iteration of a frame that follows another
BEFORE = 0.6  # mean share of the Gaussians of a first frame over its iterations
TRIED = 3  # iterations that tell what one takes
SPREAD = (0.4, 1.0)  # of what it then is, over that: what frames show and how they move is not known yet
LIBRARIES = 700e6  # bytes that Python, torch and compiled kernels take
TARGET, HELD = 36, 16  # bytes of a pixel of a target, and of a whole picture where only what moves is drawn


@dataclass(frozen=True, slots=True)
class Plan:
    """The units of a run, as far as they are known: which frames become keyframes is not."""

    first: float
    frame: float  # of every other one
    frames: int

    @staticmethod
    def of(settings: TrainSettings, views: int, frames: int) -> Plan:
        """The units of a run of so many frames, the first of which is seen by so many views."""
        return Plan(settings.iterations_from_scratch(views), FOLLOWED * settings.frame_iterations, frames)

    def before(self, frame: int) -> float:
        """Units of the frames before one."""
        return self.first + (frame - 1) * self.frame if frame else 0.0


@dataclass(slots=True)
class Told:
    """Progress of a whole run: its stage is `training`, and after a colon the frame that is fitted and how."""

    progress: Progress
    plan: Plan
    _more: float = field(init=False, default=0.0)  # units that frames before have taken beyond the plan

    def of(self, frame: int) -> Progress:
        """Progress of the fits of a frame, each of which is a stage; one frame at a time, ascending."""
        begun, planned, count = self.plan.before(frame), self.plan.first, self.plan.frames
        cost, before, now = 1.0, 0.0, ("", 0.0)
        if frame:
            planned, cost = self.plan.frame, FOLLOWED
        more = self._more

        def tell(stage: str, done: int, total: int) -> None:
            nonlocal before, now
            if stage != now[0]:
                before, now = before + now[1], (stage, cost * total)
            self._more = more + max(0.0, before + cost * total - planned)
            at, whole = begun + more + before + cost * done, self.plan.before(count) + self._more
            self.progress(f"training: frame {frame} of {count} ({stage})", round(at), round(whole))

        return tell


def foretell(trainer: Trainer, views: Sequence[View], frames: int, done: int = 0) -> tuple[tuple[float, float], float]:
    """Least and most seconds that a run of so many frames takes behind the first `done` of them, and bytes of memory.

    `views`: of its first frame. Keyframes come on top. Memory is that of the process, and what pictures take in it.
    """
    plan = Plan.of(trainer.settings, len(views), frames)
    seconds = (plan.before(frames) - plan.before(done)) * seconds_a_unit(trainer, views)
    pixels = sum(view.camera.width * view.camera.height for view in views)
    read, targets = min(PICTURE_BYTES, 3 * pixels * frames), min(TARGET_BYTES, TARGET * pixels * frames)
    rest = frames > 1 and trainer.settings.knows_rest
    drawn = min(TARGET_BYTES, TARGET * pixels) + min(REST_BYTES, HELD * pixels) if rest else 0
    return (SPREAD[0] * seconds, SPREAD[1] * seconds), LIBRARIES + read + targets + drawn


def seconds_a_unit(trainer: Trainer, views: Sequence[View]) -> float:
    """Seconds of an iteration of a first frame, from some of a cloud that fills what a view sees."""
    s, camera, rng = trainer.settings, views[0].camera, np.random.default_rng(0)
    cameras = [view.camera for view in views]
    usual = LEAST_BUDGET if degrees_apart(cameras) > SPARSE_DEGREES else usual_budget(cameras)
    rows = max(1, round(BEFORE * (s.budget or usual)))
    away = float(np.linalg.norm(looked_at(cameras) - camera.position)) or trainer.extent
    u, v = rng.uniform(0, (camera.width, camera.height), (rows, 2)).T
    seen = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(rows)], axis=1)
    seen *= away * rng.uniform(0.5, 1.5, (rows, 1))
    places = (seen @ camera.world_to_camera[:3, :3] + camera.position).astype(np.float32)
    cloud = from_points(places, np.full_like(places, 0.5), s.sh_degree, START_OPACITY, 0.1 * trainer.extent)
    variables = PerGaussian(from_gaussians(cloud, trainer.device), trainer.extent)

    def run(iterations: int) -> float:
        begun = time.perf_counter()
        schedule = Schedule("", iterations, lambda _: s.sh_degree, views=s.iteration_views)
        optimise(variables, views[:1], schedule, np.random.default_rng(0))
        return time.perf_counter() - begun

    run(1)  # kernels are loaded, and the first picture is read
    return run(TRIED) / TRIED
