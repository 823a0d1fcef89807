"""All frames of a group -> the deltas of every pruning level: which Gaussians it carries, its samples and escapes.

Differences to the canonical space are coded as pictures. Slopes are what each Gaussian changes by, evenly, in a
segment: a picture in front of those of the frames, which code what the slopes as decoded leave, so that errors do not
add up. T frames, S segments and N Gaussians of a group, n of a level, P planes, C colour channels. Neither the
differences of all frames nor the samples of all levels may fit into memory: both wait in a scratch folder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import GREY, extract, fit_centre, make_atlas, slope_times, to_codes
from airgs_codec.coding.channels import FURTHEST, LEAST_DRAWN, Canonical, delta_channels, hold_undrawn
from airgs_codec.coding.escapes import Escapes
from airgs_codec.encoder.layout import GroupLayout, assign_depths, rank_updates
from airgs_codec.encoder.omit import DeltaOmissions, DeltaValues, note_static
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.sample import LEAST_SLOPED, fit_slopes
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.streams import (
    NO_PICTURES,
    AtlasPictures,
    CodedPictures,
    ErrorModel,
    FrameClock,
    encode_checked,
    in_threads,
)
from airgs_codec.media.h264 import DELTA_QP, ClosedGop, CodecSettings, CodedGop, delta_codec, qp_step
from airgs_codec.package.layout import DELTA
from airgs_codec.package.tables import STATIC, Atlas, LeftOut
from airgs_codec.scene.gaussians import Gaussians

OPACITY = DELTA.slice("opacity").start
LEAST_HIDDEN = 16  # codes of alpha, above which the two escapes of a row that goes and comes are cheaper than samples
ROUNDINGS = 3  # sizes of slopes that `ErrorModel` adds: they are rounded to float32 twice, and make residuals


@dataclass(frozen=True, slots=True, eq=False)
class CodedDeltas:
    depths: NDArray[np.uint8]  # (N,) deepest pruning level that carries a Gaussian; STATIC: none
    levels: tuple[CodedLevel, ...]
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...] = ()  # what was changed so that codes hold it


def code_deltas(
    layout: GroupLayout,
    bases: Sequence[Canonical],
    frames: Sequence[Gaussians],
    plan: Plan,
    clock: FrameClock,
    scratch: Path,
) -> CodedDeltas:
    """Quantise the deltas of a group for every pruning level; `frames` are all of the group, with all input rows.

    Those of a level are differences to the one of `bases`, the canonical space as decoded in each keyframe quality,
    that the level corrects. A segment is fetched if anything in it differs from the original canonical frame by more
    than half a step. Samples go to files in `scratch`. Raises CodecError.
    """
    file, settings = scratch / "values", plan.settings
    values = DeltaValues.write(file, frames, layout.rows, bases[0], layout.delta_steps)
    score, moving, largest = rank_deltas(layout, values, bases[0], settings)
    tiers = [settings.tiers_of(level) for level in settings.levels]
    depths = assign_depths(score, moving, [level.pruned for level in settings.levels], layout.tiers, tiers)
    static = note_static(layout, values, depths)
    omitted, no_planes = DeltaOmissions.of(layout, bases[0], values, depths).planes(settings.scaled_price)
    levels, quality, codec = [], 0, delta_codec(settings.preset)
    written = np.arange(len(layout.rows))
    for number, level in enumerate(settings.levels):
        rows = np.flatnonzero((depths != STATIC) & (depths >= number))
        if level.quality != quality:  # no later level carries Gaussians that this one does not
            quality, written = level.quality, rows
            base = bases[quality].take(written)
            values = DeltaValues.write(file, frames, layout.rows[written], base, layout.delta_steps)
        coder = LevelCoder(
            values,
            np.searchsorted(written, rows),
            bases[quality].opacity[rows].astype(np.float64),
            DELTA.steps(layout.delta_steps, layout.colours) * level.factor,
            [
                part if (changes > level.factor / 2).any() else None
                for part, changes in zip(layout.local_segments, largest[:, rows], strict=True)
            ],
            plan.sloped,
            scratch / f"level {number}",
            clock,
            codec,
        )
        levels.append(coder.code(omitted))
    pictures = in_threads(settings.threads, lambda level: _encode_level(layout, level, clock, codec), levels)
    coded = tuple(replace(level, pictures=of) for level, of in zip(levels, pictures, strict=True))
    away = int((largest.max(axis=0) >= 0.999 * FURTHEST).sum())
    span = f"frames {layout.span[0]}-{layout.span[1] - 1}"
    notes = (f"{span}: {away} Gaussians go further than codes reach, and are coded nearer and as much smaller",)
    return CodedDeltas(depths, coded, tuple(note for note in (static, no_planes) if note), notes * bool(away))


def rank_deltas(
    layout: GroupLayout, values: DeltaValues, base: Canonical, settings: EncodeSettings
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
    """Rank the updates of a group by what they are worth; `values` are differences to the decoded space `base`.

    Returns (N,) scores, (N,) whether a Gaussian ever changes by half a step, and (S, N) its largest change of any
    channel from the original canonical frame, in steps.
    """
    steps = DELTA.steps(layout.delta_steps, layout.colours)[:, None]
    score, moving = np.empty(values.rows), np.empty(values.rows, bool)
    largest = np.empty((len(layout.segments), values.rows))
    for rows in values.chunks():
        keyframe = delta_channels([layout.keyframe.take(rows)], base.take(rows), layout.delta_steps)[0]
        changes = (values.part(rows) - keyframe) / steps
        score[rows], moving[rows] = rank_updates(layout, rows, changes, settings.update_rank)
        largest[:, rows] = [np.abs(changes[segment]).max(axis=(0, 1)) for segment in layout.local_segments]
    return score, moving, largest


def _encode_level(layout: GroupLayout, level: CodedLevel, clock: FrameClock, codec: CodecSettings) -> CodedPictures:
    if level.samples is None:
        return NO_PICTURES
    gops, segments = [], zip(layout.local_segments, layout.segments, level.escapes, level.slopes, strict=True)
    for part, (start, _), escaped, slope in segments:
        if escaped is not None:
            shown = AtlasPictures.of(level.samples.part(part), level.atlas)
            gops.append(ClosedGop(shown, start * clock.frame_ticks, clock.frame_ticks, slope))
    return encode_checked(gops, AtlasPictures.of(level.samples, level.atlas).size, clock, codec)


@dataclass(frozen=True, slots=True)
class StoredSamples:
    """Luma samples of some frames of a group in a file: for each of P planes T x n bytes."""

    path: Path
    planes: int
    rows: int  # n
    total: int  # T
    frames: range  # of these

    def part(self, frames: slice) -> StoredSamples:
        return replace(self, frames=self.frames[frames])

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        """Yield (P, n) of one frame after the other."""
        samples = np.memmap(self.path, np.uint8, "r", shape=(self.planes, self.total, self.rows))
        return (np.array(samples[:, frame]) for frame in self.frames)


@dataclass(frozen=True, slots=True, eq=False)
class CodedLevel:
    """A level of one group: all that its pictures and escapes are made of."""

    atlas: Atlas  # without its largest errors
    error: ErrorModel | None  # None: it carries no rows
    samples: StoredSamples | None  # None: no segment is fetched
    escapes: tuple[bytes | None, ...]  # of each segment; None: nothing to fetch, the canonical space is shown
    slopes: tuple[CodedGop | None, ...]  # the picture of slopes of each segment; None: it has no slope
    pictures: CodedPictures = NO_PICTURES  # a closed GOP for each segment that is fetched


@dataclass(frozen=True, slots=True, eq=False)
class CodedSlopes:
    gop: CodedGop  # of one picture
    escapes: Escapes
    samples: NDArray[np.uint8]  # (P, n) as decoded
    bases: NDArray[np.int32]  # (P, n)

    @staticmethod
    def of(codes: NDArray[np.int32], atlas: Atlas, clock: FrameClock, codec: CodecSettings) -> CodedSlopes:
        """Code (P, n) codes of slopes. Raises CodecError."""
        samples, bases = escapes.split(codes[None])
        pictures = AtlasPictures.of(samples, atlas)
        (gop,) = encode_checked([ClosedGop(pictures, 0, 1)], pictures.size, clock, codec).gops
        return CodedSlopes(gop, Escapes.of(bases), extract(next(iter(gop.pictures("slopes"))), atlas), bases[0])

    def decoded(self, plane: int) -> NDArray[np.float64]:
        """Return (n,) slopes of a plane as decoded, in codes."""
        return self.samples[plane].astype(np.float64) - GREY + escapes.UNIT * self.bases[plane]


Slopes = Sequence[CodedSlopes | None]  # of each segment


@dataclass(frozen=True, slots=True, eq=False)
class LevelCoder:
    """Codes the n rows of a level, one channel after the other."""

    values: DeltaValues
    rows: NDArray[np.intp]  # (n,) among those of the values
    alpha: NDArray[np.float64]  # (n,) canonical, as decoded
    steps: NDArray[np.float64]  # (10 + C,)
    fetched: Sequence[slice | None]  # frames of each segment; None: nothing is to be fetched
    sloped: bool  # segments have slopes
    file: Path  # for samples
    clock: FrameClock
    codec: CodecSettings

    def code(self, omitted: NDArray[np.bool_]) -> CodedLevel:
        """Code the rows without the planes of the (10 + C,) channels that are `omitted`. Raises CodecError."""
        nothing = tuple(None for _ in self.fetched)
        count, gain = len(self.steps), qp_step(DELTA_QP)
        if not len(self.rows):
            return CodedLevel(Atlas(0, [0] * count, [], 0, 0), None, None, nothing, nothing)
        low, high = np.empty(count), np.empty(count)
        centres: list[int] = []
        planes: list[int] = []
        jumps: list[list[Escapes]] = []  # of each plane in each segment that is fetched
        rises: list[list[NDArray[np.int32]]] = []  # of each plane, slopes of each segment that has them
        lined = [part for part in self.fetched if self._lined(part)]
        with self.file.open("wb") as file:
            for channel in range(count):
                values, hidden = self._channel(channel)
                low[channel], high[channel] = values.min(), values.max()
                codes = self._codes(values, channel)
                centre, varies = fit_centre(codes, gain / 2)
                centres.append(centre)
                if not (varies or (hidden is not None and hidden.any())) or omitted[channel]:
                    continue
                planes.append(channel)
                if lined:
                    rises.append([self._codes(fit_slopes(values[part])[None], channel)[0, 0] for part in lined])
                else:
                    jumps.append(self._write(file, codes - np.int32(centre), hidden))
        atlas = make_atlas(len(self.rows), centres, planes)
        error = ErrorModel.of(low, high, atlas, self.steps / gain)
        if not planes or self.fetched == list(nothing):
            return CodedLevel(replace(atlas, planes=[], plane_width=0, columns=0), error, None, nothing, nothing)
        coded = (CodedSlopes.of(np.stack(part), atlas, self.clock, self.codec) for part in zip(*rises, strict=True))
        slopes = [next(coded) if self._lined(part) else None for part in self.fetched]
        if lined:
            jumps, error = self._write_rest(atlas, slopes, error)
        frames = self.values.frames
        samples = StoredSamples(self.file, len(planes), len(self.rows), frames, range(frames))
        gops = tuple(slope.gop if slope else None for slope in slopes)
        return CodedLevel(atlas, error, samples, self._packed(jumps, slopes), gops)

    def _lined(self, part: slice | None) -> bool:
        """Return whether a segment, whose frames are a part of the group, has slopes."""
        return self.sloped and part is not None and part.stop - part.start >= LEAST_SLOPED

    def _channel(self, channel: int) -> tuple[NDArray[np.float64], NDArray[np.int32] | None]:
        """Return (T, n) values of a channel, and the bases that hide rows which are not drawn."""
        values = self.values.channel(channel, self.rows)
        if channel == OPACITY:
            return hide_undrawn(values, self.alpha, self.steps[channel] / qp_step(DELTA_QP))
        return values, None

    def _codes(self, values: NDArray[np.float64], channel: int) -> NDArray[np.int32]:
        return to_codes(values[:, None], self.steps[channel : channel + 1], qp_step(DELTA_QP), channel)

    def _write(self, file: BinaryIO, codes: NDArray[np.int32], hidden: NDArray[np.int32] | None) -> list[Escapes]:
        """Write the samples of a plane from (T, 1, n) centred codes; gives the jumps in segments that are fetched.

        `hidden` (T, n): the bases that hide rows which are not drawn.
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

    def _packed(self, jumps: Sequence[Sequence[Escapes]], slopes: Slopes) -> tuple[bytes | None, ...]:
        """Return the column file of each segment, None where nothing is fetched."""
        of_segments = (Escapes.join(of_segment) for of_segment in zip(*jumps, strict=True))
        return tuple(
            None if part is None else escapes.pack(*((slope.escapes,) if slope else ()), next(of_segments))
            for part, slope in zip(self.fetched, slopes, strict=True)
        )

    def _write_rest(self, atlas: Atlas, slopes: Slopes, error: ErrorModel) -> tuple[list[list[Escapes]], ErrorModel]:
        """Write the samples of what slopes leave; gives the jumps as `_write` does, and bounds that know the slopes."""
        jumps, largest = [], error.largest.copy()
        with self.file.open("wb") as file:
            for plane, channel in enumerate(atlas.planes):
                values, hidden = self._channel(channel)
                for part, slope in zip(self.fetched, slopes, strict=True):
                    if part and slope:
                        rises = slope.decoded(plane) * error.units[channel]
                        values[part] -= slope_times(part.stop - part.start)[:, None] * rises
                        most = error.largest[channel] + ROUNDINGS * float(np.abs(rises).max())
                        largest[channel] = max(largest[channel], most)
                codes = self._codes(values, channel) - np.int32(atlas.centres[channel])
                jumps.append(self._write(file, codes, hidden))
        return jumps, replace(error, largest=largest)


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
