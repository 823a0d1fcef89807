"""All frames -> the states of every level: which rows it carries, its samples and escapes, its streams.

T frames and N rows of a group, n rows of a level, P planes, S segments. Neither the differences of all
frames to the canonical space nor the samples of all levels may fit into memory: both wait in a scratch folder.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import FURTHEST, Canonical, state_channels
from airgs_codec.encoder.level import CodedLevel, LevelCoder, StoredSamples
from airgs_codec.encoder.omit import StateOmissions, StateValues, note_static
from airgs_codec.encoder.plan import GroupLayout, assign_depths, rank_updates
from airgs_codec.encoder.representation import (
    EMPTY,
    AtlasPictures,
    Clock,
    Representation,
    encode_checked,
    encode_parallel,
)
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.h264 import ClosedGop, state_codec
from airgs_codec.package.layout import STATE
from airgs_codec.package.tables import STATIC, LeftOut
from airgs_codec.scene.gaussians import Gaussians


@dataclass(frozen=True, slots=True, eq=False)
class CodedStates:
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none
    levels: tuple[CodedLevel, ...]
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...] = ()  # what was changed so that codes hold it


def code_states(
    layout: GroupLayout,
    bases: Sequence[Canonical],
    frames: Sequence[Gaussians],
    settings: EncodeSettings,
    clock: Clock,
    scratch: Path,
) -> CodedStates:
    """Quantise the states of a group for every level; `frames` are all of the group, with all input rows.

    The states of a level are differences to the one of `bases`, the canonical space as decoded in each key quality,
    that the level corrects. A segment is fetched if anything in it differs from the original canonical frame by more
    than half a step. Samples go to files in `scratch`.
    """
    file = scratch / "values"
    values = StateValues.write(file, frames, layout.rows, bases[0], layout.state_steps)
    ranked = rank_states(layout, values, bases[0], settings)
    depths = ranked.depths(layout, settings)
    static = note_static(layout, values, depths)
    omissions = StateOmissions.of(layout, bases[0], values, depths)
    omitted, no_planes = omissions.planes(settings.scaled_price)
    levels, quality, codec = [], 0, state_codec(settings.preset)
    written = np.arange(len(layout.rows))
    for number, level in enumerate(settings.levels):
        if level.quality != quality:  # no later level carries rows that this one does not
            quality, written = level.quality, np.flatnonzero((depths != STATIC) & (depths >= number))
            base = bases[quality].part(written)
            values = StateValues.write(file, frames, layout.rows[written], base, layout.state_steps)
        steps = STATE.steps(layout.state_steps, layout.colours) * level.factor
        rows = np.flatnonzero((depths != STATIC) & (depths >= number))
        fetched = _fetched_frames(layout, ranked.largest[:, rows], level.factor / 2)
        alpha = bases[quality].opacity[rows].astype(np.float64)
        places = np.searchsorted(written, rows)
        weigh = functools.partial(_weigh, layout, rows, level.factor)
        samples = scratch / f"level {number}"
        coder = LevelCoder(values, places, alpha, steps, weigh, fetched, samples, clock, codec)
        levels.append(coder.code(omitted))
    away = int((ranked.largest.max(axis=0) >= 0.999 * FURTHEST).sum())
    span = f"frames {layout.span.start}-{layout.span.stop - 1}"
    notes = (f"{span}: {away} Gaussians go further than codes reach, and are coded nearer and as much smaller",)
    return CodedStates(depths, tuple(levels), tuple(n for n in (static, no_planes) if n), notes * bool(away))


@dataclass(frozen=True, slots=True, eq=False)
class RankedStates:
    """Rows ranked by what their changes are worth."""

    score: NDArray[np.float64]  # (N,) that ranks updates for pruning
    moving: NDArray[np.bool_]  # (N,) rows that some level may carry
    largest: NDArray[np.float64]  # (S, N) largest change of any channel from the original canonical frame, in steps

    def depths(self, layout: GroupLayout, settings: EncodeSettings) -> NDArray[np.uint8]:
        """(N,) deepest level that carries a row; STATIC: none."""
        tiers = [settings.tiers_of(level) for level in settings.levels]
        pruned = [level.pruned for level in settings.levels]
        return assign_depths(self.score, self.moving, pruned, layout.tiers, tiers)


def rank_states(layout: GroupLayout, values: StateValues, base: Canonical, settings: EncodeSettings) -> RankedStates:
    """Rank the updates of a group; `values` are differences to the decoded canonical space `base`."""
    steps = STATE.steps(layout.state_steps, layout.colours)[:, None]
    segments = [slice(start - layout.span.start, stop - layout.span.start) for start, stop in layout.segments]
    score, moving = np.empty(values.rows), np.empty(values.rows, bool)
    largest = np.empty((len(segments), values.rows))
    for rows in values.chunks():
        key = state_channels([layout.key.take(rows)], base.part(rows), layout.state_steps)[0]
        changes = (values.part(rows) - key) / steps
        usage, weights = layout.usage.take(rows), layout.state_weights(rows)
        score[rows], moving[rows] = rank_updates(changes, weights, usage, settings.update_rank)
        largest[:, rows] = [np.abs(changes[segment]).max(axis=(0, 1)) for segment in segments]
    return RankedStates(score, moving, largest)


def _weigh(layout: GroupLayout, rows: NDArray[np.intp], factor: float, some: NDArray[np.intp]) -> NDArray[np.float64]:
    """(10 + C, m) weights of squared errors of m of some rows, in steps times a factor."""
    return layout.state_weights(rows[some]) * factor**2


def _fetched_frames(layout: GroupLayout, largest: NDArray[np.float64], least: float) -> list[slice | None]:
    """For each segment its frames in the group, None where none of its (S, n) largest changes exceeds `least`."""
    parts = [slice(start - layout.span.start, stop - layout.span.start) for start, stop in layout.segments]
    return [part if (changes > least).any() else None for part, changes in zip(parts, largest, strict=True)]


def encode_states(
    layout: GroupLayout, states: CodedStates, clock: Clock, settings: EncodeSettings
) -> list[Representation]:
    """The pictures of every level, a closed GOP for each segment that is fetched."""
    codec = state_codec(settings.preset)

    def encode(level: CodedLevel) -> Representation:
        if level.samples is None:
            return EMPTY
        size = AtlasPictures.of(level.samples, level.atlas).size
        return encode_checked(_level_gops(layout, level, level.samples, clock.frame_ticks), size, clock, codec)

    return encode_parallel([functools.partial(encode, level) for level in states.levels], settings.threads)


def _level_gops(layout: GroupLayout, level: CodedLevel, samples: StoredSamples, ticks: int) -> Iterator[ClosedGop]:
    """The segments of a level that are fetched; `samples` of all frames of the group, `ticks` a frame."""
    for (start, stop), escaped, line in zip(layout.segments, level.escapes, level.lines, strict=True):
        if escaped is not None:
            shown = samples.part(start - layout.span.start, stop - layout.span.start)
            yield ClosedGop(AtlasPictures.of(shown, level.atlas), start * ticks, ticks, line)
