"""PSNR of held-out cameras against seconds of training, on the embedded views of the fox.

The cameras that are held out judge here; no setting is chosen by them. Runs differ by their seed. Frames in a group are
fitted to the second frame of a run whose first one all of them share, with networks that have learnt nothing before.
Keyframes are the experiment `keyframe`, which takes any model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any

from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.capture import Capture
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.first import fit_first
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.trainer import FrameViews, InMotion, Trainer
from airgs_codec.trainer.pipeline import rested
from airgs_codec.trainer.settings import TrainSettings
from tools.lab.numerics.rows import FOX_VIEWS, Bench, Place, Point, Row
from tools.lab.timing import seconds_of

BASE = TrainSettings(budget=4000, capacity=8000, first_iterations=1200)
FIRST, FRAME = (100, 200, 400, 800, 1600), (30, 100, 300)
DELTAS = ("direct", "mlp", "mlp+residual")
VIEWS = {1: (200, 400, 800), 2: (100, 200, 400), 4: (50, 100, 200)}  # an iteration -> iterations
UNIT = "dB PSNR of held-out cameras"
SCENE = "fox views"


@dataclass(frozen=True, eq=False)
class Case:
    """The views, and a first frame that is fitted when it is first asked for."""

    warm: set[tuple[str, str]] = field(default_factory=set)  # curves whose code is compiled

    @cached_property
    def scene(self) -> MultiviewScene:
        """The embedded views."""
        return with_held_out(open_scene(FOX_VIEWS), None)

    @cached_property
    def capture(self) -> Capture:
        """What all fits share."""
        return rested(Capture.of(self.scene, BASE, "cpu"))

    @cached_property
    def first(self) -> FrameViews:
        """Frame 0 as it is fitted, its pictures in memory."""
        return FrameViews(0, self.capture.views(0))

    @cached_property
    def second(self) -> FrameViews:
        """Frame 1 in the same way."""
        return self.capture.target(1, 0)

    @cached_property
    def shared(self) -> Gaussians:
        """The first frame that frames in a group start from."""
        return fit_first(self.capture.trainer, self.first, self.scene.points).gaussians

    def trainer(self, **changes: Any) -> Trainer:
        """The trainer with other settings."""
        return replace(self.capture.trainer, settings=replace(self.capture.trainer.settings, **changes))


def measure(bench: Bench) -> Iterator[Point]:
    """First frames, frames in a group, views an iteration."""
    seeds = 1 if bench.quick else 2
    for place, frame, fit in fits(bench.quick):
        reads = {"place": place, "seeds": seeds}
        yield Point("trainer", None, reads, partial(_rows, place, frame, fit, seeds))


Fit = Callable[[Case, int, int], Gaussians]  # case, iterations, seed -> Gaussians


def fits(quick: bool) -> Iterator[tuple[Place, int, Fit]]:
    """(place, frame, fit) of every point."""
    few: Callable[[Sequence[int]], Sequence[int]] = (lambda c: c[:2]) if quick else (lambda c: c)
    for count in few(FIRST):
        yield _place("first", "first frame", count), 0, partial(_first, 1)
    for views, counts in VIEWS.items():
        for count in few(counts):
            yield _place("views", f"{views} an iteration", count), 0, partial(_first, views)
    for deltas in DELTAS:
        for count in few(FRAME):
            yield _place("frame", deltas, count), 1, partial(_frame, deltas)


def _place(panel: str, curve: str, count: int) -> Place:
    return Place("trainer", panel, SCENE, curve, str(count))


@cache
def _case() -> Case:
    return Case()


def _rows(place: Place, frame: int, fit: Fit, seeds: int) -> list[Row]:
    case = _case()
    if (place.panel, place.curve) not in case.warm:
        fit(case, 1, 0)  # compiles and reads pictures
        case.warm.add((place.panel, place.curve))
    runs = [seconds_of(partial(fit, case, int(place.setting), seed)) for seed in range(seeds)]
    held_out = case.capture.pictures.held_out(frame)
    return [Row.of(place, [t for t, _ in runs], [mean_psnr(g, held_out) for _, g in runs], UNIT)]


def _first(views: int, case: Case, count: int, seed: int) -> Gaussians:
    trainer = case.trainer(first_iterations=count, iteration_views=views, seed=seed)
    return fit_first(trainer, case.first, case.scene.points).gaussians


def _frame(deltas: str, case: Case, count: int, seed: int) -> Gaussians:
    trainer = case.trainer(frame_iterations=count, deltas=deltas, seed=seed)
    start = trainer.start_group(case.shared, case.capture.views(0))
    return trainer.fit_frame(case.second, InMotion(case.shared, None), start)
