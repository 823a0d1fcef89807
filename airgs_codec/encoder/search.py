"""The quality factor at which the top rung reaches a PSNR or a size, and what holds it back. N rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.batch import Encoded, Measuring, encode_sequence, measure_quality
from airgs_codec.encoder.measure import Rounds
from airgs_codec.encoder.pipeline import PreparedSequence
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.verify import Attempt
from airgs_codec.errors import ConfigError
from airgs_codec.media.metrics import PSNR_CAP, Picture, psnr
from airgs_codec.package.manifest import Groups, Manifest, pooled_quality
from airgs_codec.package.mpd import write_mpd
from airgs_codec.package.package import root_of
from airgs_codec.package.parse import pack_json
from airgs_codec.package.tables import FileEntry, Group, SegmentLevel, digest
from airgs_codec.render.compare import compare, draw_ahead, draw_still
from airgs_codec.scene.frames import turn_least
from airgs_codec.scene.gaussians import Gaussians, join_rows

PSNR, SIZE = "PSNR", "kB/frame"
TOLERANCES = {PSNR: 0.1, SIZE: 0.01}  # of a search, in dB and as a share; finished packages differ by a little
# How PSNR and the logarithm of the size change with the logarithm of the factor, before two trials say it better:
# error grows with the square of the steps; sizes were seen to fall by 0.6 to 1.
SLOPES = {PSNR: -20 / math.log(10), SIZE: -0.75}
TRIALS = 8
ENOUGH = 2.5  # tolerances by which the best of all trials may miss
FACTORS = 0.01, 100.0  # least and largest quality factor that is tried

FRAMES = 6  # of the sequence, each looked at from a view of its own
PARTS = {
    "positions": ("means",),
    "rotations": ("quaternions",),
    "sizes": ("log_scales",),
    "opacities": ("opacity_logits",),
    "colours": ("sh_dc", "sh_rest"),
}
LEFT_OUT = "Gaussians left out"
TRIAL_PICTURES = 12  # measured in each segment for a PSNR, where the package itself is not measured


class OutOfReachError(ConfigError):
    """A goal that no quality factor meets."""

    def __init__(self, goal: Goal, got: float, factor: float, why: str = "") -> None:
        near = f"{got:.4g} at quality factor {factor:.3g}"
        super().__init__(f"target: {goal.value:g} {goal.kind} is out of reach, the nearest was {near}{why}")
        self.got = got
        self.factor = factor


@dataclass(frozen=True, slots=True)
class Goal:
    """A PSNR or a size that the top rung is to reach."""

    kind: str  # PSNR or SIZE
    value: float  # dB, or kB a frame

    def __post_init__(self) -> None:
        if not 0 < self.value < math.inf:
            raise ConfigError(f"target: expected a positive {self.kind}, got {self.value:g}")
        if self.kind == PSNR and self.value > PSNR_CAP:
            raise ConfigError(f"target: expected at most {PSNR_CAP:g} dB, that of equal pictures, got {self.value:g}")

    def misses(self, got: float) -> float:
        """By how many tolerances `got` misses the goal; positive: it is above."""
        wide = TOLERANCES[self.kind]
        return (got - self.value) / wide if self.kind == PSNR else math.log(got / self.value) / wide


def find_quality(goal: Goal, trial: Callable[[float], float], start: float) -> float:
    """A quality factor at which `trial` gives what the goal asks for; the search begins at `start`.

    It is met to TOLERANCES, or as near as TRIALS trials came where some lie on both sides of it, else to ENOUGH of
    them. The search steps by SLOPES until two trials lie on both sides of the goal, then by regula falsi between the
    nearest two: trials are noisy by more than a tolerance where few Gaussians decide, so no slope between two of them
    can be trusted. Raises OutOfReachError.
    """
    slope = SLOPES[goal.kind] / TOLERANCES[goal.kind]
    seen: dict[float, float] = {}
    factor = start
    for _ in range(TRIALS):
        seen[factor] = goal.misses(trial(factor))
        if abs(seen[factor]) <= 1:
            return factor
        factor = min(max(_next_factor(seen, slope), FACTORS[0]), FACTORS[1])
        if factor in seen:
            break
    best = min(seen, key=lambda f: abs(seen[f]))
    if abs(seen[best]) <= ENOUGH or min(seen.values()) < 0 < max(seen.values()):
        return best
    wide = TOLERANCES[goal.kind]
    got = goal.value + seen[best] * wide if goal.kind == PSNR else goal.value * math.exp(seen[best] * wide)
    raise OutOfReachError(goal, got, best)


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


def find_limit(encoded: Encoded, original: PreparedSequence) -> tuple[str, float]:
    """The part of the top rung without whose error pictures gain most, and the PSNR in dB that they would have then.

    The part is a name of PARTS or LEFT_OUT.
    """
    errors: dict[str, list[float]] = {}
    package, renderer = encoded.package(), original.views.renderer
    numbers = evenly_spaced(package.manifest.frames, FRAMES)
    for view in zip(numbers, original.views.measuring, strict=False):
        number, _ = view
        span = next(span for span in original.spans if number < span.stop)
        whole = turn_least(original.sequence.load(range(span.start, span.stop))).frames[number - span.start]
        reference = draw_ahead(draw_still(whole, renderer), [view])
        for name, shown in _made_exact(whole, decode(package, number), encoded.group(span.index).rows):
            found = compare(reference, draw_still(shown, renderer), [view], Picture.mse)
            errors.setdefault(name, []).extend(found)
    means = {name: float(np.mean(found)) for name, found in errors.items()}
    best = min(means, key=lambda name: means[name])
    return best, psnr(means[best])


def _made_exact(whole: Gaussians, shown: Gaussians, rows: NDArray[np.intp]) -> Iterator[tuple[str, Gaussians]]:
    """A decoded frame, N of the original's rows, with each part of it in turn as in the original."""
    exact = whole.take(rows)
    for name, attributes in PARTS.items():
        yield name, replace(shown, **{attribute: getattr(exact, attribute) for attribute in attributes})
    others = whole.with_degree(shown.sh_degree).take(np.setdiff1d(np.arange(len(whole)), rows))
    yield LEFT_OUT, join_rows([shown, others])


