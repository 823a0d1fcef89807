"""The quality factor at which the top rung reaches a PSNR, a ΔE or a size, and what holds it back. N rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.batch import Encoded, Measuring, encode_sequence, quality_query
from airgs_codec.encoder.measure import Rounds, measure_top
from airgs_codec.encoder.pipeline import PreparedSequence
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.verify import ATTEMPTS, Attempt, repair_parts
from airgs_codec.errors import ConfigError
from airgs_codec.media.colour import delta_e_metric
from airgs_codec.media.metrics import PSNR_CAP, Picture, psnr
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.mpd import write_mpd
from airgs_codec.package.package import root_of
from airgs_codec.package.parse import pack_json
from airgs_codec.package.tables import FileEntry, Group, SegmentLevel, digest
from airgs_codec.render.compare import compare, draw_once, draw_still
from airgs_codec.scene.frames import turn_least
from airgs_codec.scene.gaussians import Gaussians, join_rows


@dataclass(frozen=True, slots=True)
class Metric:
    """What a goal is told in. Finished packages miss the tolerance of a search by a little."""

    name: str
    unit: str
    tolerance: float  # of a search, in dB or as a share
    # How it in dB, or the logarithm of it or of its inverse, falls with the logarithm of the factor, before two trials
    # say it better: error grows with the square of the steps; sizes were seen to fall by 0.6 to 1, ΔE to grow by 0.6.
    slope: float
    figure: str = ""  # of `TopMeasured`; "": it is told by the files
    most: float = math.inf
    words: str = ""  # on `most`
    rounding: float = 0.0  # of it in tables

    @property
    def falls(self) -> bool:
        """Whether less of it is better, so that a goal asks for no more."""
        return self.figure == "delta_e"


PSNR = Metric("PSNR", "dB", 0.1, -20 / math.log(10), "psnr", PSNR_CAP, ", that of equal pictures")
DELTA_E = Metric("ΔE", "ΔE", 0.02, -0.6, "delta_e", 100.0, ", that of black and white", 0.01)
SIZE = Metric("kB/frame", "kB", 0.01, -0.75)
TRIALS = 8
ENOUGH = 2.5  # tolerances by which a trial may miss before the last step
FACTORS = 0.01, 100.0  # least and largest quality factor that is tried

FRAMES = 6  # of the sequence, each looked at from a view of its own
PARTS = {
    "positions": ("means",),
    "rotations": ("quaternions",),
    "sizes": ("log_scales",),
    "opacities": ("opacity_logits",),
    "colours": ("sh_dc", "sh_rest"),
}
LEAST_SEEN = 1e-3  # of the squared ΔE of an error along the direction that is seen best: along any other
LEFT_OUT = "Gaussians left out"
ONE_IN = 3  # rounds of the first trial one measures the trials after it
TRIAL_PICTURES = 12  # measured in each segment for a quality, where the package itself is not measured


class OutOfReachError(ConfigError):
    """A goal that no quality factor meets."""

    def __init__(self, goal: Goal, got: float, factor: float, why: str = "") -> None:
        near = f"{got:.4g} at quality factor {factor:.3g}"
        super().__init__(f"target: {goal.value:g} {goal.metric.name} is out of reach, the nearest was {near}{why}")
        self.got = got
        self.factor = factor


@dataclass(frozen=True, slots=True)
class Goal:
    """What the top rung is to reach."""

    metric: Metric
    value: float  # dB, ΔE, or kB a frame

    def __post_init__(self) -> None:
        m = self.metric
        if not 0 < self.value < math.inf:
            raise ConfigError(f"target: expected a positive {m.name}, got {self.value:g}")
        if self.value < m.rounding:
            raise ConfigError(
                f"target: expected at least {m.rounding:g} {m.unit}, to which it is rounded, got {self.value:g}"
            )
        if self.value > m.most:
            raise ConfigError(f"target: expected at most {m.most:g} {m.unit}{m.words}, got {self.value:g}")

    @property
    def tolerance(self) -> float:
        """Of a search; what tables round is no miss."""
        return max(self.metric.tolerance, math.log1p(self.metric.rounding / self.value))

    def misses(self, got: float) -> float:
        """By how many tolerances `got` misses the goal; positive: larger steps would meet it."""
        if self.metric == PSNR:
            return (got - self.value) / self.tolerance
        share = math.log(max(got, self.metric.rounding / 2) / self.value) / self.tolerance
        return -share if self.metric.falls else share

    def got(self, misses: float) -> float:
        """What misses the goal by so many tolerances."""
        if self.metric == PSNR:
            return self.value + misses * self.tolerance
        return self.value * math.exp((-misses if self.metric.falls else misses) * self.tolerance)


def find_quality(goal: Goal, trial: Callable[[float], float], start: float) -> float:
    """A quality factor at which `trial` gives what the goal asks for; the search begins at `start`.

    It is met to its tolerance, or to ENOUGH of them and then stepped to without a trial; or as near as TRIALS trials
    came where some lie on both sides of it. The search steps by the metric's slope until two trials lie on both sides
    of the goal, then by regula falsi between the nearest two: trials are noisy by more than a tolerance where few
    Gaussians decide, so no slope between two of them can be trusted. Raises OutOfReachError.
    """
    slope = goal.metric.slope / goal.tolerance
    seen: dict[float, float] = {}
    factor = start
    for _ in range(TRIALS):
        miss = seen[factor] = goal.misses(trial(factor))
        if abs(miss) <= 1:
            return factor
        factor = min(max(_next_factor(seen, slope), FACTORS[0]), FACTORS[1])
        if abs(miss) <= ENOUGH:
            return factor
        if factor in seen:
            break
    best = min(seen, key=lambda f: abs(seen[f]))
    if min(seen.values()) < 0 < max(seen.values()):
        return best
    raise OutOfReachError(goal, goal.got(seen[best]), best)


def _next_factor(seen: dict[float, float], slope: float) -> float:
    """The next factor to try, from the misses of those tried; a positive miss asks for a larger factor."""
    above = [f for f in seen if seen[f] > 0]
    below = [f for f in seen if seen[f] < 0]
    if above and below:
        fine, coarse = max(above), min(below)
        share = seen[fine] / (seen[fine] - seen[coarse])
        return fine * (coarse / fine) ** min(max(share, 0.1), 0.9)
    factor = max(above) if above else min(below)
    return factor * min(max(math.exp(-seen[factor] / slope), 0.25), 4.0)


def find_limit(encoded: Encoded, original: PreparedSequence, metric: Metric = PSNR) -> tuple[str, float]:
    """The part of the top rung without whose error pictures gain most, and the PSNR or ΔE that they would have then.

    The part is a name of PARTS or LEFT_OUT.
    """
    differs = Picture.mse if metric == PSNR else Picture.delta_e
    errors: dict[str, list[float]] = {}
    package, renderer = encoded.package(), original.views.renderer
    numbers = evenly_spaced(package.manifest.frames, FRAMES)
    for view in zip(numbers, original.views.measuring, strict=False):
        number, _ = view
        span = next(span for span in original.spans if number < span.stop)
        whole = turn_least(original.sequence.load(range(span.start, span.stop))).frames[number - span.start]
        reference = draw_once(draw_still(whole, renderer))
        for name, shown in _made_exact(whole, decode(package, number), encoded.group(span.index).rows):
            found = compare(reference, draw_still(shown, renderer), [view], differs)
            errors.setdefault(name, []).extend(found)
    means = {name: float(np.mean(found)) for name, found in errors.items()}
    best = min(means, key=lambda name: means[name])
    return best, psnr(means[best]) if metric == PSNR else means[best]


def _made_exact(whole: Gaussians, shown: Gaussians, rows: NDArray[np.intp]) -> Iterator[tuple[str, Gaussians]]:
    """A decoded frame, N of the original's rows, with each part of it in turn as in the original."""
    exact = whole.take(rows)
    for name, attributes in PARTS.items():
        yield name, replace(shown, **{attribute: getattr(exact, attribute) for attribute in attributes})
    others = whole.with_degree(shown.sh_degree).take(np.setdiff1d(np.arange(len(whole)), rows))
    yield LEFT_OUT, join_rows([shown, others])


