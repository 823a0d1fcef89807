"""What every question of `work_precision` is given and what it gives: scenes, points to measure, rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.metrics import mse
from airgs_codec.package.package import Package, open_package
from airgs_codec.play.trace import Trace
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import Took

DATA = Path(__file__).parents[3] / "tests" / "data"
FOX, FOX_VIEWS = DATA / "fox", DATA / "fox_views"
FOX_FPS = 24
SPINACH_VIEWS = "spinach_views.json"  # beside the clip
SPINACH_FRAMES = 8  # of the clip, the first ones
REPEATS = 6  # with fewer pairs nothing is beyond chance


class Place(NamedTuple):
    question: str
    scene: str
    curve: str
    setting: str  # a point of the curve


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement: medians of repeated runs with their quartiles; or errors as means with their standard errors."""

    question: str
    scene: str
    curve: str
    setting: str
    seconds: float  # of CPU time, all threads together
    seconds_low: float  # lower quartile
    seconds_high: float  # upper quartile
    error: float  # in `unit`
    error_low: float  # lower quartile, or a standard error below
    error_high: float
    unit: str
    wall: float  # seconds by the clock on the wall, median
    runs: int
    note: str = ""  # what stands beside its point
    samples: tuple[float, ...] = ()  # what `error` is of, in the same order in all rows of a scene: pairs

    @staticmethod
    def of(place: Place, took: Sequence[Took], errors: Sequence[float], unit: str) -> Row:
        """The row of some runs, at least one; `errors` are of runs, too."""
        return Row.by(place, took, quartiles(errors), unit, samples=errors)

    @staticmethod
    def by(
        place: Place,
        took: Sequence[Took],
        error: tuple[float, float, float],
        unit: str,
        note: str = "",
        samples: Sequence[float] = (),
    ) -> Row:
        spread = quartiles([t.cpu for t in took])
        wall = quartiles([t.wall for t in took])[0]
        return Row(*place, *spread, *error, unit, wall, len(took), note, tuple(samples))


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    low, middle, high = np.percentile(np.asarray(values, np.float64), [25, 50, 75])
    return float(middle), float(low), float(high)


def average(values: Sequence[float]) -> tuple[float, float, float]:
    """Mean, a standard error below and above it; of one value it alone."""
    mean = float(np.mean(values))
    error = float(np.std(values, ddof=1)) / len(values) ** 0.5 if len(values) > 1 else 0.0
    return mean, mean - error, mean + error


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    name: str
    sequence: GaussianSequence

    @property
    def identity(self) -> dict[str, Any]:
        return {"name": self.name, "frames": len(self.sequence), "rows": [h.count for h in self.sequence.headers]}


class Point(NamedTuple):
    name: str
    scene: Scene | None
    reads: Mapping[str, Any]  # what decides the rows beside the scene
    make: Callable[[], Iterable[Row]]


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    scenes: tuple[Scene, ...]  # the first is the fox
    folder: Path  # of packages and models
    traces: tuple[Trace, ...] = ()  # of links; none: made ones
    quick: bool = False

    @property
    def repeats(self) -> int:
        return 2 if self.quick else REPEATS

    def package(self, scene: Scene, settings: EncodeSettings, name: str) -> Package:
        """A package of a scene, encoded once; `name` tells it from others of the scene."""
        folder = self.folder / f"{scene.name}-{len(scene.sequence)}-{name}.airgs"
        if not (folder / "manifest.mpd").is_file():
            encode(scene.sequence, folder, settings)
        return open_package(folder)

    def ladder(self, scene: Scene) -> Package:
        return self.package(scene, EncodeSettings(), "ladder")


def open_spinach(path: Path) -> Scene:
    """The first frames of the clip, with the cameras beside it. Raises SceneError."""
    sequence = open_sequence(path, views=path.parent / SPINACH_VIEWS)
    some = slice(0, SPINACH_FRAMES)
    return Scene("spinach", replace(sequence, paths=sequence.paths[some], headers=sequence.headers[some]))


def picture_error(shown: Gaussians, original: Gaussians, camera: Camera) -> float:
    return mse(render(shown, camera).rgb, render(original, camera).rgb)


def shown_frames(package: Package, frames: Sequence[int]) -> dict[int, Gaussians]:
    wanted = set(frames)
    return {f.number: f.gaussians for f in decode_frames(package, 0, package.manifest.frames) if f.number in wanted}