def search_quality(attempt: Attempt, goal: Goal) -> Attempt:
    """Find the quality factor that brings the top rung to its goal: an attempt at it, from which nothing is expected.

    It is measured with the pictures that the search took. Raises ConfigError for a goal out of reach. The error then
    names what holds pictures back from a higher PSNR.
    """
    prepared, original, settings, work = attempt.prepared, attempt.original, attempt.settings, attempt.work
    top = replace(settings, levels=settings.levels[:1], key_factors=settings.key_factors[:1])
    rounds = Rounds(settings.measure_pictures or TRIAL_PICTURES)
    found: list[tuple[float, float]] = []

    def trial(factor: float) -> float:
        found.append((factor, measure(factor)))
        return found[-1][1]

    def measure(factor: float) -> float:
        nonlocal rounds
        work.progress(f"trial {len(found) + 1}: quality factor {factor:.3g}", 0, 1)
        measuring = Measuring(original, rounds)
        encoded = encode_sequence(prepared, top.at(factor), work, measuring if goal.kind == PSNR else None)
        if goal.kind != PSNR:
            return kilobytes_a_frame(encoded.manifest, settings)
        tables = measure_quality(encoded, measuring).whole(encoded.manifest)
        rounds = rounds.again(tables.views.measured // original.views.measured(rounds.count))  # the same ones for all
        measured = pooled_quality(tables, 0, 0)
        assert measured is not None
        return measured.psnr

    try:
        factor = find_quality(goal, trial, settings.quality)
    except OutOfReachError as error:
        if goal.kind != PSNR or error.got > goal.value:
            raise
        part, reached = find_limit(encode_sequence(prepared, top.at(error.factor), work), original)
        why = f"; what holds it back most: {part}, without whose error it would be {reached:.4g} dB"
        raise OutOfReachError(goal, error.got, error.factor, why) from None
    measured = rounds if attempt.rounds.count else attempt.rounds
    return replace(attempt, settings=settings.at(factor), expected=None, rounds=measured, trials=tuple(found))


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
    tiles = [
        replace(
            tile,
            tiers=[
                replace(t, qualities=t.qualities * qualities, pictures=_others(t.pictures * qualities))
                for t in tile.tiers
            ],
            levels=tile.levels * levels,
        )
        for tile in group.tiles
    ]
    segments = [replace(s, levels=_measured(s.levels[0], settings)) for s in group.segments]
    return replace(group, tiles=tiles, segments=segments)


def _others(files: list[FileEntry]) -> list[FileEntry]:
    """Give files of these sizes whose digests differ, as those of other files do."""
    return [FileEntry(f.bytes, digest(f"{i} {f.sha256}".encode()) if f.bytes else "") for i, f in enumerate(files)]


def _measured(level: SegmentLevel, settings: EncodeSettings) -> list[SegmentLevel]:
    """All levels, with figures of the usual length where the package will have them."""
    count = len(settings.key_factors) if settings.measure_pictures else 0
    decibels = [44.44] * count
    like = replace(level, psnr=decibels, worst=decibels, ssim=[0.9999] * count, delta_e=[0.44] * count)
    files = [_others([file] * len(settings.levels)) for file in level.files]  # tile x level
    return [replace(like, files=list(of_level)) for of_level in zip(*files, strict=True)]
