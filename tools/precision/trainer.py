"""PSNR of held-out cameras against seconds of training, on the embedded views of the fox.

The cameras that are held out judge here; no setting is chosen by them. Runs differ by their seed. Frames in a group are
fitted to the second frame of a run whose first one all of them share, with networks that have learnt nothing before;
keyframes to the frame where the cake appears.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.multiview import MultiviewScene, with_held_out
from airgs_codec.train.data.pictures import pictures_for
from airgs_codec.train.data.plates import find_plates
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.fit.parameters import Parameters
from airgs_codec.train.frames import Capture
from airgs_codec.train.quality import mean_psnr
from airgs_codec.train.record import Model
from airgs_codec.train.run import frame_before, train
from airgs_codec.train.settings import TrainSettings
from airgs_codec.train.stages import FrameBefore, FrameViews, Trainer
from tools.precision.bench import FOX_VIEWS, Bench
from tools.precision.rows import Place, Row, seconds_of

KEYFRAME = 3  # the cake appears
# No frame of the shared run starts a group.
BASE = TrainSettings(budget=4000, capacity=8000, first_iterations=1200, min_psnr_db=1.0, max_drop_db=math.inf)
FIRST, SCRATCH = (100, 200, 400, 800, 1600), (200, 400, 800, 1600)
WARM, FRAME = (25, 100, 400, 1000), (30, 100, 300)
DELTAS = ("direct", "mlp", "mlp+residual")
VIEWS = {1: (200, 400, 800), 2: (100, 200, 400), 4: (50, 100, 200)}  # an iteration -> iterations
WARM_CURVE, SCRATCH_CURVE = "from the frame before", "from scratch"
UNIT = "dB PSNR of held-out cameras"
SCENE = "fox views"


@dataclass(frozen=True, eq=False)
class Case:
    """The views, and a run of the frames before the keyframe that is made when it is first asked for."""

    bench: Bench
    warm: set[tuple[str, str]] = field(default_factory=set)  # curves whose code is compiled
    _targets: dict[int, FrameViews] = field(default_factory=dict)

    @cached_property
    def scene(self) -> MultiviewScene:
        """The embedded views."""
        return with_held_out(open_scene(FOX_VIEWS), None)

    @cached_property
    def model(self) -> Model:
        """The trained frames before the keyframe."""
        before = replace(self.scene, frames=self.scene.frames[:KEYFRAME])
        folder = self.bench.folder / "model"
        return train(before, folder, BASE, resume=folder.exists())

    @cached_property
    def capture(self) -> Capture:
        """What all fits share."""
        capture = Capture.of(self.scene, pictures_for(self.scene, BASE), BASE, "cpu")
        return replace(capture, plates=find_plates(self.scene, capture.pictures))

    @cached_property
    def before(self) -> FrameBefore:
        """The frame before the keyframe."""
        return frame_before(self.model, KEYFRAME)

    @cached_property
    def steps(self) -> Parameters:
        """Codec steps of that frame."""
        return self.capture.trainer.steps(self.before.gaussians, self.capture.pictures.train(KEYFRAME - 1))

    def target(self, frame: int) -> FrameViews:
        """A frame as it is fitted, its pictures in memory."""
        if frame not in self._targets:
            capture = self.capture
            views = FrameViews(0, capture.views(0))
            self._targets[frame] = capture.target(frame, frame - 1) if frame else views
        return self._targets[frame]

    def trainer(self, **changes: Any) -> Trainer:
        """The trainer with other settings."""
        return replace(self.capture.trainer, settings=replace(self.capture.trainer.settings, **changes))


def measure(bench: Bench) -> Iterator[Row]:
    """First frames, keyframes, frames in a group, views an iteration."""
    case, seeds = Case(bench), 1 if bench.quick else 2
    for place, frame, fit in fits(case, bench.quick):
        settings = {"measure": place, "seeds": seeds}
        yield from bench.once(None, settings, partial(_rows, case, (place, frame), fit, seeds))


Fit = Callable[[int, int], Gaussians]  # iterations, seed -> Gaussians


def fits(case: Case, quick: bool) -> Iterator[tuple[Place, int, Fit]]:
    """(place, frame, fit) of every point."""
    few: Callable[[Sequence[int]], Sequence[int]] = (lambda c: c[:2]) if quick else (lambda c: c)
    for count in few(FIRST):
        yield _place("first", "first frame", count), 0, partial(_first, case, 0, 1)
    for views, counts in VIEWS.items():
        for count in few(counts):
            yield _place("views", f"{views} an iteration", count), 0, partial(_first, case, 0, views)
    for count in few(WARM):
        yield _place("keyframe", WARM_CURVE, count), KEYFRAME, partial(_warm, case)
    for count in few(SCRATCH):
        yield _place("keyframe", SCRATCH_CURVE, count), KEYFRAME, partial(_first, case, KEYFRAME, 1)
    for deltas in DELTAS:
        for count in few(FRAME):
            yield _place("frame", deltas, count), 1, partial(_frame, case, deltas)


def _place(panel: str, curve: str, count: int) -> Place:
    return Place("trainer", panel, SCENE, curve, str(count))


def _rows(case: Case, at: tuple[Place, int], fit: Fit, seeds: int) -> Iterator[Row]:
    place, frame = at
    if (place.panel, place.curve) not in case.warm:
        fit(1, 0)  # compiles and reads pictures
        case.warm.add((place.panel, place.curve))
    runs = [seconds_of(lambda s=s: fit(int(place.setting), s)) for s in range(seeds)]  # type: ignore[misc]
    held_out = case.capture.pictures.held_out(frame)
    yield Row.of(place, [t for t, _ in runs], [mean_psnr(g, held_out) for _, g in runs], UNIT)


def _first(case: Case, frame: int, views: int, count: int, seed: int) -> Gaussians:
    trainer = case.trainer(first_iterations=count, iteration_views=views, seed=seed)
    points = None if frame else case.scene.points
    return trainer.fit_first(case.target(frame), points)


def _warm(case: Case, count: int, seed: int) -> Gaussians:
    return case.trainer(key_iterations=count, seed=seed).fit_keyframe(case.target(KEYFRAME), case.before, case.steps)


def _frame(case: Case, deltas: str, count: int, seed: int) -> Gaussians:
    trainer = case.trainer(frame_iterations=count, deltas=deltas, seed=seed)
    first = case.model.read(0)
    return trainer.fit_frame(
        case.target(1), FrameBefore(first, None), trainer.start_group(first, case.capture.views(0))
    )
