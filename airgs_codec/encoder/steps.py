"""The quantiser steps and the pruning levels that one scene asks for, found by small encodes of a sample of one group.

A step is worth halving while that lowers the error of pictures by more than its bytes would elsewhere: Lagrange's
condition with one multiplier for all choices (Everett 1963), here the price of a byte in squared error. N Gaussians of
the group, n of the sample.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.importance import pooled_error
from airgs_codec.analysis.sensitivity import CODING_VARIANCE
from airgs_codec.coding.channels import delta_channels
from airgs_codec.coding.kernels import row_chunks
from airgs_codec.coding.motion import (
    LEAVES,
    StepSettings,
    channel_weights,
    get_step,
    scale_steps,
    with_step,
    withheld_error,
)
from airgs_codec.encoder.layout import GroupLayout, assign_depths, lay_out, rank_updates
from airgs_codec.encoder.sample import CalibrationSample, Cost, block_rows
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings, Shares
from airgs_codec.encoder.survey import Frames, Survey
from airgs_codec.encoder.views import SceneViews
from airgs_codec.errors import SceneError
from airgs_codec.media.metrics import Picture
from airgs_codec.package.layout import DELTA
from airgs_codec.package.tables import DELTA_ATTRIBUTES, KEYFRAME_ATTRIBUTES
from airgs_codec.render.compare import compare, draw_frames, draw_once
from airgs_codec.scene.frames import turn_least
from airgs_codec.scene.gaussians import Gaussians, mix_rows

SAMPLE_BLOCKS = 150  # of rows, over all frames of the sample together
FEWEST_BLOCKS = 5  # in a frame
SAMPLE_FRAMES = 32
LEAK = 0.3  # share of CODING_VARIANCE that a channel gets from its neighbours when nothing in it is worth coding

SLOPE = 0.5  # of the bytes: what steps e times as large save, of fox and spinach
TRIAL = 1.5  # factor between the two steps at which bytes and error are measured
PRIOR = 0.02  # share of all bytes and error that every step has at least: a step without effect hardly moves
# The attribute whose planes are coded anew when a step changes.
STEP_CHANNELS = {
    **{f"keyframe.{name}": "colour" if name.startswith("sh_") else name for name in KEYFRAME_ATTRIBUTES},
    "grid": "means",
    **{f"delta.{name}": "colour" if name.startswith("sh_") else name for name in DELTA_ATTRIBUTES},
}
# m: bytes saved by a step e times as large; b: the error of a step f times as large is b f^2
Slope = tuple[float, float]
# Of each level: the factor on every step, its keyframe quality. A rung costs what a package with only that rung would:
# all steps grow alike, and with their square the price of a byte.
LADDER = ((1.0, 0), (2.0, 1), (4.0, 1), (14.0, 2))
TIERS = (0.6, 0.25, 0.15)  # of the rows: each has its own keyframe steps. More cost more positions than they save steps
FACTORS = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)  # on the steps, for which a share is chosen
SHARES = (0.0, 0.2, 0.4, 0.6, 0.75, 0.87)  # of the updates that a level withholds, tried


@dataclass(frozen=True, slots=True, eq=False)
class TrialGroup:
    """The group that trial encodes are made of, laid out at quality 1."""

    frames: Sequence[Gaussians]  # all of the group, with all input rows
    layout: GroupLayout
    survey: Survey
    settings: EncodeSettings

    @staticmethod
    def of(frames: Frames, survey: Survey, views: SceneViews, settings: EncodeSettings) -> TrialGroup:
        loaded = turn_least(frames.sequence.load(range(frames.start, frames.stop)))
        written = survey.needed(settings.row_error if views.trusted else None)
        return TrialGroup(loaded.frames, lay_out(loaded, frames, survey, written, views, settings), survey, settings)

    def sample(self, fps: float) -> CalibrationSample:
        """Return blocks spread over all rows, in the frames of the first segment: P and B pictures settle in them."""
        layout, settings = self.layout, self.settings
        segment = min(len(self.frames), SAMPLE_FRAMES, max(1, int(settings.segment_s * fps)))
        index = block_rows(len(layout.rows), max(FEWEST_BLOCKS, SAMPLE_BLOCKS // segment))
        index = index[layout.wider[index] == 0]  # what is far from all else tells nothing of it
        sample = CalibrationSample(
            index=index,
            keyframe=layout.keyframe.take(index),
            frames=[frame.take(layout.rows[index]) for frame in self.frames[:segment]],
            classes=layout.classes[index],
            sensitivity=layout.sensitivity.take(index),
            moving=np.ones(len(index), bool),
            factors=np.array(layout.factors)[layout.tiers[index]],
            row_ratio=len(layout.rows) / len(index),
            group_frames=len(self.frames),
            segment_frames=segment,
        )
        deltas = sample.deltas(sample.code_keyframe(settings.steps, 1.0)[1], settings.steps)
        near = np.abs(deltas).max(axis=(0, 1)) <= LEAVES  # nor does what goes there
        sample, deltas = sample.take(near), deltas[:, :, near]
        weights = channel_weights(
            sample.classes, sample.sensitivity.by_attribute(), layout.delta_steps, layout.transform
        )
        moving = np.abs(deltas[1:] - deltas[0]).max(axis=(0, 1)) > 0.5
        if not settings.keep_all:  # steps are solved for rows of which coding repairs more error than it adds
            variance = np.square(deltas[1:]).mean(axis=0, keepdims=True)
            added = np.minimum(variance + LEAK * np.maximum(CODING_VARIANCE - variance, 0), CODING_VARIANCE)
            moving &= withheld_error(deltas[1:], weights) > withheld_error(np.sqrt(added), weights)
        return replace(sample, moving=moving).with_slopes(deltas, settings.steps)


def solve_steps(sample: CalibrationSample, subject: TrialGroup) -> tuple[StepSettings, float, float]:
    """Return steps of one price that together make the error that `subject.settings.steps` make, the price, and the
    bytes a frame that they save, by the slopes. Raises SceneError as `balance`.
    """
    slopes = measure_slopes(sample, subject)
    factors, price = balance(slopes)
    saved = sum(slopes[name][0] * float(np.log(factor)) for name, factor in factors.items())
    return scale_steps(subject.settings.steps, factors), price, saved


def balance(slopes: Mapping[str, Slope]) -> tuple[dict[str, float], float]:
    """Return a factor on every step, and the price of a byte; no factors and 0 where no bytes or no error depend on
    steps.

    Bytes fall with the logarithm of a step, at m; its error is b times its square. With factors f, sum b f^2 stays and
    bytes are least where f^2 = (m / sum m) / (b / sum b); a byte then costs 2 sum b / sum m. PRIOR keeps factors
    within sqrt((1 + PRIOR) / PRIOR), 7.1, of 1. Raises SceneError for slopes that are not finite.
    """
    for name, slope in slopes.items():
        if not np.isfinite(slope).all():
            raise SceneError(f"calibration: expected finite bytes and errors of {name}, got {slope[0]:g}, {slope[1]:g}")
    known = {name: (max(m, 0.0), max(b, 0.0)) for name, (m, b) in slopes.items()}
    rate, error = sum(m for m, _ in known.values()), sum(b for _, b in known.values())
    if rate == 0 or error == 0:
        return {}, 0.0
    shares = {name: (m / rate + PRIOR, b / error + PRIOR) for name, (m, b) in known.items()}
    return {name: (m / b) ** 0.5 for name, (m, b) in shares.items()}, 2 * error / rate


def guess_price(sample: CalibrationSample, subject: TrialGroup) -> float:
    """Return the price of a byte at the steps of `subject.settings`, from one trial encode.

    Error grows with the square of the steps, bytes fall with their logarithm at about SLOPE of what they are.
    """
    cost = sample.cost(subject.settings.steps)
    return 2 * (cost.keyframe_error + cost.delta_error + subject.layout.removal_error) / (SLOPE * cost.bytes)


def measure_slopes(sample: CalibrationSample, subject: TrialGroup) -> dict[str, Slope]:
    """Slopes of every step, and of what leaving out rows may err where some are."""
    slopes = measure_step_slopes(sample, subject.settings.steps, subject.settings.threads)
    return slopes if subject.layout.removal_error == 0 else {**slopes, "rows": _row_slope(sample, subject)}


def measure_step_slopes(sample: CalibrationSample, steps: StepSettings, threads: int) -> dict[str, Slope]:
    """Slopes of every step of quantisers, from trial encodes a factor TRIAL finer and coarser."""
    names = [n for n in STEP_CHANNELS if sample.keyframe.sh_rest.shape[1] or not n.endswith("sh_rest")]

    def trial(name: str, factor: float) -> Cost:
        return sample.cost(with_step(steps, name, get_step(steps, name) * factor), (STEP_CHANNELS[name],))

    with ThreadPoolExecutor(threads) as pool:
        finer = list(pool.map(trial, names, itertools.repeat(1 / TRIAL)))
        coarser = list(pool.map(trial, names, itertools.repeat(TRIAL)))
    slopes: dict[str, Slope] = {}
    for name, was, now in zip(names, finer, coarser, strict=True):
        grows = now.delta_error - was.delta_error + now.keyframe_error - was.keyframe_error
        slopes[name] = (was.bytes - now.bytes) / np.log(TRIAL**2), grows / (TRIAL**2 - TRIAL**-2)
    return slopes


def _row_slope(sample: CalibrationSample, subject: TrialGroup) -> Slope:
    """Return the slope of the error that leaving out rows may make, from what about TRIAL times as much saves.

    How much more it is follows from the errors that were found, which lie below what was allowed; how many Gaussians
    go, from the whole group: the few blocks of a sample have too few of the least important ones to count.
    """
    rows, error = subject.layout.rows, subject.layout.removal_error
    remaining = subject.survey.needed(subject.settings.steps.rows * TRIAL)
    left = np.isin(rows, remaining.rows)
    gone, sampled = 1 - left.mean(), 1 - left[sample.index].mean()
    if sampled == 0 or remaining.error <= error:
        return 0.0, 0.0
    steps, few = subject.settings.steps, sample.take(left[sample.index])
    saved = (sample.cost(steps).bytes - few.cost(steps).bytes) * gone / sampled
    return 2 * saved / np.log(remaining.error / error), error


def choose_levels(
    sample: CalibrationSample, subject: TrialGroup, steps: StepSettings, price: float
) -> tuple[LevelSettings, ...]:
    """Return the levels of LADDER, which withhold nothing yet, each with as many keyframe tiers as are worth their
    bytes to it.

    What pictures miss without the others is rendered. `price` is that of a byte a frame at factor 1.
    """
    layout, pruning = subject.layout, subject.survey.pruning
    counts = range(1, len(layout.factors) + 1)
    own = layout.tiers
    missing = [pruning.error_of(int((own < count).sum())) for count in counts] if layout.removal_error > 0 else []
    parts = [sample.take(own[sample.index] < count) for count in counts]
    most = len(layout.factors)
    levels: list[LevelSettings] = []
    for factor, quality in LADDER:
        if levels and missing:
            sizes = [part.code_keyframe(steps, factor)[0] for part in parts[:most]]
            costs = [error + factor**2 * price * size for error, size in zip(missing, sizes, strict=False)]
            most = 1 + int(np.argmin(costs))
        levels.append(LevelSettings(0.0, factor, most, quality))
    return tuple(levels)


def keyframe_factors() -> tuple[float, ...]:
    """Return the factor of each keyframe quality: the geometric mean of its levels' factors, to four digits."""
    qualities = sorted({quality for _, quality in LADDER})
    means = [np.exp(np.mean([np.log(f) for f, q in LADDER if q == quality])) for quality in qualities]
    return tuple(float(f"{mean:.4g}") for mean in means)


