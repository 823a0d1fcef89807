"""Parts that a group's pictures can do without, by what rendering without them shows.

T frames and N rows of the group, n rows of its first level, C colour channels. Deltas are in a file, which is read by
channels, by rows or by frames as each step needs them. Each decision comes with a note for the tables, None where
nothing was left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.importance import CostSums, estimate_cost, pooled_error, pooled_within, select_omissions
from airgs_codec.coding.channels import Canonical, DeltaApplier, frame_channels, hold_undrawn
from airgs_codec.coding.kernels import row_chunks
from airgs_codec.encoder.layout import GroupLayout
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import Frames, Survey
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.package.layout import DELTA, KEYFRAME
from airgs_codec.package.tables import STATIC, DeltaSteps, LeftOut
from airgs_codec.render.compare import Source, compare, draw_frames, draw_once, draw_still
from airgs_codec.scene.gaussians import SH_REST, Gaussians

_BYTES = np.dtype(np.float64).itemsize


@dataclass(frozen=True, slots=True, eq=False)
class DeltaValues:
    """`coding.channels.delta_channels` of all frames of a group: one plane of T x N float64 after the other."""

    path: Path
    frames: int  # T
    channels: int  # 10 + C
    rows: int  # N

    @staticmethod
    def write(
        path: Path, frames: Sequence[Gaussians], rows: NDArray[np.intp], base: Canonical, steps: DeltaSteps
    ) -> DeltaValues:
        """Differences of some `rows` (N,) of frames, which are looked at one by one, to a decoded canonical space."""
        values = DeltaValues(path, len(frames), DELTA.width(base.colour.shape[1]), len(rows))
        drawn = np.empty((values.frames, values.rows), bool)
        with path.open("wb") as file:
            for t, frame in enumerate(frames):
                found = np.empty((values.channels, values.rows))
                for part in row_chunks(values.rows, values.channels):
                    found[:, part], drawn[t, part] = frame_channels(frame.take(rows[part]), base.take(part), steps)
                for channel, plane in enumerate(found):
                    file.seek(values._offset(channel, t))
                    file.write(plane.data)
        values._hold(drawn)
        return values

    def _hold(self, drawn: NDArray[np.bool_]) -> None:
        """Hold the last drawn value of every channel but opacity; `drawn` is (T, N)."""
        rows = np.flatnonzero(~drawn.all(axis=0))
        if not len(rows):
            return
        with self.path.open("r+b") as file:
            for channel in np.delete(np.arange(self.channels), DELTA.slice("opacity")).tolist():
                plane = self.planes[channel].copy()
                held = plane[:, rows]
                hold_undrawn(held[:, None], drawn[:, rows])
                plane[:, rows] = held
                file.seek(self._offset(channel, 0))
                file.write(plane.data)

    @property
    def planes(self) -> NDArray[np.float64]:
        """Return (10 + C, T, N) values, which are read from the file where they are looked at."""
        shape = self.channels, self.frames, self.rows
        return np.asarray(np.memmap(self.path, np.float64, "r", shape=shape)) if self.rows else np.empty(shape)

    def chunks(self) -> Iterator[slice]:
        """Return rows that may be in memory together in all frames."""
        return row_chunks(self.rows, self.frames * self.channels)

    def channel(self, channel: int, rows: NDArray[np.intp] | slice) -> NDArray[np.float64]:
        """Return (T, n) values of some rows in one channel."""
        values = self.planes[channel]
        return values[:, rows].copy() if isinstance(rows, slice) else values.take(rows, axis=1)

    def part(self, rows: slice, frames: slice = slice(None)) -> NDArray[np.float64]:
        """Return (t, 10 + C, n) values of some rows in some frames."""
        return np.array(self.planes[:, frames, rows].swapaxes(0, 1), order="C")

    def frame(self, t: int) -> NDArray[np.float64]:
        """Return (10 + C, N) values of one frame."""
        return np.array(self.planes[:, t])

    def _offset(self, channel: int, t: int) -> int:
        return _BYTES * self.rows * (channel * self.frames + t)


def note_omission(what: str, count: int, error: float, size: float) -> LeftOut | None:
    """Return the record that `count` things were left out, at this error and to save `size` bytes a frame."""
    return LeftOut(what, count, float(f"{error:.3g}"), float(f"{size:.3g}")) if count else None


def omit_bands(frames: Frames, survey: Survey, settings: EncodeSettings) -> tuple[int, str]:
    """Choose how many SH bands past DC pictures of a group need; also gives a sentence on the others, if there are any.

    The highest band goes as long as its bytes, coded once in the group, are worth less than the error of rendering
    without it.
    """
    sequence, count = frames.sequence, frames.stop - frames.start
    step, price = settings.steps.keyframe.sh_rest * settings.quality, settings.scaled_price
    if not sequence.sh_degree or price == 0:
        return sequence.sh_degree, ""
    g = sequence.load([frames.start + count // 2]).frames[0]
    whole, views = draw_once(draw_still(g, survey.renderer)), [(0, camera) for _, camera in survey.checks]
    bands, cost, size = g.sh_degree, 0.0, 0.0
    while bands:
        fewer = draw_still(g.with_degree(bands - 1), survey.renderer)
        band = _band_bytes(g, bands, step) / count
        error = pooled_error(list(compare(whole, fewer, views, Picture.mse)))
        if error > price / 2 * (size + band):
            break
        bands, cost, size = bands - 1, error, size + band
    missing = g.sh_degree - bands
    alone = f"{psnr(cost):.1f} dB by itself" if cost else "no error"
    return bands, f"{missing} SH bands left out: {alone}, {size / 1e3:.2f} kB/frame saved" if missing else ""


def _band_bytes(g: Gaussians, band: int, step: float) -> float:
    top = g.with_degree(band).sh_rest[:, SH_REST[band - 1] :]
    coefficients = top.reshape(1, len(g), -1).transpose(0, 2, 1).astype(np.float64) / step
    none = np.zeros(coefficients.shape[1])
    return float(estimate_cost(coefficients, none, np.zeros_like(coefficients[0]))[0].sum())


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeOmissions:
    """Parts that the keyframe of a group can do without."""

    layout: GroupLayout
    values: NDArray[np.float64]  # (7 + C, N) keyframe channels
    centres: NDArray[np.float64]  # (7 + C,) medians
    sizes: NDArray[np.float64]  # (7 + C,) bytes a frame of the group, estimated
    guesses: NDArray[np.float64]  # (7 + C,) errors of leaving a channel out, estimated

    @staticmethod
    def of(layout: GroupLayout, values: NDArray[np.float64]) -> KeyframeOmissions:
        centres = np.median(values, axis=1)
        factors = np.array(layout.factors)[layout.tiers]
        apart = (values - centres[:, None]) / np.outer(KEYFRAME.steps(layout.keyframe_steps, layout.colours), factors)
        weights = layout.keyframe_weights() * factors**2
        sizes, guesses = estimate_cost(apart[None], np.zeros(len(centres)), weights)
        return KeyframeOmissions(layout, values, centres, sizes / layout.frames, guesses)

    def gaussians(self) -> LeftOut | None:
        """Note the Gaussians that are not written, with the bytes of as many of the written ones, keyframes alone."""
        written = len(self.layout.rows)
        missing = self.layout.count - written
        size = float(self.sizes.sum()) / written * missing
        return note_omission("gaussians", missing, self.layout.removal_error, size)

    def planes(self, price: float) -> tuple[NDArray[np.bool_], LeftOut | None]:
        """Return (7 + C,) channels that every row may take from the channel's median."""
        if price == 0:
            return np.zeros(len(self.sizes), bool), None
        pictures = self.layout.pictures
        whole = draw_once(self._show(self.values))

        def error(omitted: NDArray[np.bool_], most: float) -> float:
            without = self._show(np.where(omitted[:, None], self.centres[:, None], self.values))
            return pooled_within(compare(whole, without, pictures, Picture.mse), len(pictures), most)

        chosen, cost = select_omissions(self.sizes, self.guesses, error, price)
        saved = float(self.sizes[chosen].sum())
        return chosen, note_omission("keyframe planes", int(chosen.sum()), cost, saved)

    def _show(self, values: NDArray[np.float64]) -> Source:
        depths = np.zeros(len(self.layout.codes), np.uint8)
        shown = self.layout.canonical_space(values.astype(np.float32), depths).to_gaussians()
        return draw_still(shown, self.layout.renderer)


