"""Encodes, measures, and believes what it measured: what fell short of its promise is taken back and encoded again.

N rows of a group.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import ExpectedError
from airgs_codec.encoder.batch import Encoded, Measuring, encode_sequence, quality_query
from airgs_codec.encoder.doubt import doubt_db
from airgs_codec.encoder.measure import Rounds, measure_groups
from airgs_codec.encoder.pipeline import GroupFiles, PreparedSequence
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.jobs.work import Work
from airgs_codec.media.metrics import Picture, psnr, squared_error
from airgs_codec.package.manifest import Manifest, on_ladder, pooled_quality
from airgs_codec.package.region import draw_views
from airgs_codec.package.tables import STATIC
from airgs_codec.progress import Stopwatch
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import View, compare, draw_frames, draw_once
from airgs_codec.scene.gaussians import Gaussians, mean_frame, mix_rows

ATTEMPTS = 4  # encodes at most
SHORTFALL_DB = 0.5  # of the top rung, that is not taken
CHECKING = 2  # seed of the views that tell what failed: neither those that decided nor those that measure
CHECKED = 8  # pictures that tell what failed
IDLE_DB = 0.5  # by which mixtures of other rungs beat all of a level, at least, where it is not written
BLAME = 0.5  # share of what is more than was expected from which a part is to blame for it


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """A sequence that is to be encoded, and what is expected of it."""

    prepared: PreparedSequence
    original: PreparedSequence  # with all SH bands
    settings: EncodeSettings  # nothing is left to calibrate
    work: Work
    expected: ExpectedError | None  # of the top rung; None: any is taken
    rounds: Rounds  # of pictures that measure it; a count of 0: none do
    given: bool = False  # levels were asked for by hand: they stay as they are
    trials: tuple[tuple[float, float], ...] = ()  # quality factors that a search tried, and what they came to
    stories: tuple[str, ...] = ()  # of what was repaired before, a line each


@dataclass(frozen=True, slots=True)
class Repair:
    """Other settings, and why."""

    settings: EncodeSettings
    story: str


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """A package whose rungs each beat the cheaper ones, and how it got there."""

    manifest: Manifest  # with measured quality
    encoded: Encoded
    settings: EncodeSettings  # that it was encoded with at last
    stories: tuple[str, ...]  # one line a repair
    encode_s: float
    measure_s: float
    unsure: float = 0.0  # as in `Measured`


def encode_verified(attempt: Attempt) -> Verified:
    """Encode and measure, again with other settings while a rung must be repaired.

    What the top rung leaves out or withholds is taken back where it makes more error than expected, before anything is
    measured. Rungs that a cheaper one beats are dropped, and then levels that mixtures of others beat. Where steps
    alone explain a shortfall, the rung is worth its bytes, and stays.
    """
    stories = list(attempt.stories)
    watch, encode_s, measure_s = Stopwatch(), 0.0, 0.0
    for number in itertools.count(1):
        measuring = Measuring(attempt.original, attempt.rounds)
        encoded = encode_sequence(attempt.prepared, attempt.settings, attempt.work, measuring)
        encode_s += watch.lap()
        if not attempt.rounds.count:
            return Verified(encoded.manifest, encoded, attempt.settings, (), encode_s, 0.0)
        last = attempt.given or number == ATTEMPTS
        repair = None if last else repair_parts(attempt, encoded)
        if repair is None:
            measured = measure_groups(quality_query(encoded, measuring))
            manifest = measured.whole(encoded.manifest)
            repair = None if last else repair_levels(attempt, encoded, manifest, measured.unsure)
        measure_s += watch.lap()
        if repair is None:
            ends = f"; top rung now {_psnr(manifest, 0, manifest.levels[0].quality):.2f} dB" if stories else ""
            told = (*stories[:-1], *(s + ends for s in stories[-1:]))
            return Verified(manifest, encoded, attempt.settings, told, encode_s, measure_s, measured.unsure)
        stories.append(repair.story)
        attempt = replace(attempt, settings=repair.settings)
    raise AssertionError("unreachable")


def repair_parts(attempt: Attempt, encoded: Encoded) -> Repair | None:
    """Say what the top rung must take back that costs SHORTFALL_DB more than all was expected to; None: nothing."""
    expected = attempt.expected
    if expected is None or attempt.given:
        return None
    beyond = squared_error(psnr(expected.total) - SHORTFALL_DB) - expected.total
    return _take_back(attempt, encoded, expected, beyond)


def repair_levels(attempt: Attempt, encoded: Encoded, measured: Manifest, unsure: float = math.inf) -> Repair | None:
    """Say what must change in a package whose quality was measured; None where every rung is as it should be.

    `unsure` is as in `Measured`; infinite: nobody knows whether a mixture beats a level.
    """
    quality = [_psnr(measured, j, level.quality) for j, level in enumerate(measured.levels)]
    sizes = [measured.bytes_of(measured.rung_files(level.quality, j)) for j, level in enumerate(measured.levels)]
    better = _find_better(quality, sizes)
    lower = [j for j in better if j > 0]
    if lower:
        return _drop(attempt.settings, {j: better[j] for j in lower}, quality)
    if 0 not in better or quality[better[0]] <= quality[0]:
        return _drop_idle(attempt.settings, measured, unsure)
    expected = attempt.expected or ExpectedError(steps=squared_error(quality[better[0]]))
    beyond = BLAME * max(0.0, squared_error(quality[0]) - expected.total)
    return _take_back(attempt, encoded, expected, beyond) or _drop(attempt.settings, better, quality)


def _drop(settings: EncodeSettings, better: Mapping[int, int], quality: Sequence[float]) -> Repair:
    """Do without the levels that others beat, each by the one that `better` names."""
    stories = [
        f"L{j} dropped: L{k} takes no more bytes and has {quality[k]:.2f} dB against {quality[j]:.2f} dB"
        for j, k in better.items()
    ]
    return Repair(_without(settings, list(better)), "; ".join(stories))


def _drop_idle(settings: EncodeSettings, m: Manifest, unsure: float) -> Repair | None:
    """Do without levels that would have no rung on the ladder if all of them showed more: IDLE_DB, or the top's doubt.

    Nor on that of rungs in their own key quality alone, which more pictures measure. A level stays with which a key
    quality would go that is on the ladder.
    """
    if math.isinf(unsure):
        return None
    more = max(IDLE_DB, doubt_db(unsure))
    rungs = list(itertools.product(range(len(m.qualities)), range(len(m.levels))))
    own = [(level.quality, j) for j, level in enumerate(m.levels)]
    known = {(q, j): (m.bytes_of(m.rung_files(q, j)), _psnr(m, j, q)) for q, j in rungs}

    def best(some: Sequence[tuple[int, int]], raised: int | None = None) -> set[tuple[int, int]]:
        shown = [(known[q, j][0], known[q, j][1] + more * (j == raised)) for q, j in some]
        return {rung for rung, there in zip(some, on_ladder(shown), strict=True) if there}

    idle = {j for j in range(1, len(own)) if not any(rung[1] == j for some in (rungs, own) for rung in best(some, j))}
    needed = {q for q, _ in best(rungs)} - {q for q, j in own if j not in idle}
    idle -= {j for q, j in own if q in needed}
    names = ", ".join(f"L{j}" for j in sorted(idle))
    story = f"{names} dropped: mixtures of other rungs show {more:.1f} dB more for as many bytes"
    return Repair(_without(settings, sorted(idle)), story) if idle else None


def _find_better(quality: Sequence[float], sizes: Sequence[int]) -> dict[int, int]:
    """For each level that is beaten, the best of those that show no less for no more bytes; the first of equal ones."""
    found: dict[int, int] = {}
    for j, (shown, size) in enumerate(zip(quality, sizes, strict=True)):
        others = [k for k in range(len(sizes)) if sizes[k] <= size and (quality[k], -sizes[k], -k) > (shown, -size, -j)]
        if others:
            found[j] = max(others, key=lambda k: quality[k])
    return found


def _psnr(m: Manifest, level: int, quality: int) -> float:
    pooled = pooled_quality(m, level, quality)
    assert pooled is not None
    return pooled.psnr


def _without(settings: EncodeSettings, beaten: Sequence[int]) -> EncodeSettings:
    """The settings without these levels, and without the key qualities that no other level has."""
    levels = [v for j, v in enumerate(settings.levels) if j not in beaten]
    used = sorted({v.quality for v in levels})
    levels = [replace(v, quality=used.index(v.quality)) for v in levels]
    return replace(settings, levels=tuple(levels), key_factors=tuple(settings.key_factors[q] for q in used))


def _take_back(attempt: Attempt, encoded: Encoded, expected: ExpectedError, beyond: float) -> Repair | None:
    """Less left out or fewer updates withheld, whichever makes more error than is expected of it; None: neither.

    `beyond` is the error that is taken besides.
    """
    settings = attempt.settings
    rows, held = _part_errors(attempt, encoded)
    if rows - expected.rows > beyond and rows - expected.rows >= held - expected.held:
        fewer = replace(settings, steps=replace(settings.steps, rows=settings.steps.rows / 2))
        return Repair(fewer, f"Gaussians left out {_cost(rows, expected.rows)}: fewer are")
    if held - expected.held > beyond:
        pruned = settings.levels[0].pruned
        part = 0.5 if pruned > 0.1 else 0.0
        levels = (replace(settings.levels[0], pruned=part * pruned), *settings.levels[1:])
        shares = tuple((factor, part * share) for factor, share in settings.shares)  # at other qualities as well
        keep_all = pruned == 0  # nothing was withheld: rows held to be static are to blame
        fixed = replace(settings, levels=levels, shares=shares, keep_all=settings.keep_all or keep_all)
        return Repair(fixed, f"updates withheld {_cost(held, expected.held)}: fewer are")
    return None


def _cost(error: float, expected: float) -> str:
    return f"cost {psnr(error):.1f} dB" + (f" where {psnr(expected):.1f} dB were expected" if expected else "")


def _part_errors(attempt: Attempt, encoded: Encoded) -> tuple[float, float]:
    """Mean squared error of pictures without the rows left out, and with updates of the top level withheld."""
    errors: list[tuple[float, float]] = []
    groups = attempt.prepared
    cameras = iter(draw_views(groups.views.region, CHECKED, CHECKING))
    picked = evenly_spaced(len(groups), CHECKED)
    for i in picked:
        span = groups.spans[i]
        frames = groups.sequence.load(range(span.start, span.stop)).frames
        places = evenly_spaced(len(frames), max(1, CHECKED // len(picked)))
        views = list(zip(places, cameras, strict=False))
        errors += _errors_of_group(encoded.group(i), frames, views, groups.views.renderer)
    rows, held = np.mean(errors, axis=0)
    return float(rows), float(held)


def _errors_of_group(
    coded: GroupFiles, frames: Sequence[Gaussians], views: Sequence[View], renderer: Renderer
) -> Iterator[tuple[float, float]]:
    """Give the errors of `_part_errors` for each view of a group; views count its frames from 0."""
    canonical, rows, static = mean_frame(frames), np.sort(coded.rows), coded.rows[coded.depths == STATIC]
    whole = draw_once(draw_frames(frames.__getitem__, renderer))
    parts = (lambda place: frames[place].take(rows)), (lambda place: _held(frames[place], canonical, static))
    fewer, held = (compare(whole, draw_frames(part, renderer), views, Picture.mse) for part in parts)
    return zip(fewer, held, strict=True)


def _held(g: Gaussians, canonical: Gaussians, rows: NDArray[np.intp]) -> Gaussians:
    """A frame whose rows `rows` show the canonical frame."""
    stays = np.ones(len(g), bool)
    stays[rows] = False
    return mix_rows(g, canonical, stays)