@dataclass(frozen=True, slots=True, eq=False)
class Withholding:
    """The errors that withholding updates would make in pictures of a group."""

    score: NDArray[np.float64]  # (N,) of updates, the least one is withheld first
    errors: tuple[float, ...]  # rendered, of withholding each of SHARES of the updates, and those of static rows

    @staticmethod
    def of(subject: TrialGroup) -> Withholding:
        """Rank the updates of all rows and render without the lowest ones."""
        canonical, rows, pictures = subject.layout.keyframe, subject.layout.rows, subject.layout.pictures
        frames = [subject.frames[t].take(rows) for t, _ in pictures]
        score, moving = _rank(subject, [canonical, *frames])
        depths = assign_depths(score, moving, SHARES)
        views = [(i, camera) for i, (_, camera) in enumerate(pictures)]
        renderer = subject.layout.renderer
        whole = draw_once(draw_frames(frames.__getitem__, renderer))

        def error(share: int) -> float:
            updated = moving & (depths >= share)
            held = draw_frames(lambda i: mix_rows(frames[i], canonical, updated), renderer)
            return pooled_error(list(compare(whole, held, views, Picture.mse)))

        return Withholding(score, tuple(error(share) for share in range(len(SHARES))))

    def sent(self, sample: CalibrationSample, share: float) -> NDArray[np.bool_]:
        """Return (n,) moving rows of a sample whose updates are not among the `share` withheld."""
        sent: NDArray[np.bool_] = sample.moving & (assign_depths(self.score[sample.index], sample.moving, [share]) == 0)
        return sent