def note_static(layout: GroupLayout, values: DeltaValues, depths: NDArray[np.uint8]) -> LeftOut | None:
    """Note how many rows are static, the error that this is expected to add, and the bytes a frame that it saves."""
    still = depths == STATIC
    sizes, errors = _estimate_deltas(layout, values, still, np.zeros(values.channels))
    size = float(sizes.sum()) / values.frames
    return note_omission("updates", int(still.sum()), float(errors.sum()), size)


def _estimate_deltas(
    layout: GroupLayout, values: DeltaValues, rows: NDArray[np.bool_], centres: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`estimate_cost` of the deltas of a mask of rows (N,); `centres` (10 + C,) are in channel units."""
    steps = DELTA.steps(layout.delta_steps, layout.colours)
    sums = CostSums.of(centres / steps)
    for part in values.chunks():
        chosen = np.flatnonzero(rows[part])
        if len(chosen):
            deltas = values.part(part)[:, :, chosen] / steps[:, None]
            sums.add(deltas, layout.delta_weights(part)[:, chosen])
    return sums.costs()


@dataclass(frozen=True, slots=True, eq=False)
class DeltaOmissions:
    """Parts that the deltas of a group can do without."""

    layout: GroupLayout
    values: DeltaValues  # of the finest keyframe quality
    depths: NDArray[np.uint8]  # (N,)
    applier: DeltaApplier  # of the n rows

    @staticmethod
    def of(layout: GroupLayout, base: Canonical, values: DeltaValues, depths: NDArray[np.uint8]) -> DeltaOmissions:
        """Make it from differences to a canonical space and the (N,) depths of rows."""
        applier = DeltaApplier(base, np.flatnonzero(depths != STATIC), layout.delta_steps)
        return DeltaOmissions(layout, values, depths, applier)

    def planes(self, price: float) -> tuple[NDArray[np.bool_], LeftOut | None]:
        """Return (10 + C,) channels that every row may take from the channel's median."""
        frames, count, rows = self.values.frames, self.values.channels, self.applier.rows
        if price == 0 or not len(rows):
            return np.zeros(count, bool), None
        centres = np.array([np.median(self.values.channel(c, rows)) for c in range(count)])
        sizes, guesses = _estimate_deltas(self.layout, self.values, self.depths != STATIC, centres)
        pictures = self.layout.pictures
        whole = draw_once(self._show(np.zeros(count, bool), centres))

        def error(omitted: NDArray[np.bool_], most: float) -> float:
            errors = compare(whole, self._show(omitted, centres), pictures, Picture.mse)
            return pooled_within(errors, len(pictures), most)

        chosen, cost = select_omissions(sizes / frames, guesses, error, price)
        saved = float(sizes[chosen].sum()) / frames
        return chosen, note_omission("delta planes", int(chosen.sum()), cost, saved)

    def _show(self, omitted: NDArray[np.bool_], centres: NDArray[np.float64]) -> Source:
        """Return the frames of the group, whose `omitted` channels are at their centres."""

        def frame(place: int) -> Gaussians:
            shown = self.values.frame(place)[:, self.applier.rows]
            return self.applier.apply(np.where(omitted[:, None], centres[:, None], shown).astype(np.float32))

        return draw_frames(frame, self.layout.renderer)
