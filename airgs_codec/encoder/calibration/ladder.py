"""Levels and key tiers of one scene, from small encodes of one of its groups. N rows of the group."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.importance import pooled_error
from airgs_codec.coding.channels import key_channels, state_channels
from airgs_codec.coding.chunks import row_chunks
from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.sample import CalibrationSample
from airgs_codec.encoder.calibration.subject import Subject
from airgs_codec.encoder.levels import assign_depths
from airgs_codec.encoder.rank import rank_updates
from airgs_codec.encoder.settings import LevelSettings, Shares
from airgs_codec.media.metrics import Picture
from airgs_codec.package.layout import STATE
from airgs_codec.render.compare import compare, draw_ahead, draw_frames
from airgs_codec.scene.gaussians import Gaussians, mix_rows

# Of each level: the factor on every step, its key quality, its key tiers. A rung costs what a package with only that
# rung would: all steps grow alike, and with their square the price of a byte.
LEVELS = ((1.0, 0, 3), (1.6, 1, 3), (2.3, 1, 2), (3.4, 2, 2), (4.8, 2, 1))
FACTORS = (0.1, 0.2, 0.35, 0.6, 1.0, 1.6, 2.4, 3.5, 5.0, 8.0)  # on the steps, for which a share is chosen
SHARES = (0.0, 0.2, 0.4, 0.6, 0.75, 0.87)  # of the updates that a level withholds, tried
CORES = (0.9, 0.8, 0.7, 0.6, 0.5, 0.42, 0.35, 0.28)  # of the rows, in the first key tiers together, tried


def choose_tiers(sample: CalibrationSample, subject: Subject, steps: StepSettings, price: float) -> tuple[float, ...]:
    """Share of the rows in each key tier, from the price of a byte at the top level.

    The first tiers have the rows whose keys are worth their bytes at the levels that fetch no others; what pictures
    miss without the others is rendered for some of CORES.
    """
    most = max(tiers for _, _, tiers in LEVELS)
    if subject.layout.removal_error == 0:
        return (1.0,)
    rows = len(subject.pruning.within(steps.rows).rows)
    bounds = [0.0]
    for count in range(1, most):
        factor = float(np.exp(np.mean([np.log(f) for f, _, tiers in LEVELS if tiers == count])))
        size = factor**2 * price * sample.code_key(steps, factor)[0]
        shares = [share for share in CORES if share > bounds[-1]]
        bounds.append(min(shares, key=lambda s: subject.pruning.error_of(round(s * rows)) + size * s, default=1.0))
    return tuple(stop - start for start, stop in itertools.pairwise([*bounds, 1.0]))


def make_levels(tiers: int) -> tuple[LevelSettings, ...]:
    """The levels of LEVELS, which withhold nothing yet, where there are `tiers` key tiers."""
    return tuple(LevelSettings(0.0, factor, min(count, tiers), quality) for factor, quality, count in LEVELS)


def key_factors() -> tuple[float, ...]:
    """Factors on the key steps: of each key quality the geometric mean of its levels' factors, to four digits."""
    qualities = sorted({quality for _, quality, _ in LEVELS})
    means = [np.exp(np.mean([np.log(f) for f, q, _ in LEVELS if q == quality])) for quality in qualities]
    return tuple(float(f"{mean:.4g}") for mean in means)