def choose_shares(
    sample: CalibrationSample,
    withholding: Withholding,
    steps: StepSettings,
    price: float,
    factors: Sequence[float],
    threads: int,
) -> Shares:
    """Find the cheapest share of the updates to withhold at each of `factors` on `steps`; empty if nothing moves.

    `price` is that of a byte a frame at factor 1, in squared error; `threads` trial encodes run at a time.
    """
    if not sample.moving.any():
        return ()
    deltas = sample.deltas(sample.code_keyframe(steps, 1.0)[1], steps)
    still = sample.error(deltas[0][None], steps)
    sent = [withholding.sent(sample, share) for share in SHARES]
    with ThreadPoolExecutor(threads) as pool:
        coded = dict(zip(factors, pool.map(lambda factor: sample.code_deltas(deltas, factor), factors), strict=True))
        whole = coded[1.0][0]
        if whole == 0:  # no channel has a plane
            return ()
        parts = list(pool.map(lambda rows: replace(sample, moving=rows).code_deltas(deltas, 1.0)[0] / whole, sent))
    shares, least = [], 0.0
    for factor, (size, error) in sorted(coded.items()):
        shown = [float(np.where(rows, sample.error(error, steps), still * factor**2).sum()) for rows in sent]
        costs = [
            held + steps_error + factor**2 * price * part * size
            for held, steps_error, part in zip(withholding.errors, shown, parts, strict=True)
        ]
        least = max(least, SHARES[int(np.argmin(costs))])
        shares.append((factor, least))
    return tuple(shares)