def search_quality(attempt: Attempt, goal: Goal) -> Attempt:
    """Find the quality factor that brings the top rung to its goal: an attempt at it, from which nothing is expected.

    It is measured with the pictures of the first trial. Others are measured with one round in ONE_IN, and taken to miss
    the goal by as much more in all of them as the first one does, since a view that is hard at one factor is hard at
    all. What costs more than was expected of it is taken back before. Raises ConfigError for a goal out of reach. The
    error then names what holds pictures back from a better one.
    """
    attempt = _taken_back(attempt)
    prepared, original, settings, work = attempt.prepared, attempt.original, attempt.settings, attempt.work
    top = _top_of(settings)
    rounds, some, beyond = Rounds(settings.measure_pictures or TRIAL_PICTURES), 1, 0.0
    found: list[tuple[float, float]] = []

    def trial(factor: float) -> float:
        found.append((factor, measure(factor)))
        return found[-1][1]

    def measure(factor: float) -> float:
        nonlocal rounds, some, beyond
        work.progress(f"trial {len(found) + 1}: quality factor {factor:.3g}", 0, 1)
        measuring = Measuring(original, rounds)
        encoded = encode_sequence(prepared, top.at(factor), work, measuring if goal.metric.figure else None)
        if not goal.metric.figure:
            return kilobytes_a_frame(encoded.manifest, settings)
        if not found:
            got, turns = _figure(encoded, measuring, goal.metric)
            rounds, some = rounds.again(turns), -(-turns // ONE_IN)
        shown, _ = _figure(encoded, Measuring(original, rounds.again(some)), goal.metric)
        if not found:
            beyond = goal.misses(got) - goal.misses(shown)
        return goal.got(goal.misses(shown) + beyond)

    try:
        factor = find_quality(goal, trial, settings.quality)
    except OutOfReachError as error:
        if not goal.metric.figure or goal.misses(error.got) > 0:
            raise
        part, reached = find_limit(encode_sequence(prepared, top.at(error.factor), work), original, goal.metric)
        why = f"; what holds it back most: {part}, without whose error it would be {reached:.4g} {goal.metric.unit}"
        raise OutOfReachError(goal, error.got, error.factor, why) from None
    measured = rounds if attempt.rounds.count else attempt.rounds
    return replace(attempt, settings=settings.at(factor), expected=None, rounds=measured, trials=tuple(found))


def _top_of(settings: EncodeSettings) -> EncodeSettings:
    """The settings of the top rung alone."""
    return replace(settings, levels=settings.levels[:1], key_factors=settings.key_factors[:1])


def _taken_back(attempt: Attempt) -> Attempt:
    """The attempt without what costs more than is expected of it at its quality, at any other one, too."""
    for _ in range(ATTEMPTS - 1):
        settings = _top_of(attempt.settings).at(attempt.settings.quality)
        repair = repair_parts(attempt, encode_sequence(attempt.prepared, settings, attempt.work))
        if repair is None:
            break
        attempt = replace(attempt, settings=repair.settings, stories=(*attempt.stories, repair.story))
    return attempt


def _figure(encoded: Encoded, measuring: Measuring, metric: Metric) -> tuple[float, int]:
    """What the only rung of a package has of a metric, and the rounds of pictures that tell it."""
    top = measure_top(quality_query(encoded, measuring))
    return float(getattr(top, metric.figure)), top.rounds


def weigh_colours(settings: EncodeSettings, original: PreparedSequence) -> EncodeSettings:
    """Settings that code colours along the directions that CIEDE2000 tells apart, each as finely as it is seen.

    Pictures that decide say how ΔE grows with errors. Steps grow so that bytes stay about the same, and no entry of the
    colour transform leaves -1..1.
    """
    numbers, renderer = evenly_spaced(len(original.sequence), FRAMES), original.views.renderer
    colours = [
        draw_still(original.sequence.load([number]).frames[0], renderer)(number, camera).sampled.reshape(-1, 3)
        for number, camera in zip(numbers, original.views.deciding, strict=False)
    ]
    values, axes = np.linalg.eigh(delta_e_metric(np.concatenate(colours)))
    sizes = np.sqrt(np.maximum(values, LEAST_SEEN * values[-1]))
    sizes /= sizes.prod() ** (1 / 3)
    wide = max(1.0, 1 / float(sizes.min()))
    key, state = settings.steps.key, settings.steps.state
    steps = replace(
        settings.steps,
        key=replace(key, sh_dc=wide * key.sh_dc, sh_rest=wide * key.sh_rest),
        state=replace(state, sh_dc=wide * state.sh_dc, sh_rest=wide * state.sh_rest),
        colours=tuple((wide * (axes * sizes) @ axes.T).ravel().tolist()),
    )
    return replace(settings, steps=steps)


def kilobytes_a_frame(top: Manifest, settings: EncodeSettings) -> float:
    """All that a viewer of the top rung fetches, manifests included, if `top` were a package of these settings."""
    return (top.bytes_of(top.rung_files(0, 0)) + _manifest_bytes(top, settings)) / top.frames / 1e3


def _manifest_bytes(m: Manifest, settings: EncodeSettings) -> int:
    """Length of all tables and the MPD if all levels and key qualities were there, each like the only one in `m`."""
    levels, qualities = len(settings.levels), len(settings.key_factors)
    groups = Groups.of([_widen(group, settings) for group in m.groups])
    many = replace(m, qualities=m.qualities * qualities, levels=m.levels * levels, groups=groups)
    return len(pack_json(root_of(many))) + len(write_mpd(many)) + many.bytes_of(many.table_files())


def _widen(group: Group, settings: EncodeSettings) -> Group:
    levels, qualities = len(settings.levels), len(settings.key_factors)
    tiers = [
        replace(t, qualities=t.qualities * qualities, pictures=_others(t.pictures * qualities)) for t in group.tiers
    ]
    segments = [replace(s, levels=_measured(s.levels[0], settings)) for s in group.segments]
    return replace(group, tiers=tiers, levels=group.levels * levels, segments=segments)


def _others(files: list[FileEntry]) -> list[FileEntry]:
    """Give files of these sizes whose digests differ, as those of other files do."""
    return [FileEntry(f.bytes, digest(f"{i} {f.sha256}".encode()) if f.bytes else "") for i, f in enumerate(files)]


def _measured(level: SegmentLevel, settings: EncodeSettings) -> list[SegmentLevel]:
    """All levels, with figures of the usual length where the package will have them."""
    count = len(settings.key_factors) if settings.measure_pictures else 0
    like = replace(level, psnr=[44.44] * count, worst=[44.4] * count, ssim=[0.9999] * count, delta_e=[0.44] * count)
    return [replace(like, file=file) for file in _others([level.file] * len(settings.levels))]
