"""How a group is coded, before anything of it is: rows, tiers, order, steps, grid, colour transform, segments.

T frames and N rows of a group that are written, n rows of a key tier, C colour channels.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import middle_frames
from airgs_codec.analysis.importance import RowPruning, WrittenRows
from airgs_codec.analysis.sensitivity import Sensitivity
from airgs_codec.coding.channels import Canonical, colour_transform, dequantise_key, key_channels
from airgs_codec.coding.motion import channel_weights, classify_motion, share_class, withheld_error
from airgs_codec.coding.sidecar import KeySidecar, fit_grid, grid_codes
from airgs_codec.encoder.settings import DEFAULT_TIERS, EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, Pictures, ShownPictures, Survey
from airgs_codec.package.layout import KEY, STATE, Layout
from airgs_codec.package.tables import STATIC, Grid, KeySteps, StateSteps, difference_steps
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.frames import Repaired
from airgs_codec.scene.gaussians import Gaussians, mean_frame

MOST_FACTOR = 3.0  # of a tier on key steps, times the least of any
MOTION_FRAMES = 4  # that tell whether rows move together


def assign_tiers(usage: NDArray[np.float64], shares: Sequence[float] = DEFAULT_TIERS) -> NDArray[np.uint8]:
    """(N,) tier of each row: the rows with the highest `usage` (N,) are in the first tier, ties by row.

    Tiers hold `shares` of the rows, which sum to 1. The first has at least one row, since some levels have no other.
    """
    order = np.argsort(-usage, kind="stable")
    bounds = np.maximum(np.rint(np.cumsum(shares) * len(usage)), 1).astype(np.intp)
    tiers = np.empty(len(usage), np.uint8)
    tiers[order] = np.searchsorted(bounds[:-1], np.arange(len(usage)), side="right")
    return tiers


def assign_depths(
    score: NDArray[np.float64],
    moving: NDArray[np.bool_],
    pruned: Sequence[float],
    tiers: NDArray[np.uint8] | None = None,
    level_tiers: Sequence[int] = (),
) -> NDArray[np.uint8]:
    """(N,) deepest level that carries each row; STATIC for rows that no level carries.

    Level j withholds the share `pruned[j]` of the `moving` rows, those with the lowest `score` (the paper prunes by
    usage frequency). Where `tiers`, the (N,) tier of each row, is given, it also withholds all rows outside of the
    first `level_tiers[j]` tiers. Shares that ascend and tiers that descend make levels nested.
    """
    rows = np.flatnonzero(moving)
    ranked = rows[np.argsort(-score[rows], kind="stable")]
    depths = np.full(len(score), STATIC, np.uint8)
    for level, share in enumerate(pruned):
        carried = ranked[: round((1 - share) * len(ranked))]
        depths[carried if tiers is None else carried[tiers[carried] < level_tiers[level]]] = level
    return depths


@dataclass(frozen=True, slots=True, eq=False)
class RowUsage:
    """How much views use the rows of a group, for ranking updates by it."""

    score: NDArray[np.float64]  # (N,) usage, by the measure that ranks rows for key tiers
    hits: NDArray[np.float64]  # (N,) pixels where a row is blended: the paper's usage frequency

    def take(self, rows: NDArray[np.intp] | slice) -> RowUsage:
        return RowUsage(self.score[rows], self.hits[rows])

    def rank(self, name: str, changes: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) score of updates: "hits" alone as in the paper, or "usage" x size of the change.

        `changes` (T, 10 + C, N) are differences to the canonical frame, in steps.
        """
        if name == "hits":
            return self.hits
        return self.score * np.sqrt(np.einsum("tcn,tcn->n", changes, changes) / len(changes))


