"""The states of a group in a level -> samples, escapes, and lines in time where they save bytes.

T frames of the group, S segments, n rows of the level, P planes, C colour channels. A line is what each row
rises by in a segment, coded as a picture in front of its frames, which code what the line as decoded leaves: errors do
not add up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import GREY, extract, fit_centre, line_times, make_atlas, to_codes
from airgs_codec.coding.channels import LEAST_DRAWN, hold_undrawn
from airgs_codec.coding.escapes import Escapes
from airgs_codec.encoder.omit import StateValues
from airgs_codec.encoder.representation import AtlasPictures, Clock, ErrorModel, encode_checked
from airgs_codec.encoder.sample import block_rows, fit_slopes, worth_line
from airgs_codec.media.h264 import STATE_QP, ClosedGop, CodecSettings, CodedGop, qp_step
from airgs_codec.package.layout import STATE
from airgs_codec.package.tables import Atlas

OPACITY = STATE.slice("opacity").start
LEAST_HIDDEN = 16  # codes of alpha, above which the two escapes of a row that goes and comes are cheaper than samples
TRIED = 300  # blocks of rows that tell whether a line is worth its bytes, in all frames of a segment together
FEWEST_TRIED = 8  # in a frame
ROUNDINGS = 3  # sizes of slopes that `ErrorModel` counts besides: they are rounded to float32 twice, and make residuals


@dataclass(frozen=True, slots=True)
class StoredSamples:
    """Luma samples of some frames of a group in a file: for each of P planes T x n bytes."""

    path: Path
    planes: int
    rows: int  # n
    total: int  # T
    frames: range  # of these

    def part(self, start: int, stop: int) -> StoredSamples:
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
    """A level of one group: all that its pictures and escapes are made of."""

    atlas: Atlas  # without its largest errors
    error: ErrorModel | None  # None: it carries no rows
    samples: StoredSamples | None  # None: no segment is fetched
    escapes: tuple[bytes | None, ...]  # of each segment; None: nothing to fetch, the canonical space is shown
    lines: tuple[CodedGop | None, ...]  # the picture of slopes of each segment; None: it has no line


@dataclass(frozen=True, slots=True, eq=False)
class CodedLine:
    gop: CodedGop  # of one picture
    escapes: Escapes
    samples: NDArray[np.uint8]  # (P, n) as decoded
    bases: NDArray[np.int32]  # (P, n)

    @staticmethod
    def of(codes: NDArray[np.int32], atlas: Atlas, clock: Clock, codec: CodecSettings) -> CodedLine:
        """Code (P, n) codes of slopes. Raises CodecError."""
        samples, bases = escapes.split(codes[None])
        pictures = AtlasPictures.of(samples, atlas)
        (gop,) = encode_checked([ClosedGop(pictures, 0, 1)], pictures.size, clock, codec).gops
        return CodedLine(gop, Escapes.of(bases), extract(next(iter(gop.pictures("slopes"))), atlas), bases[0])

    def slopes(self, plane: int) -> NDArray[np.float64]:
        """(n,) slopes of a plane as decoded, in codes."""
        return self.samples[plane].astype(np.float64) - GREY + escapes.UNIT * self.bases[plane]


Lines = Sequence[CodedLine | None]  # of each segment


@dataclass(frozen=True, slots=True, eq=False)
class LevelCoder:
    """Codes the n rows of a level, one channel after the other."""

    values: StateValues
    rows: NDArray[np.intp]  # (n,) among those of the values
    alpha: NDArray[np.float64]  # (n,) canonical, as decoded
    steps: NDArray[np.float64]  # (10 + C,)
    weigh: Callable[[NDArray[np.intp]], NDArray[np.float64]]  # (10 + C, m) of squared errors in steps, of m of the n
    fetched: Sequence[slice | None]  # frames of each segment; None: nothing is to be fetched
    file: Path  # for samples
    clock: Clock
    codec: CodecSettings

    def code(self, omitted: NDArray[np.bool_]) -> CodedLevel:
        """The rows without the planes of (10 + C,) channels that are left out. Raises CodecError."""
        nothing = tuple(None for _ in self.fetched)
        count, gain = len(self.steps), qp_step(STATE_QP)
        if not len(self.rows):
            return CodedLevel(Atlas(0, [0] * count, [], 0, 0), None, None, nothing, nothing)
        low, high = np.empty(count), np.empty(count)
        centres: list[int] = []
        planes: list[int] = []
        jumps: list[list[Escapes]] = []  # of each plane in each segment that is fetched
        with self.file.open("wb") as file:
            for channel in range(count):
                values, hidden = self._channel(channel)
                low[channel], high[channel] = values.min(), values.max()
                codes = self._codes(values, channel)
                centre, varies = fit_centre(codes, gain / 2)
                centres.append(centre)
                if (varies or (hidden is not None and hidden.any())) and not omitted[channel]:
                    planes.append(channel)
                    jumps.append(self._write(file, codes - np.int32(centre), hidden))
        atlas = make_atlas(len(self.rows), centres, planes)
        error = ErrorModel.of(low, high, atlas, self.steps / gain)
        if not planes or self.fetched == list(nothing):
            return CodedLevel(replace(atlas, planes=[], plane_width=0, columns=0), error, None, nothing, nothing)
        lines = self._lines(atlas)
        if any(lines):
            jumps, error = self._write_again(atlas, lines, error)
        frames = self.values.frames
        samples = StoredSamples(self.file, len(planes), len(self.rows), frames, range(frames))
        gops = tuple(line.gop if line else None for line in lines)
        return CodedLevel(atlas, error, samples, self._packed(jumps, lines), gops)

    def _channel(self, channel: int) -> tuple[NDArray[np.float64], NDArray[np.int32] | None]:
        """(T, n) values of a channel to be coded, and bases that are taken off besides, of rows that are not drawn."""
        values = self.values.channel(channel, self.rows)
        if channel == OPACITY:
            return hide_undrawn(values, self.alpha, self.steps[channel] / qp_step(STATE_QP))
        return values, None

    def _codes(self, values: NDArray[np.float64], channel: int) -> NDArray[np.int32]:
        """(T, 1, n) codes of (T, n) values."""
        return to_codes(values[:, None], self.steps[channel : channel + 1], qp_step(STATE_QP), channel)

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

    def _packed(self, jumps: Sequence[Sequence[Escapes]], lines: Lines) -> tuple[bytes | None, ...]:
        """The column file of each segment, None where nothing is fetched."""
        of_segments = (Escapes.join(of_segment) for of_segment in zip(*jumps, strict=True))
        return tuple(
            None if part is None else escapes.pack(*((line.escapes,) if line else ()), next(of_segments))
            for part, line in zip(self.fetched, lines, strict=True)
        )

    def _lines(self, atlas: Atlas) -> Lines:
        """The lines of segments that save bytes by them."""
        shape = len(atlas.planes), len(self.rows)
        codes = {place: np.empty(shape, np.int32) for place, worth in enumerate(self._worth(atlas)) if worth}
        for plane, channel in enumerate(atlas.planes if codes else []):
            values = self._channel(channel)[0]
            for place, found in codes.items():
                found[plane] = self._codes(fit_slopes(values[self.fetched[place]])[None], channel)[0, 0]
        lines = {place: CodedLine.of(found, atlas, self.clock, self.codec) for place, found in codes.items()}
        return [lines.get(place) for place in range(len(self.fetched))]

    def _worth(self, atlas: Atlas) -> list[bool]:
        """Whether each segment takes fewer bytes with a line, by trials of some blocks of rows."""
        longest = max(part.stop - part.start for part in self.fetched if part)
        some = block_rows(len(self.rows), max(FEWEST_TRIED, TRIED // longest))
        values = np.stack([self._channel(channel)[0][:, some] for channel in atlas.planes], axis=1)
        steps, weights = self.steps[atlas.planes], self.weigh(some)[atlas.planes]
        return [part is not None and worth_line(values[part], steps, weights, self.codec) for part in self.fetched]

    def _write_again(self, atlas: Atlas, lines: Lines, error: ErrorModel) -> tuple[list[list[Escapes]], ErrorModel]:
        """Write the samples of what lines leave; gives the jumps as `_write` does, and bounds that know the lines."""
        jumps, largest = [], error.largest.copy()
        with self.file.open("wb") as file:
            for plane, channel in enumerate(atlas.planes):
                values, hidden = self._channel(channel)
                for part, line in zip(self.fetched, lines, strict=True):
                    if part and line:
                        slopes = line.slopes(plane) * error.units[channel]
                        values[part] -= line_times(part.stop - part.start)[:, None] * slopes
                        most = error.largest[channel] + ROUNDINGS * float(np.abs(slopes).max())
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
