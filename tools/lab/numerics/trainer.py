"""PSNR of held-out cameras against seconds of training, on the embedded views of the fox.

The cameras that are held out judge here; no setting is chosen by them. Runs differ by their seed. Each fits the second
frame, from a first one that all of them share, with networks that have learnt nothing before. Keyframes are the
experiment `keyframe`, which takes any model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial

from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out
from airgs_codec.trainer.data.pictures import FrameViews
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.trainer import InMotion, fit_first
from airgs_codec.trainer.frames import Capture
from airgs_codec.trainer.pipeline import rested
from airgs_codec.trainer.settings import TrainSettings
from tools.lab import seconds_of
from tools.lab.numerics.rows import FOX_VIEWS, Bench, Place, Point, Row

BASE = TrainSettings(budget=4000, capacity=8000, first_iterations=1200)
COUNTS = (30, 100, 300, 600)  # iterations
DELTAS = ("direct", "mlp", "mlp+residual")
UNIT = "dB PSNR of held-out cameras"
SCENE = "fox views"


@dataclass(frozen=True, eq=False)
class Case:
    warm: set[str] = field(default_factory=set)  # curves whose code is compiled

    @cached_property
    def scene(self) -> MultiviewScene:
        return with_held_out(open_scene(FOX_VIEWS), None)

    @cached_property
    def capture(self) -> Capture:
        return rested(Capture.of(self.scene, BASE, "cpu"))

    @cached_property
    def first(self) -> FrameViews:
        return FrameViews(0, self.capture.pictures.at_rest(0)[0])

    @cached_property
    def second(self) -> FrameViews:
        return self.capture.pictures.target(1, 0)

    @cached_property
    def shared(self) -> Gaussians:
        return fit_first(self.capture.trainer, self.first, self.scene.points).gaussians


def measure(bench: Bench) -> Iterator[Point]:
    for deltas in DELTAS:
        for count in COUNTS[:2] if bench.quick else COUNTS:
            place = Place("trainer", SCENE, deltas, str(count))
            yield Point("trainer", None, {"place": place, "seeds": bench.repeats}, partial(_rows, place, bench.repeats))


@cache
def _case() -> Case:
    return Case()


def _rows(place: Place, seeds: int) -> list[Row]:
    case, count = _case(), int(place.setting)
    if place.curve not in case.warm:
        _fit(case, place.curve, 1, 0)  # compiles and reads pictures
        case.warm.add(place.curve)
    runs = [seconds_of(partial(_fit, case, place.curve, count, seed)) for seed in range(seeds)]
    held_out = case.capture.pictures.held_out(1)
    return [Row.of(place, [t for t, _ in runs], [mean_psnr(g, held_out) for _, g in runs], UNIT)]


def _fit(case: Case, deltas: str, count: int, seed: int) -> Gaussians:
    settings = replace(case.capture.trainer.settings, frame_iterations=count, deltas=deltas, seed=seed)
    trainer = replace(case.capture.trainer, settings=settings)
    start = trainer.start_group(case.shared, case.capture.pictures.at_rest(0)[0])
    return trainer.fit_frame(case.second, InMotion(case.shared, None), start)