@dataclass(frozen=True, slots=True, eq=False)
class Withholding:
    """What withholding updates would do to the pictures of a group."""

    score: NDArray[np.float64]  # (N,) of updates, the least one is withheld first
    errors: tuple[float, ...]  # rendered, of withholding each of SHARES of the updates

    @staticmethod
    def of(subject: Subject) -> Withholding:
        """Rank the updates of all rows and render without the lowest ones."""
        canonical, rows, pictures = subject.canonical(), subject.layout.rows, subject.layout.pictures
        frames = [subject.frames[t].take(rows) for t, _ in pictures]
        score, moving = _rank(subject, [canonical, *frames])
        depths = assign_depths(score, moving, SHARES)
        views = [(i, camera) for i, (_, camera) in enumerate(pictures)]
        renderer = subject.layout.renderer
        whole = draw_ahead(draw_frames(frames.__getitem__, renderer), views)

        def error(share: int) -> float:
            updated = (moving & (depths >= share)) | ~moving
            held = draw_frames(lambda i: mix_rows(frames[i], canonical, updated), renderer)
            return pooled_error(list(compare(whole, held, views, Picture.mse)))

        return Withholding(score, (0.0, *(error(share) for share in range(1, len(SHARES)))))

    def kept(self, sample: CalibrationSample, share: float) -> NDArray[np.bool_]:
        """(n,) moving rows of a sample whose updates are not among the `share` withheld."""
        kept: NDArray[np.bool_] = sample.moving & (assign_depths(self.score[sample.index], sample.moving, [share]) == 0)
        return kept


def choose_shares(
    sample: CalibrationSample,
    withholding: Withholding,
    steps: StepSettings,
    price: float,
    factors: Sequence[float],
    jobs: int,
) -> tuple[Shares, float]:
    """The cheapest share of the updates to withhold at each of `factors` on `steps`; empty if nothing moves.

    `price` is that of a byte a frame at factor 1, in squared error. Also gives the mean squared error that factor 1
    is expected to make, but for rows that are left out. `jobs` trial encodes run at a time.
    """
    states = sample.states(sample.code_key(steps, 1.0)[1], steps)
    still = sample.error(states[0][None], steps)
    if not sample.moving.any():
        return (), float(still.sum())
    tried = sorted({1.0, *factors})
    kept = [withholding.kept(sample, share) for share in SHARES]
    with ThreadPoolExecutor(jobs) as pool:
        coded = dict(zip(tried, pool.map(lambda factor: sample.code_states(states, factor), tried), strict=True))
        whole, error = coded[1.0]
        if whole == 0:  # no channel has a plane
            return (), float(sample.error(error, steps).sum())
        fewer = pool.map(lambda rows: replace(sample, moving=rows).code_states(states, 1.0)[0], kept)
        parts = [size / whole for size in fewer]
    shares: dict[float, float] = {}
    expected, least = 0.0, 0.0
    for factor in sorted(coded):
        size, error = coded[factor]
        shown = [float(np.where(rows, sample.error(error, steps), still * factor**2).sum()) for rows in kept]
        errors = [held + e for held, e in zip(withholding.errors, shown, strict=True)]
        costs = [e + factor**2 * price * part * size for e, part in zip(errors, parts, strict=True)]
        best = int(np.argmin(costs))
        expected = errors[best] if factor == 1 else expected
        least = max(least, SHARES[best])
        shares[factor] = least
    return tuple((factor, shares[factor]) for factor in sorted(factors)), expected


def _rank(subject: Subject, frames: Sequence[Gaussians]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """`rank_updates` of all N rows; `frames` are the canonical one and those that are ranked."""
    layout, settings = subject.layout, subject.settings
    channels = key_channels(frames[0], layout.transform, layout.key_steps).astype(np.float32)
    base = layout.canonical_space(channels, np.zeros(len(layout.codes), np.uint8))
    steps = STATE.steps(layout.state_steps, layout.colours)[:, None]
    score, moving = np.empty(len(layout.rows)), np.empty(len(layout.rows), bool)
    for rows in row_chunks(len(layout.rows), len(frames) * len(steps)):
        states = state_channels([frame.take(rows) for frame in frames], base.part(rows), layout.state_steps) / steps
        weights, usage, rank = layout.state_weights(rows), layout.usage.take(rows), settings.update_rank
        changes = states[1:] - states[0]
        score[rows], moving[rows] = rank_updates(states[1:], changes, weights, usage, rank, settings.keep_all)
    return score, moving
