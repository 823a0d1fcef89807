"""Canonical frames -> key pictures with their detail, and back to the canonical space that viewers have.

Viewers may reuse rows of an earlier group, the base, in place of having them coded again. N rows of a group and B rows
of its base, both in file order; n rows of a unit, P planes, C colour channels.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import centre_codes, choose_layout, fit_atlas, read_codes
from airgs_codec.coding.channels import Canonical, dequantise_key, join_canonical, recolour
from airgs_codec.coding.grid import cell_bits, coarse_codes, grid_codes
from airgs_codec.coding.quantize import from_codes, to_codes
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_some
from airgs_codec.coding.sidecar import Kept, KeySidecar, detail_columns, pack_key_sidecar, read_detail
from airgs_codec.encoder.omit import KeyOmissions
from airgs_codec.encoder.plan import CODED_HERE, GroupLayout
from airgs_codec.encoder.representation import (
    EMPTY,
    ROUNDING,
    AtlasPictures,
    Clock,
    ErrorModel,
    Representation,
    encode_checked,
    encode_parallel,
)
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.h264 import KEY_QP, ClosedGop, key_codec, qp_step
from airgs_codec.package.layout import KEY
from airgs_codec.package.tables import STATIC, Atlas, LeftOut

WORTH = 0.25  # share of a key's bytes that keeping rows must save
PROMISED = 0.5 + 0.5 / qp_step(KEY_QP)  # steps that a key channel errs by: half a code, and half a step of the codec
SLIGHT = 0.25  # steps, or cells, by which a value may change and still be reused with whatever error it has
SAME = 0.01  # of these by which two canonical values may differ and count as one: means of equal frames are rounded
CLASSES = 1  # by which the motion class of a row may be another in the base than it would be in the group


@dataclass(frozen=True, slots=True, eq=False)
class BaseGroup:
    """A group whose key was coded by itself: what viewers who have it know."""

    layout: GroupLayout
    channels: Sequence[NDArray[np.float32]]  # for each key quality the (7 + C, B) key channels as decoded
    spaces: Sequence[Canonical]  # for each key quality the canonical space as decoded
    key_bytes: int  # of all its key units and sidecars

    def values(self, layout: GroupLayout, rows: NDArray[np.intp], quality: int) -> NDArray[np.float64]:
        """(7 + C, n) of some rows as decoded, in the key channels of another group."""
        return self._recoloured(self.channels[quality][:, rows], layout)

    def originals(self, layout: GroupLayout, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        """(7 + C, n) of some rows as they were before they were coded, in the key channels of another group."""
        return self._recoloured(self.layout.key_values()[:, rows], layout)

    def _recoloured(self, channels: NDArray[np.floating], layout: GroupLayout) -> NDArray[np.float64]:
        mine, other = ((part.transform, part.key_steps) for part in (self.layout, layout))
        return recolour(channels, mine, other)

    def worth_bytes(self, rows: int) -> float:
        """The most bytes that a key of so many rows may take so that keeping some was worth it."""
        return (1 - WORTH) * self.key_bytes * rows / len(self.layout.rows)


def lay_out_reused(layout: GroupLayout, base: BaseGroup, settings: EncodeSettings) -> GroupLayout | None:
    """Lay out a group that reuses every row of the base that it may; None where so few may that it is not worth it.

    Kept rows have the unit and the motion class that they have in the base. Viewers of the last level must have a row.
    """
    there = find_reused(layout, base)
    reused = there != CODED_HERE
    units = np.where(reused, base.layout.units[there], layout.units)
    if reused.mean() < WORTH or not (units % layout.tiers < settings.tiers_of(settings.levels[-1])).any():
        return None
    classes = np.where(reused, base.layout.classes[there], layout.classes)
    codes = grid_codes(layout.key.means, classes, layout.grid)
    moved = replace(layout, units=units, classes=classes, codes=codes, base_rows=there)
    return moved.take(np.lexsort((np.where(reused, there.astype(np.uint64), codes), ~reused, units)))


def find_reused(layout: GroupLayout, base: BaseGroup) -> NDArray[np.intp]:
    """(N,) for each row the row of the base that viewers may keep in its place, CODED_HERE where there is none.

    That is the same row of the sequence, if its canonical value is still the same and its motion class in the base is
    coarser by no more than CLASSES: what nobody saw there is coarse. Or else what viewers decoded of it in the best
    quality must be as near to the new value, in every channel and in its position, as a fresh coding promises, or the
    value may have changed by no more than SLIGHT; and its motion class must do for its states.
    """
    places = np.full(1 + max(int(layout.rows.max()), int(base.layout.rows.max())), CODED_HERE)
    places[base.layout.rows] = np.arange(len(base.layout.rows))
    there: NDArray[np.intp] = places[layout.rows]
    rows = np.flatnonzero(there != CODED_HERE)
    errors, changes = _differences(layout, base, rows, there[rows])
    finer = layout.classes[rows].astype(int) - base.layout.classes[there[rows]]
    near = ((errors <= 1) | (changes <= SLIGHT)).all(axis=0) & (finer >= 0) & (finer <= CLASSES)
    same = (changes <= SAME).all(axis=0) & (finer >= -CLASSES)  # not what was coded coarsely while it was hidden
    there[rows[~(near | same)]] = CODED_HERE
    return there


def _differences(
    layout: GroupLayout, base: BaseGroup, rows: NDArray[np.intp], there: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of rows of the group, and the rows of the base that may stand for them: how far what was decoded in the best
    quality is from the new value, as shares of what a fresh coding promises, and how far the new value is from the old.

    Both are (7 + C + 3, n), of the key channels and then of the position. Promised are half a step of the codec and
    half a code; half a cell. Changes are in steps and in cells.
    """
    values, means = layout.key_values()[:, rows], layout.key.means[rows].astype(np.float64)
    steps = layout.row_steps()[:, rows]
    cells = layout.grid.step * np.exp2(cell_bits(layout.classes, layout.grid))[rows]
    promised = np.concatenate([PROMISED * steps, np.broadcast_to(cells / 2, (3, len(rows)))])
    units = np.concatenate([steps, np.broadcast_to(cells, (3, len(rows)))])
    decoded = np.concatenate([base.values(layout, there, 0) - values, (base.spaces[0].means[there] - means).T])
    before = np.concatenate([base.originals(layout, there) - values, (base.layout.key.means[there] - means).T])
    return np.abs(decoded) / promised, np.abs(before) / units