def rank_updates(
    changes: NDArray[np.float64], weights: NDArray[np.float64], usage: RowUsage | None = None, rank: str = "error"
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N,) scores that rank updates for pruning, and (N,) whether a row ever changes by half a step, or is static.

    `changes` (T, 10 + C, N) are differences to the canonical frame, in steps; `weights` (10 + C, N) are the squared
    error of pictures for a squared step. The score is the error expected of withholding the updates of a row, or, where
    `rank` is another one than "error", that of its `usage`.
    """
    score = withheld_error(changes, weights) if usage is None or rank == "error" else usage.rank(rank, changes)
    return score, np.abs(changes).max(axis=(0, 1)) > 0.5


@dataclass(frozen=True, slots=True, eq=False)
class GroupLayout:
    """Everything that is decided about a group from its canonical frame. Arrays hold rows in file order."""

    span: GroupSpan
    pictures: Pictures  # a few, to render what may be left out: place of a frame in the group, view
    segments: tuple[tuple[int, int], ...]  # frames [start, stop) of the sequence
    count: int  # input rows after repairs
    notes: tuple[str, ...]  # repairs
    removal_error: float  # mean squared error of pictures without the rows left out
    rows: NDArray[np.intp]  # (N,) input rows
    key: Gaussians  # N rows: the canonical frame, the mean of all frames, which the key codes
    tiers: NDArray[np.uint8]  # (N,) tier of each row, ascending
    factors: tuple[float, ...]  # of each tier, on the key steps
    codes: NDArray[np.uint64]  # (N,) Morton codes of the finest cells, ascending within a tier
    wider: NDArray[np.int16]  # (N,) e of the grid that a row lies in
    classes: NDArray[np.int16]  # (N,) motion classes
    usage: RowUsage
    sensitivity: Sensitivity
    grid: Grid
    key_steps: KeySteps
    state_steps: StateSteps
    transform: NDArray[np.float64]  # (C, C) KLT of the colours, as stored
    renderer: Renderer
    keeps: int | None = None  # the number, from 1, of the group that its keys are differences to
    before: Gaussians | None = None  # N rows: the canonical frame of that group

    @property
    def colours(self) -> int:
        return len(self.transform)

    def tier_rows(self, tier: int) -> slice:
        low, high = np.searchsorted(self.tiers, [tier, tier + 1])
        return slice(int(low), int(high))

    @property
    def difference_steps(self) -> StateSteps:
        """Steps of what differs from another group."""
        return difference_steps(self.key_steps, self.grid)

    def state_weights(self, rows: slice | NDArray[np.intp] = slice(None)) -> NDArray[np.float64]:
        """(10 + C, n) what a squared step in a state channel of some rows adds to the squared error of pictures."""
        return channel_weights(
            self.classes[rows], self.sensitivity.take(rows).by_attribute(), self.state_steps, self.transform
        )

    def key_weights(self) -> NDArray[np.float64]:
        """(7 + C, N) the same for the channels of a key, which has no means."""
        weights = channel_weights(self.classes, self.sensitivity.by_attribute(), self.difference_steps, self.transform)
        return weights[STATE.slice("means").stop :]

    def tier_steps(self, tier: int, layout: Layout = KEY) -> NDArray[np.float64]:
        """(c,) steps of the channels of the picture of a tier at quality factor 1; that of a difference is a STATE."""
        return layout.steps(self.difference_steps, self.colours) * self.factors[tier]

    def row_steps(self) -> NDArray[np.float64]:
        """(7 + C, N) the same of every row."""
        return np.outer(KEY.steps(self.key_steps, self.colours), np.array(self.factors)[self.tiers])

    def key_values(self) -> NDArray[np.float64]:
        """(7 + C, N) key channels."""
        return key_channels(self.key, self.transform, self.key_steps, self.grid.unit)

    def canonical_space(self, channels: NDArray[np.float32], depths: NDArray[np.uint8]) -> Canonical:
        """The canonical space that (7 + C, N) decoded key channels and (N,) depths make, with the finest positions."""
        sidecar = self.sidecar(slice(None), depths)
        return dequantise_key(channels, sidecar, self.transform, self.grid, self.key_steps)

    def sidecar(self, rows: slice, depths: NDArray[np.uint8]) -> KeySidecar:
        """Some rows with the finest positions, and of (N,) depths those of the rows."""
        return KeySidecar(self.codes[rows], self.classes[rows], self.wider[rows], depths[rows])


def lay_out(
    loaded: Repaired, survey: Survey, written: WrittenRows, settings: EncodeSettings, fps: Fraction
) -> GroupLayout:
    """Order, tiers, steps and transforms of a group: `loaded` are its frames, of which some rows are `written`."""
    steps = settings.steps.scaled(settings.quality)
    canonical = mean_frame(loaded.frames).take(written.rows)
    score = survey.score(settings.usage)
    tiers = assign_tiers(score[written.rows], settings.tiers)
    sensitivity = survey.sensitivity.take(written.rows).means
    classes = classify_motion(sensitivity, canonical, survey.scale)
    codes, _ = grid_codes(canonical.means, classes, fit_grid(canonical.means, classes, steps.grid))
    order = np.lexsort((codes, tiers))
    moving = (loaded.frames[t].means[written.rows] for t in middle_frames(0, len(loaded.frames), MOTION_FRAMES))
    changes = ((means - canonical.means)[order].T for means in moving)
    classes[order] = share_class(classes[order], sensitivity[order], changes, steps.state.means)
    grid = fit_grid(canonical.means, classes, steps.grid)
    codes, wider = grid_codes(canonical.means, classes, grid)
    order = np.lexsort((codes, tiers))
    rows = written.rows[order]
    transform = colour_transform(canonical.take(order), steps.key, steps.colours)
    layout = GroupLayout(
        span=survey.span,
        pictures=survey.checks,
        segments=split_segments(survey.span, settings.segment_s, fps),
        count=len(score),
        notes=tuple(loaded.notes),
        removal_error=written.error,
        rows=rows,
        key=canonical.take(order),
        tiers=tiers[order],
        factors=(1.0,) * len(settings.tiers),
        codes=codes[order],
        wider=wider[order],
        classes=classes[order],
        usage=RowUsage(score[rows], survey.usage.measure("hits")[rows]),
        sensitivity=survey.sensitivity.take(rows),
        grid=grid,
        key_steps=steps.key,
        state_steps=steps.state,
        transform=transform,
        renderer=survey.renderer,
    )
    return replace(layout, factors=tier_factors(layout.key_weights().sum(axis=0), layout.tiers, len(settings.tiers)))


def tier_factors(weights: NDArray[np.float64], tiers: NDArray[np.integer], count: int) -> tuple[float, ...]:
    """A factor on the key steps of each of `count` tiers, with which bytes are least at the error of no factors.

    `weights` (N,) are the errors that a squared step makes in the rows. Where steps are small against values, bytes
    fall with the logarithm of a factor and error grows with its square, so that all tiers should err alike: factor^2
    is the mean weight of all rows over that of the tier (reverse water-filling; Cover and Thomas, Elements of
    Information Theory, 10.3.3). No factor is more than MOST_FACTOR times another: what the given views hardly see may
    be seen from others, and coarse steps err by more than their square.
    """
    rows = np.bincount(tiers, minlength=count)
    sums = np.bincount(tiers, weights=weights, minlength=count)
    total = float(sums.sum())
    if total == 0:
        return (1.0,) * count
    means = sums / np.maximum(rows, 1)
    wanted = np.sqrt(total / rows.sum() / np.maximum(means, means.max() / MOST_FACTOR**2))
    error = float(sums @ wanted**2)
    return tuple(float(f"{factor:.3g}") for factor in wanted * (total / error) ** 0.5)


def prune_rows(frames: Sequence[Gaussians], survey: Survey) -> RowPruning:
    """Pruning of a group's rows by what some of its pictures show; `frames` are all of the group."""
    return RowPruning(ShownPictures(frames, survey.checks), survey.importance, survey.removals, survey.renderer)


def keep_rows(frames: Sequence[Gaussians], survey: Survey, allowed: float | None) -> WrittenRows:
    """Rows of a group that are written: those that pictures cannot do without, or all.

    `allowed` is as in `EncodeSettings.row_error`.
    """
    if allowed is None or not survey.trusted:
        return WrittenRows.all(len(frames[0]))
    pruning = prune_rows(frames, survey)
    return pruning.with_details(pruning.within(allowed), allowed)


def split_segments(span: GroupSpan, segment_s: float, fps: Fraction) -> tuple[tuple[int, int], ...]:
    """Balanced spans [start, stop) of at most `segment_s` seconds, at least one frame each, that cover the group."""
    most = max(1, int(Fraction(segment_s).limit_denominator(1000) * fps))
    count = -(-span.frames // most)
    bounds = [span.start + i * span.frames // count for i in range(count + 1)]
    return tuple(itertools.pairwise(bounds))
