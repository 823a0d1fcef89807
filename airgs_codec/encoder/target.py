"""The quality factor at which the top rung reaches a PSNR, a mean CIEDE2000 (ΔE) or a size."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np

from airgs_codec._arguments import argument
from airgs_codec._sampling import evenly_spaced
from airgs_codec.encoder.group import fold
from airgs_codec.encoder.measure import Seen, measure, with_quality
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import Survey
from airgs_codec.encoder.tables import build_manifest
from airgs_codec.encoder.views import SceneViews
from airgs_codec.errors import ConfigError
from airgs_codec.media.metrics import PSNR_CAP, Difference, delta_e_metric
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import write_mpd
from airgs_codec.package.package import Package, root_of
from airgs_codec.package.parse import pack_json
from airgs_codec.places.place import Memory
from airgs_codec.progress import Progress
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import draw_still
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(frozen=True, slots=True)
class Metric:
    """A figure that a search can aim at. Finished packages miss the tolerance of a search by a little."""

    name: str
    unit: str
    tolerance: float  # of a search, in dB or as a share
    # How it in dB, or the logarithm of it or of its inverse, falls with the logarithm of the factor, before two trials
    # say it better: error grows with the square of the steps; sizes were seen to fall by 0.6 to 1, ΔE to grow by 0.6.
    slope: float
    most: float = math.inf
    words: str = ""  # on `most`
    rounding: float = 0.0  # of it in tables

    @property
    def falls(self) -> bool:
        """Return whether less of it is better, so that a goal asks for no more."""
        return self.name == "ΔE"


PSNR = Metric("PSNR", "dB", 0.1, -20 / math.log(10), PSNR_CAP, ", that of equal pictures")
DELTA_E = Metric("ΔE", "ΔE", 0.02, -0.6, 100.0, ", that of black and white", 0.01)
SIZE = Metric("kB/frame", "kB", 0.01, -0.75)
TRIALS = 8
QUALITY_RANGE = 0.01, 100.0  # least and largest quality factor that is tried

COLOUR_FRAMES = 6  # of the sequence, whose colours tell which directions are seen
LEAST_SEEN = 1e-3  # of the squared ΔE of an error along the direction that is seen best: along any other
SAMPLE = 4  # groups, at most, from the first on, that trials encode
TRIAL_PICTURES = 64  # that measure a trial at most, where the package itself is not measured


class OutOfReachError(ConfigError):
    """A goal that no quality factor meets."""

    def __init__(self, goal: Goal, got: float, factor: float) -> None:
        near = f"{got:.4g} at quality factor {factor:.3g}"
        super().__init__(f"target: {goal.value:g} {goal.metric.name} is out of reach, the nearest was {near}")
        self.factor = factor


@dataclass(frozen=True, slots=True)
class Goal:
    """What the top rung is to reach: `Goal.psnr(40)`, in dB, `Goal.delta_e(1)` or `Goal.size(12)`, in kB a frame."""

    metric: Metric
    value: float  # dB, ΔE, or kB a frame

    @staticmethod
    def psnr(value: float) -> Goal:
        return Goal(PSNR, value)

    @staticmethod
    def delta_e(value: float) -> Goal:
        return Goal(DELTA_E, value)

    @staticmethod
    def size(value: float) -> Goal:
        return Goal(SIZE, value)

    def __post_init__(self) -> None:
        m = argument("metric", self.metric, Metric, "a metric, as of Goal.psnr(40)")
        argument("target", self.value, Real, "a number")  # type: ignore[type-abstract]
        if not 0 < self.value < math.inf:
            raise ConfigError(f"target: expected a positive {m.name}, got {self.value:g}")
        if self.value < m.rounding:
            raise ConfigError(f"target: expected at least {m.rounding:g} {m.unit}, its rounding, got {self.value:g}")
        if self.value > m.most:
            raise ConfigError(f"target: expected at most {m.most:g} {m.unit}{m.words}, got {self.value:g}")

    @property
    def tolerance(self) -> float:
        """Return the tolerance of a search; what tables round is no miss."""
        return max(self.metric.tolerance, math.log1p(self.metric.rounding / self.value))

    def misses(self, got: float) -> float:
        """By how many tolerances `got` misses the goal; positive: larger steps would meet it."""
        if self.metric == PSNR:
            return (got - self.value) / self.tolerance
        share = math.log(max(got, self.metric.rounding / 2) / self.value) / self.tolerance
        return -share if self.metric.falls else share

    def got(self, misses: float) -> float:
        """Return the result that misses the goal by this number of tolerances."""
        if self.metric == PSNR:
            return self.value + misses * self.tolerance
        return self.value * math.exp((-misses if self.metric.falls else misses) * self.tolerance)


def find_quality(goal: Goal, trial: Callable[[float], float], start: float) -> float:
    """Return a quality factor at which `trial` gives what the goal asks for; the search begins at `start`.

    It is met to its tolerance, or as near as TRIALS trials came where some lie on both sides of it. The search steps by
    the metric's slope until two trials lie on both sides of the goal, then by regula falsi between the nearest two:
    trials are noisy by more than a tolerance where few Gaussians decide, so no slope between two of them can be
    trusted, and no step that was not tried is taken. Raises OutOfReachError.
    """
    slope = goal.metric.slope / goal.tolerance
    seen: dict[float, float] = {}
    factor = start
    for _ in range(TRIALS):
        miss = seen[factor] = goal.misses(trial(factor))
        if abs(miss) <= 1:
            return factor
        factor = min(max(_next_factor(seen, slope), QUALITY_RANGE[0]), QUALITY_RANGE[1])
        if factor in seen:
            break
    best = min(seen, key=lambda f: abs(seen[f]))
    if min(seen.values()) < 0 < max(seen.values()):
        return best
    raise OutOfReachError(goal, goal.got(seen[best]), best)


def _next_factor(seen: dict[float, float], slope: float) -> float:
    """Return the next factor to try, from the misses of those tried; a positive miss asks for a larger factor."""
    above = [f for f in seen if seen[f] > 0]
    below = [f for f in seen if seen[f] < 0]
    if above and below:
        fine, coarse = max(above), min(below)
        share = seen[fine] / (seen[fine] - seen[coarse])
        return fine * (coarse / fine) ** min(max(share, 0.1), 0.9)
    factor = max(above) if above else min(below)
    return factor * min(max(math.exp(-seen[factor] / slope), 0.25), 4.0)


def search_quality(
    plan: Plan,
    sequence: GaussianSequence,
    goal: Goal,
    surveys: Mapping[int, Survey],
    renderer: Renderer,
    progress: Progress,
) -> tuple[EncodeSettings, list[tuple[float, float]]]:
    """Find settings with the quality factor that brings the top rung to its goal; also gives trials: factors, results.

    A trial encodes the first SAMPLE groups, of which only the top rung where its quality is the goal. Raises
    OutOfReachError for a goal that no factor meets.
    """
    sample = plan.frames(sequence)[:SAMPLE]
    begins = (part for part in sample if part.begins)
    known = {part.number: surveys.get(part.number) or Survey.of(part, plan.views, renderer) for part in begins}
    settings = plan.settings
    trials: list[tuple[float, float]] = []
    top = settings
    if goal.metric != SIZE:
        top = replace(settings, levels=settings.levels[:1], keyframe_factors=settings.keyframe_factors[:1])

    def trial(factor: float) -> float:
        progress(f"search: trial {len(trials) + 1}, quality factor {factor:.3g}", len(trials), TRIALS)
        tried = replace(plan, settings=top.at(factor))
        encoded = list(fold(sample, tried, known))
        m = build_manifest(tried, sequence, "", [group.table for group in encoded], b"")[0]
        if goal.metric == SIZE:
            got = kilobytes_a_frame(as_if_measured(m) if settings.measure_pictures else m)
        else:
            files = {path: data for group in encoded for path, data in group.files.items()}
            package = Package(Memory("trial", files), m, 0)
            most = settings.measure_pictures or TRIAL_PICTURES
            seen = measure(package, sequence, plan.views, renderer, most, range(len(m.segments)))
            quality = with_quality(m, [seen]).rungs[0][0]
            got = quality.psnr if goal.metric == PSNR else quality.delta_e
        trials.append((factor, got))
        return got

    return settings.at(find_quality(goal, trial, settings.quality)), trials


def weigh_colours(
    settings: EncodeSettings, sequence: GaussianSequence, views: SceneViews, renderer: Renderer
) -> EncodeSettings:
    """Return settings that code colours along the directions that CIEDE2000 tells apart, each as finely as it is seen.

    Pictures that decide say how ΔE grows with errors. Steps grow so that bytes stay about the same, and no entry of the
    colour transform leaves -1..1.
    """
    colours = [
        draw_still(sequence.load([number]).frames[0], renderer)(number, camera).sampled.reshape(-1, 3)
        for number, camera in zip(evenly_spaced(len(sequence), COLOUR_FRAMES), views.deciding, strict=False)
    ]
    values, axes = np.linalg.eigh(delta_e_metric(np.concatenate(colours)))
    sizes = np.sqrt(np.maximum(values, LEAST_SEEN * values[-1]))
    sizes /= sizes.prod() ** (1 / 3)
    wide = max(1.0, 1 / float(sizes.min()))
    keyframe, delta = settings.steps.keyframe, settings.steps.delta
    steps = replace(
        settings.steps,
        keyframe=replace(keyframe, sh_dc=wide * keyframe.sh_dc, sh_rest=wide * keyframe.sh_rest),
        delta=replace(delta, sh_dc=wide * delta.sh_dc, sh_rest=wide * delta.sh_rest),
        colours=tuple((wide * (axes * sizes) @ axes.T).ravel().tolist()),
    )
    return replace(settings, steps=steps)


def as_if_measured(m: Manifest) -> Manifest:
    """Return the tables with a quality that takes about as many bytes as one that is measured."""
    shown = [Difference(mse, 0.9876, 0.54) for mse in (1.2e-4, 3.4e-4)]
    rungs = itertools.product(range(len(m.levels)), range(len(m.qualities)))
    return with_quality(m, [Seen([0, 0], dict.fromkeys(rungs, shown))])


def kilobytes_a_frame(m: Manifest) -> float:
    """Return all that a viewer of the top rung fetches, with all tables and manifest.mpd."""
    tables = len(pack_json(root_of(m))) + len(write_mpd(m)) + m.bytes_of(m.table_files())
    return (m.bytes_of(m.rung_files(m.levels[0].quality, 0)) + tables) / m.frames / 1e3
