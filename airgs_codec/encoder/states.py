"""All frames -> the states of every level: which rows it carries, its samples and escapes, its streams.

T frames and N rows of a group, n rows of a tile in a level, P planes, S segments. Neither the differences of all
frames to the canonical space nor the samples of all levels may fit into memory: both wait in a scratch folder.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import fit_centre, make_atlas
from airgs_codec.coding.channels import LEAST_DRAWN, Canonical, hold_undrawn, state_channels
from airgs_codec.coding.escapes import Escapes
from airgs_codec.coding.quantize import to_codes
from airgs_codec.encoder.omit import StateOmissions, StateValues, note_static
from airgs_codec.encoder.plan import GroupLayout, assign_depths, rank_updates
from airgs_codec.encoder.representation import (
    EMPTY,
    AtlasPictures,
    Clock,
    ErrorModel,
    Representation,
    encode_checked,
    encode_parallel,
)
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.h264 import STATE_QP, ClosedGop, qp_step, state_codec
from airgs_codec.package.layout import STATE
from airgs_codec.package.tables import STATIC, Atlas, LeftOut
from airgs_codec.scene.gaussians import Gaussians

OPACITY = STATE.slice("opacity").start
LEAST_HIDDEN = 16  # codes of alpha, above which the two escapes of a row that goes and comes are cheaper than samples


@dataclass(frozen=True, slots=True)
class StoredSamples:
    """Luma samples of some frames of a group in a file: for each of P planes T x n bytes."""

    path: Path
    planes: int
    rows: int  # n
    total: int  # T
    frames: range  # of these

    def part(self, start: int, stop: int) -> StoredSamples:
        """Fewer of the frames."""
        return replace(self, frames=self.frames[start:stop])

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        """(P, n) of one frame after the other."""
        with self.path.open("rb") as file:
            for frame in self.frames:
                samples = np.empty((self.planes, self.rows), np.uint8)
                for plane, place in enumerate(samples):
                    file.seek((plane * self.total + frame) * self.rows)
                    file.readinto(place.data)
                yield samples


@dataclass(frozen=True, slots=True, eq=False)
class CodedLevel:
    """A tile of one group in a level: all that its pictures and escapes are made of."""

    atlas: Atlas  # without its largest errors
    error: ErrorModel | None  # None: it carries no rows
    samples: StoredSamples | None  # None: no segment is fetched
    escapes: tuple[bytes | None, ...]  # of each segment; None: nothing to fetch, the canonical space is shown


@dataclass(frozen=True, slots=True, eq=False)
class CodedStates:
    """The states of one group."""

    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none
    levels: tuple[tuple[CodedLevel, ...], ...]  # level x tile
    left_out: tuple[LeftOut, ...]


def code_states(
    layout: GroupLayout,
    bases: Sequence[Canonical],
    frames: Sequence[Gaussians],
    settings: EncodeSettings,
    scratch: Path,
) -> CodedStates:
    """Quantise the states of a group for every level; `frames` are all of the group, with all input rows.

    The states of a level are differences to the one of `bases`, the canonical space as decoded in each key quality,
    that the level corrects. A segment is fetched if anything in it differs from the original canonical frame by more
    than half a step and rendering shows it. Samples go to files in `scratch`.
    """
    file = scratch / "values"
    values = StateValues.write(file, frames, layout.rows, bases[0], layout.state_steps)
    ranked = rank_states(layout, values, bases[0], settings)
    depths = ranked.depths(layout, settings)
    static = note_static(layout, values, depths)
    omissions = StateOmissions.of(layout, bases[0], values, depths)
    omitted, no_planes = omissions.planes(settings.scaled_price)
    still, no_segments = omissions.segments(settings.scaled_price)
    levels, quality = [], 0
    written = np.arange(len(layout.rows))
    for number, level in enumerate(settings.levels):
        if level.quality != quality:  # no later level carries rows that this one does not
            quality, written = level.quality, np.flatnonzero((depths != STATIC) & (depths >= number))
            base = bases[quality].part(written)
            values = StateValues.write(file, frames, layout.rows[written], base, layout.state_steps)
        steps = STATE.steps(layout.state_steps, layout.colours) * level.factor
        tiles = []
        for tile in range(layout.tiles):
            part = layout.tile_rows(tile)
            rows = part.start + np.flatnonzero((depths[part] != STATIC) & (depths[part] >= number))
            fetched = _fetched_frames(layout, ranked.largest[:, rows], level.factor / 2, still)
            alpha = bases[quality].opacity[rows].astype(np.float64)
            places = np.searchsorted(written, rows)
            coder = _LevelCoder(values, places, alpha, steps, fetched, scratch / f"{number} {tile}")
            tiles.append(coder.code(omitted))
        levels.append(tuple(tiles))
    return CodedStates(depths, tuple(levels), tuple(n for n in (static, no_planes, no_segments) if n))


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
        return assign_depths(self.score, self.moving, pruned, layout.tier_of_rows, tiers)


def rank_states(layout: GroupLayout, values: StateValues, base: Canonical, settings: EncodeSettings) -> RankedStates:
    """Rank the updates of a group; `values` are differences to the decoded canonical space `base`."""
    steps = STATE.steps(layout.state_steps, layout.colours)[:, None]
    segments = [slice(start - layout.span.start, stop - layout.span.start) for start, stop in layout.segments]
    score, moving = np.empty(values.rows), np.empty(values.rows, bool)
    largest = np.empty((len(segments), values.rows))
    for rows in values.chunks():
        key = state_channels([layout.key.take(rows)], base.part(rows), layout.state_steps)[0]
        states = values.part(rows) / steps
        changes = states - key / steps
        usage, weights = layout.usage.take(rows), layout.state_weights(rows)
        score[rows], moving[rows] = rank_updates(
            states, changes, weights, usage, settings.update_rank, settings.keep_all
        )
        largest[:, rows] = [np.abs(changes[segment]).max(axis=(0, 1)) for segment in segments]
    return RankedStates(score, moving, largest)


def _fetched_frames(
    layout: GroupLayout, largest: NDArray[np.float64], least: float, still: NDArray[np.bool_]
) -> list[slice | None]:
    """For each segment its frames in the group, None where nothing is to be fetched.

    That is where none of the (S, n) largest changes of its rows exceeds `least`, and where `still` (S,) says
    that rendering shows nothing.
    """
    parts: list[slice | None] = []
    for (start, stop), changes, omitted in zip(layout.segments, largest, still, strict=True):
        part = slice(start - layout.span.start, stop - layout.span.start)
        parts.append(part if (changes > least).any() and not omitted else None)
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class _LevelCoder:
    """Codes the n rows of a tile in a level, one channel after the other."""

    values: StateValues
    rows: NDArray[np.intp]  # (n,) among those of the values
    alpha: NDArray[np.float64]  # (n,) canonical, as decoded
    steps: NDArray[np.float64]  # (10 + C,)
    fetched: Sequence[slice | None]  # frames of each segment; None: nothing is to be fetched
    file: Path  # for samples

    def code(self, omitted: NDArray[np.bool_]) -> CodedLevel:
        """The rows without the planes of (10 + C,) channels that are left out."""
        nothing = tuple(None for _ in self.fetched)
        count, gain = len(self.steps), qp_step(STATE_QP)
        if not len(self.rows):
            return CodedLevel(Atlas(0, [0] * count, [], 0, 0), None, None, nothing)
        low, high = np.empty(count), np.empty(count)
        centres: list[int] = []
        planes: list[int] = []
        jumps: list[list[Escapes]] = []  # of each plane in each segment that is fetched
        with self.file.open("wb") as file:
            for channel in range(count):
                values, hidden = self.values.channel(channel, self.rows), None
                if channel == OPACITY:
                    values, hidden = hide_undrawn(values, self.alpha, self.steps[channel] / gain)
                low[channel], high[channel] = values.min(), values.max()
                codes = to_codes(values[:, None], self.steps[channel : channel + 1], gain, channel)
                centre, varies = fit_centre(codes, gain / 2)
                centres.append(centre)
                if (varies or (hidden is not None and hidden.any())) and not omitted[channel]:
                    planes.append(channel)
                    jumps.append(self._write(file, codes - np.int32(centre), hidden))
        atlas = make_atlas(len(self.rows), centres, planes)
        error = ErrorModel.of(low, high, atlas, self.steps / gain)
        if not planes or self.fetched == list(nothing):
            return CodedLevel(replace(atlas, planes=[], plane_width=0, columns=0), error, None, nothing)
        frames = self.values.frames
        samples = StoredSamples(self.file, len(planes), len(self.rows), frames, range(frames))
        packed = (escapes.pack(Escapes.join(of_segment)) for of_segment in zip(*jumps, strict=True))
        coded = tuple(None if part is None else next(packed) for part in self.fetched)
        return CodedLevel(atlas, error, samples, coded)

    def _write(self, file: BinaryIO, codes: NDArray[np.int32], hidden: NDArray[np.int32] | None) -> list[Escapes]:
        """Write the samples of a plane from (T, 1, n) centred codes; gives the jumps in segments that are fetched.

        `hidden` (T, n): bases that are taken off besides, of rows that are not drawn.
        """
        samples = np.zeros(codes.shape, np.uint8)
        jumps = []
        for part in self.fetched:
            if part is not None:
                samples[part], bases = escapes.split(codes[part])
                if hidden is not None:
                    bases[:, 0] -= hidden[part]
                jumps.append(Escapes.of(bases))
        file.write(samples.data)
        return jumps


def hide_undrawn(
    changes: NDArray[np.float64], base: NDArray[np.floating], unit: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Changes of alpha to be coded, and the bases (`escapes`) to take off them so that undrawn rows stay undrawn.

    `changes` (T, n) are alpha less the canonical one, `base` (n,); `unit` is the alpha of a code. A row goes on as it
    was when it was drawn last, so that its samples do not change; bases take its alpha below 0, by more than coding
    errs. Where its alpha is nearly that of before, it is coded as it is.
    """
    drawn = changes + base >= LEAST_DRAWN
    held = changes.copy()
    hold_undrawn(held[:, None], drawn)
    hidden = ~drawn & (np.abs(held - changes) > LEAST_HIDDEN * unit)
    bases = np.ceil((base + held) / (escapes.UNIT * unit) + 1 - escapes.LIMIT / escapes.UNIT)
    return np.where(hidden, held, changes), np.where(hidden, bases, 0).astype(np.int32)