def reused_errors(layout: GroupLayout, base: BaseGroup, unit: int, quality: int) -> NDArray[np.float64]:
    """(7 + C,) the most that reused rows of a unit are off in a key quality, in the units of the channels."""
    rows = layout.reused_rows(unit)
    errors = np.abs(base.values(layout, layout.base_rows[rows], quality) - layout.key_values()[:, rows])
    return np.asarray(errors.max(axis=1, initial=0.0) + ROUNDING * np.abs(layout.key_values()[:, rows]).max(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class CodedAtlas:
    """A key unit of one group at one key quality: all that its files but the shared sidecar are made of."""

    atlas: Atlas  # without its largest errors; 0 rows: nothing is sent
    samples: NDArray[np.uint8]  # (P, n) luma
    detail: bytes  # of positions, and escapes; empty where all of it is 0
    error: ErrorModel | None  # None: nothing is sent


@dataclass(frozen=True, slots=True, eq=False)
class CodedKeys:
    """The keys of one group."""

    units: tuple[tuple[CodedAtlas, ...], ...]  # unit x key quality
    coarser: tuple[int, ...]  # of each key quality: its cells of canonical means are 2^coarser times the finest
    left_out: tuple[LeftOut, ...]


def code_keys(layout: GroupLayout, settings: EncodeSettings) -> CodedKeys:
    """Quantise the key of a group for every unit and key quality, without the rows that are reused."""
    values = layout.key_values()
    omissions = KeyOmissions.of(layout, values)
    omitted, planes = omissions.planes(settings.scaled_price)
    coarser = settings.coarser

    def code(unit: int, quality: int) -> CodedAtlas:
        rows, steps = layout.coded_rows(unit), layout.unit_steps(unit)
        sidecar = layout.sidecar(rows, _static(layout))
        detail = detail_columns(sidecar, layout.grid, coarser[quality], coarser[-1])
        return _code_unit(values[None, :, rows], steps * settings.key_factors[quality], omitted, detail)

    qualities = range(len(settings.key_factors))
    units = range(layout.tiles * layout.tiers)
    coded = tuple(tuple(code(unit, quality) for quality in qualities) for unit in units)
    return CodedKeys(coded, coarser, tuple(note for note in (omissions.gaussians(), planes) if note))


def _static(layout: GroupLayout) -> NDArray[np.uint8]:
    """(N,) depths before there are states."""
    return np.full(len(layout.codes), STATIC, np.uint8)


def _code_unit(
    values: NDArray[np.float64], steps: NDArray[np.float64], omitted: NDArray[np.bool_], detail: list[Column]
) -> CodedAtlas:
    """From (1, 7 + C, n) values, (7 + C,) steps, (7 + C,) channels that are left out, and the detail of positions."""
    if not values.size:
        return CodedAtlas(Atlas(0, [0] * len(steps), [], 0, 0), np.empty((0, 0), np.uint8), b"", None)
    gain = qp_step(KEY_QP)
    codes = to_codes(values, steps, gain)
    atlas = _with_picture(fit_atlas(codes, gain / 2, omitted))
    samples, bases = escapes.split(centre_codes(codes, atlas))
    error = ErrorModel.of(values.min(axis=(0, 2)), values.max(axis=(0, 2)), atlas, steps / gain)
    return CodedAtlas(atlas, samples[0], encode_some([*detail, *escapes.Escapes.of(bases).columns()]), error)


def _with_picture(atlas: Atlas) -> Atlas:
    """A key always has a picture: of its first channel, if all channels are constant."""
    if atlas.planes:
        return atlas
    return replace(atlas, planes=[0], plane_width=choose_layout(atlas.rows, 1)[0], columns=1)


def encode_keys(
    layout: GroupLayout, keys: CodedKeys, clock: Clock, settings: EncodeSettings
) -> list[list[Representation]]:
    """The picture of every unit in every key quality, unit x quality."""
    codec, ticks = key_codec(settings.preset), clock.frame_ticks

    def encode(part: CodedAtlas) -> Representation:
        if not part.atlas.rows:
            return EMPTY
        pictures = AtlasPictures.of(part.samples[None], part.atlas)
        gop = ClosedGop(pictures, layout.span.start * ticks, layout.span.frames * ticks)
        return encode_checked([gop], pictures.size, clock, codec)

    tasks = [functools.partial(encode, part) for unit in keys.units for part in unit]
    coded = iter(encode_parallel(tasks, settings.threads))
    return [[next(coded) for _ in unit] for unit in keys.units]


def key_bytes(
    layout: GroupLayout,
    keys: CodedKeys,
    pictures: Sequence[Sequence[Representation]],
    base: GroupLayout | None = None,
) -> int:
    """Bytes of all key units and sidecars of a group, before there are states; `base` is that whose rows are reused."""
    total = 0
    for unit, of_unit in enumerate(pictures):
        rows = layout.unit_rows(unit)
        if rows.stop > rows.start:
            sidecar = key_sidecar(layout, unit, _static(layout), base)
            total += len(pack_key_sidecar(sidecar, layout.grid, keys.coarser[-1]))
        total += sum(len(gop.fragment) for part in of_unit for gop in part.gops)
        total += sum(len(coded.detail) for coded in keys.units[unit])
    return total


def key_sidecar(
    layout: GroupLayout, unit: int, depths: NDArray[np.uint8], base: GroupLayout | None = None
) -> KeySidecar:
    """Make the sidecar of a unit; `depths` (N,) are those of all rows, `base` is whose rows are reused."""
    coded, reused = layout.sidecar(layout.coded_rows(unit), depths), layout.reused_rows(unit)
    if base is None:
        return coded
    return replace(coded, kept=Kept(layout.base_rows[reused] - base.unit_rows(unit).start, depths[reused]))


@dataclass(frozen=True, slots=True, eq=False)
class DecodedKeys:
    """The key of a group as viewers of a key quality have it."""

    channels: NDArray[np.float32]  # (7 + C, n) of the rows that are not reused
    space: Canonical  # of all rows, every one static


def decode_base(
    layout: GroupLayout,
    keys: CodedKeys,
    pictures: Sequence[Sequence[Representation]],
    settings: EncodeSettings,
    quality: int = 0,
    base: Canonical | None = None,
) -> DecodedKeys:
    """The key of a group as viewers of a key quality have it.

    `pictures` are those of `encode_keys`; `base` is the canonical space, in that quality, of the group whose rows are
    reused.
    """
    channels, parts = [np.empty((KEY.width(layout.colours), 0), np.float32)], []
    for unit, of_quality in enumerate(pictures):
        gops, coded = of_quality[quality].gops, keys.units[unit][quality]
        reused = layout.reused_rows(unit)
        if base is not None and reused.stop > reused.start:
            parts.append(base.kept(layout.base_rows[reused], _static(layout)[reused]))
        if not gops:
            continue
        where = f"key unit {unit} of frames {layout.span.start}-{layout.span.stop - 1}"
        picture = next(iter(gops[0].pictures(where)))
        reader = ColumnReader(coded.detail or None, where)
        sidecar = _read_positions(reader, layout, unit, keys.coarser[quality], keys.coarser[-1])
        jumps = escapes.read_columns(reader, (1, len(coded.atlas.planes), coded.atlas.rows))
        codes = read_codes(picture, coded.atlas, jumps.bases(0))
        values = from_codes(codes, layout.unit_steps(unit) * settings.key_factors[quality], qp_step(KEY_QP))
        channels.append(values)
        coarser = keys.coarser[quality]
        parts.append(dequantise_key(values, sidecar, layout.transform, layout.grid, layout.key_steps, coarser))
    return DecodedKeys(np.concatenate(channels, axis=1), join_canonical(parts, layout.transform))


def _read_positions(reader: ColumnReader, layout: GroupLayout, unit: int, coarser: int, coarsest: int) -> KeySidecar:
    """The coded rows of a unit as a key quality has them, every one static, from the bytes that are sent."""
    shared = layout.sidecar(layout.coded_rows(unit), _static(layout))
    codes = coarse_codes(shared.codes, shared.classes, layout.grid, coarsest)
    return read_detail(reader, replace(shared, codes=codes), layout.grid, coarser, coarsest)