def _rank(subject: TrialGroup, frames: Sequence[Gaussians]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Rank the updates of all N Gaussians; `frames` are the canonical one and those that are ranked."""
    layout, rank = subject.layout, subject.settings.update_rank
    base = layout.canonical_space(layout.keyframe_values().astype(np.float32), np.zeros(len(layout.codes), np.uint8))
    steps = DELTA.steps(layout.delta_steps, layout.colours)[:, None]
    score, moving = np.empty(len(layout.rows)), np.empty(len(layout.rows), bool)
    for rows in row_chunks(len(layout.rows), len(frames) * len(steps)):
        deltas = delta_channels([frame.take(rows) for frame in frames], base.take(rows), layout.delta_steps) / steps
        score[rows], moving[rows] = rank_updates(layout, rows, deltas[1:] - deltas[0], rank)
    return score, moving


@dataclass(frozen=True, slots=True)
class FoundSteps:
    """What a scene asks for."""

    settings: EncodeSettings  # nothing is left to choose in them
    sloped: bool  # segments have slopes
    saved: float  # bytes a frame of the top level that the steps save at equal error, by the slopes of the trials


def find_steps(frames: Frames, survey: Survey, views: SceneViews, settings: EncodeSettings) -> FoundSteps:
    """Find steps and, where the settings ask for them, pruning levels, on one group; at quality 1, from their steps on.

    Which share of the updates the top level withholds is estimated first, since the delta bytes that steps are solved
    for depend on it. Raises SceneError for a group that cannot be coded.
    """
    ladder = settings.calibrate == "ladder"
    tiers = TIERS if ladder else settings.tiers
    once = replace(settings, quality=1.0, calibrate="none", tiers=tiers)
    subject = TrialGroup.of(frames, survey, views, once)
    sample, withholding = subject.sample(float(frames.sequence.fps)), Withholding.of(subject)
    top = sample
    if ladder:
        guess = guess_price(sample, subject)
        shares = choose_shares(sample, withholding, settings.steps, guess, (1.0,), settings.threads)
        top = replace(sample, moving=withholding.sent(sample, shares[0][1])) if shares else sample
    steps, price, saved = solve_steps(top, subject)
    chosen = replace(settings, calibrate="none", steps=steps, byte_price=price)
    if ladder:
        shares = choose_shares(sample, withholding, steps, price, FACTORS, settings.threads)
        levels = choose_levels(top, subject, steps, price) if shares else (LevelSettings(0.0),)
        factors = keyframe_factors() if shares else (1.0,)
        chosen = replace(chosen, levels=levels, tiers=TIERS, keyframe_factors=factors, shares=shares)
    return FoundSteps(chosen.at(settings.quality), sample.sloped, saved)