def encode_states(
    layout: GroupLayout, states: CodedStates, clock: Clock, settings: EncodeSettings
) -> list[list[Representation]]:
    """The pictures of every level, level x tile, a closed GOP for each segment that is fetched."""
    codec = state_codec(settings.preset, settings.between)

    def encode(level: CodedLevel) -> Representation:
        if level.samples is None:
            return EMPTY
        size = AtlasPictures.of(level.samples, level.atlas).size
        return encode_checked(_level_gops(layout, level, level.samples, clock.frame_ticks), size, clock, codec)

    tasks = [functools.partial(encode, tile) for level in states.levels for tile in level]
    coded = iter(encode_parallel(tasks, settings.threads))
    return [[next(coded) for _ in level] for level in states.levels]


def _level_gops(layout: GroupLayout, level: CodedLevel, samples: StoredSamples, ticks: int) -> Iterator[ClosedGop]:
    """The segments of a tile in a level that are fetched; `samples` of all frames of the group, `ticks` a frame."""
    for (start, stop), escaped in zip(layout.segments, level.escapes, strict=True):
        if escaped is not None:
            shown = samples.part(start - layout.span.start, stop - layout.span.start)
            yield ClosedGop(AtlasPictures.of(shown, level.atlas), start * ticks, ticks)
