"""How a group is coded: its Gaussians, their tiers and order, steps, grid, colour transform and segments.

T frames and N written Gaussians of a group, n of a keyframe tier, C colour channels.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import middle_frames
from airgs_codec.analysis.importance import WrittenRows
from airgs_codec.analysis.sensitivity import Sensitivity
from airgs_codec.coding.channels import Canonical, colour_transform, dequantise_keyframe, keyframe_channels
from airgs_codec.coding.motion import channel_weights, classify_motion, share_class, withheld_error
from airgs_codec.coding.sidecar import KeyframeSidecar, fit_grid, grid_codes
from airgs_codec.encoder.settings import DEFAULT_TIERS, EncodeSettings
from airgs_codec.encoder.survey import Frames, Span, Survey
from airgs_codec.encoder.views import Pictures, SceneViews
from airgs_codec.package.layout import DELTA, KEYFRAME, Layout
from airgs_codec.package.tables import STATIC, DeltaSteps, Grid, KeyframeSteps, difference_steps
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.frames import Repaired
from airgs_codec.scene.gaussians import Gaussians, mean_frame

MOST_FACTOR = 3.0  # of a tier on keyframe steps, times the least of any
MOTION_FRAMES = 4  # that tell whether Gaussians move together
COARSER = 1.5  # times as coarse for a group as for its base may the motion classes of that be


@dataclass(frozen=True, slots=True, eq=False)
class GroupLayout:
    """Everything that is decided about a group from its canonical frame. Arrays are in the order of its files."""

    number: int  # of the group, from 1
    span: Span
    pictures: Pictures  # a few, to render what may be left out: place of a frame in the group, view
    segments: tuple[Span, ...]
    count: int  # Gaussians of the input after repairs
    notes: tuple[str, ...]  # repairs
    removal_error: float  # mean squared error of pictures without the Gaussians left out
    rows: NDArray[np.intp]  # (N,) of the input
    keyframe: Gaussians  # N: the canonical frame, the mean of all frames, which the keyframe codes
    tiers: NDArray[np.uint8]  # (N,) ascending
    factors: tuple[float, ...]  # of each tier, on the keyframe steps
    codes: NDArray[np.uint64]  # (N,) Morton codes of the finest cells, ascending within a tier
    wider: NDArray[np.int16]  # (N,) e of the grid that a Gaussian lies in
    classes: NDArray[np.int16]  # (N,) motion classes
    score: NDArray[np.float64]  # (N,) what ranks Gaussians for keyframe tiers
    hits: NDArray[np.float64]  # (N,) pixels where a Gaussian is blended: the paper's usage frequency
    sensitivity: Sensitivity
    grid: Grid
    keyframe_steps: KeyframeSteps
    delta_steps: DeltaSteps
    transform: NDArray[np.float64]  # (C, C) KLT of the colours, as stored
    renderer: Renderer
    base: int | None = None  # the number, from 1, of the group that its keyframe is coded against
    before: Gaussians | None = None  # N: the canonical frame of that group

    @property
    def colours(self) -> int:
        return len(self.transform)

    @property
    def frames(self) -> int:
        return self.span[1] - self.span[0]

    @property
    def local_segments(self) -> list[slice]:
        """Return the frames of each segment, counted from the start of the group."""
        return [slice(start - self.span[0], stop - self.span[0]) for start, stop in self.segments]

    def tier_rows(self, tier: int) -> slice:
        low, high = np.searchsorted(self.tiers, [tier, tier + 1])
        return slice(int(low), int(high))

    @property
    def difference_steps(self) -> DeltaSteps:
        return difference_steps(self.keyframe_steps, self.grid)

    def delta_weights(self, rows: slice | NDArray[np.intp] = slice(None)) -> NDArray[np.float64]:
        """Return (10 + C, n) what a squared step in a delta channel adds to the squared error of pictures."""
        sensitivity = self.sensitivity.take(rows).by_attribute()
        return channel_weights(self.classes[rows], sensitivity, self.delta_steps, self.transform)

    def keyframe_weights(self) -> NDArray[np.float64]:
        """Return (7 + C, N) the same of the channels of a keyframe, which has no means."""
        weights = channel_weights(self.classes, self.sensitivity.by_attribute(), self.difference_steps, self.transform)
        return weights[DELTA.slice("means").stop :]

    def tier_steps(self, tier: int, layout: Layout = KEYFRAME) -> NDArray[np.float64]:
        """Return (c,) steps of the picture of a tier at quality factor 1; that of a difference is a DELTA."""
        return layout.steps(self.difference_steps, self.colours) * self.factors[tier]

    def keyframe_values(self) -> NDArray[np.float64]:
        return keyframe_channels(self.keyframe, self.transform, self.keyframe_steps, self.grid.unit)

    def canonical_space(self, channels: NDArray[np.float32], depths: NDArray[np.uint8]) -> Canonical:
        """Return the canonical space of (7 + C, N) decoded channels and (N,) depths, with the finest positions."""
        sidecar = self.sidecar(slice(None), depths)
        return dequantise_keyframe(channels, sidecar, self.transform, self.grid, self.keyframe_steps)

    def sidecar(self, rows: slice, depths: NDArray[np.uint8] | None = None) -> KeyframeSidecar:
        """Return some Gaussians with the finest positions, and their depths, of (N,); without these all are static."""
        deep = np.full(len(self.codes), STATIC, np.uint8) if depths is None else depths
        return KeyframeSidecar(self.codes[rows], self.classes[rows], self.wider[rows], deep[rows])


def lay_out(
    loaded: Repaired, frames: Frames, survey: Survey, written: WrittenRows, views: SceneViews, settings: EncodeSettings
) -> GroupLayout:
    """Decide order, tiers, steps and transforms of a group; of its frames, `loaded`, some rows are `written`."""
    steps = settings.steps.scaled(settings.quality)
    canonical = mean_frame(loaded.frames).take(written.rows)
    score = survey.score(settings.usage)
    tiers = assign_tiers(score[written.rows], settings.tiers)
    sensitivity = survey.sensitivity.take(written.rows).means
    classes = classify_motion(sensitivity, canonical, views.scale)
    codes, _ = grid_codes(canonical.means, classes, fit_grid(canonical.means, classes, steps.grid))
    order = np.lexsort((codes, tiers))
    moving = (loaded.frames[t].means[written.rows] for t in middle_frames(0, len(loaded.frames), MOTION_FRAMES))
    changes = ((means - canonical.means)[order].T for means in moving)
    classes[order] = share_class(classes[order], sensitivity[order], changes, steps.delta.means)
    grid = fit_grid(canonical.means, classes, steps.grid)
    codes, wider = grid_codes(canonical.means, classes, grid)
    order = np.lexsort((codes, tiers))
    rows = written.rows[order]
    transform = colour_transform(canonical.take(order), steps.keyframe, steps.colours)
    layout = GroupLayout(
        **_of_frames(loaded, frames, views, settings),
        removal_error=written.error,
        rows=rows,
        keyframe=canonical.take(order),
        tiers=tiers[order],
        factors=(1.0,) * len(settings.tiers),
        codes=codes[order],
        wider=wider[order],
        classes=classes[order],
        score=score[rows],
        hits=survey.usage.measure("hits")[rows],
        sensitivity=survey.sensitivity.take(rows),
        grid=grid,
        keyframe_steps=steps.keyframe,
        delta_steps=steps.delta,
        transform=transform,
        renderer=survey.renderer,
    )
    factors = tier_factors(layout.keyframe_weights().sum(axis=0), layout.tiers, len(settings.tiers))
    return replace(layout, factors=factors)


def lay_out_again(
    loaded: Repaired,
    frames: Frames,
    base: GroupLayout,
    survey: Survey,
    error: float,
    views: SceneViews,
    settings: EncodeSettings,
) -> GroupLayout:
    """Lay out a group by the Gaussians of an earlier one, `base`, against which its keyframe is coded.

    `error`: mean squared error of pictures without the Gaussians that are left out.
    """
    return replace(
        base,
        **_of_frames(loaded, frames, views, settings),
        removal_error=error,
        keyframe=mean_frame(loaded.frames).take(base.rows),
        score=survey.score(settings.usage)[base.rows],
        hits=survey.usage.measure("hits")[base.rows],
        sensitivity=survey.sensitivity.take(base.rows),
        base=base.number,
        before=base.keyframe,
    )


def error_with(
    base: GroupLayout, loaded: Repaired, survey: Survey, written: WrittenRows, allowed: float | None, scale: float
) -> float | None:
    """Return the mean squared error of pictures of a group, of which some rows are `written`, with those of an earlier
    one.

    None where pictures need Gaussians that the base does not have, or need them finer: what nobody saw there has large
    motion units.
    """
    rows, error = base.rows, written.error
    if int(rows.max()) >= len(loaded.frames[0]):
        return None
    if not np.isin(written.rows, rows).all():
        if allowed is None:
            return None
        found = survey.pruning.with_details(WrittenRows(np.sort(rows), 0.0), allowed)
        if len(found.rows) > len(rows) or found.error > allowed**2:
            return None
        error = found.error
    here, there = (
        _coarseness(base.classes, sensitivity, keyframe, scale)
        for sensitivity, keyframe in (
            (survey.sensitivity.take(rows), mean_frame(loaded.frames).take(rows)),
            (base.sensitivity, base.keyframe),
        )
    )
    return None if here > COARSER * there else error


def _coarseness(classes: NDArray[np.int16], sensitivity: Sensitivity, keyframe: Gaussians, scale: float) -> float:
    """Return the squared error of pictures by means of these motion classes over that by those that views ask for."""
    asked = classify_motion(sensitivity.means, keyframe, scale)
    errors = [float(sensitivity.means @ np.exp2(2.0 * some)) for some in (classes, asked)]
    return errors[0] / errors[1] if errors[1] else 1.0


def _of_frames(loaded: Repaired, frames: Frames, views: SceneViews, settings: EncodeSettings) -> dict[str, Any]:
    """Return the fields of a layout that only depend on which frames a group has."""
    own = range(frames.start, frames.stop)
    return {
        "number": frames.number + 1,
        "span": frames.spans[0],
        "pictures": [(number - frames.start, camera) for number, camera in views.check(own)],
        "segments": split_segments(frames.spans[0], settings.segment_s, frames.sequence.fps),
        "count": len(loaded.frames[0]),
        "notes": tuple(loaded.notes),
    }


def split_segments(span: Span, segment_s: float, fps: Fraction) -> tuple[Span, ...]:
    """Split a group into balanced segments of at most `segment_s` seconds, at least one frame each."""
    start, stop = span
    most = max(1, int(Fraction(segment_s).limit_denominator(1000) * fps))
    count = -(-(stop - start) // most)
    return tuple(itertools.pairwise(start + i * (stop - start) // count for i in range(count + 1)))


def assign_tiers(usage: NDArray[np.float64], shares: Sequence[float] = DEFAULT_TIERS) -> NDArray[np.uint8]:
    """Assign N Gaussians to keyframe tiers, (N,): those with the highest `usage` (N,) to the first, ties in order.

    Tiers hold `shares` of them, which sum to 1. The first has at least one, since some levels have no other.
    """
    order = np.argsort(-usage, kind="stable")
    bounds = np.maximum(np.rint(np.cumsum(shares) * len(usage)), 1).astype(np.intp)
    tiers = np.empty(len(usage), np.uint8)
    tiers[order] = np.searchsorted(bounds[:-1], np.arange(len(usage)), side="right")
    return tiers


def tier_factors(weights: NDArray[np.float64], tiers: NDArray[np.integer], count: int) -> tuple[float, ...]:
    """Find the factors on the steps of `count` keyframe tiers with which bytes are least at the error of no factors.

    `weights` (N,) are the errors that a squared step makes in the Gaussians. Where steps are small against values,
    bytes fall with the logarithm of a factor and error grows with its square, so that all tiers should err alike:
    factor^2 is the mean weight of all over that of the tier (reverse water-filling; Cover and Thomas, Elements of
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


def assign_depths(
    score: NDArray[np.float64],
    moving: NDArray[np.bool_],
    pruned: Sequence[float],
    tiers: NDArray[np.uint8] | None = None,
    level_tiers: Sequence[int] = (),
) -> NDArray[np.uint8]:
    """Find the deepest pruning level that carries each of N Gaussians, (N,); STATIC for those that none carries.

    Level j withholds the share `pruned[j]` of those that are `moving`, the ones with the lowest `score` (the paper
    prunes by usage frequency). Where `tiers`, the (N,) tier of each, is given, it also withholds all outside of the
    first `level_tiers[j]` tiers. Shares that ascend and tiers that descend make levels nested.
    """
    rows = np.flatnonzero(moving)
    ranked = rows[np.argsort(-score[rows], kind="stable")]
    depths = np.full(len(score), STATIC, np.uint8)
    for level, share in enumerate(pruned):
        carried = ranked[: round((1 - share) * len(ranked))]
        depths[carried if tiers is None else carried[tiers[carried] < level_tiers[level]]] = level
    return depths


def rank_updates(
    layout: GroupLayout, rows: slice, changes: NDArray[np.float64], rank: str
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Rank the updates of n Gaussians for pruning, (n,), and say whether each ever changes by half a step, (n,).

    `changes` (T, 10 + C, n) are differences to the canonical frame, in steps. By `rank`, the score is the error
    expected of withholding the updates of a Gaussian ("error"), its usage times the size of its changes ("usage"), or
    the pixels where it is blended alone ("hits"), as in the paper.
    """
    if rank == "error":
        score = withheld_error(changes, layout.delta_weights(rows))
    elif rank == "hits":
        score = layout.hits[rows]
    else:
        score = layout.score[rows] * np.sqrt(np.einsum("tcn,tcn->n", changes, changes) / len(changes))
    return score, np.abs(changes).max(axis=(0, 1)) > 0.5
