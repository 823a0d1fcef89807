"""Rows of a group that viewers may keep from an earlier group, the base, in place of coding them again.

N rows of the group and B rows of the base, both in file order; C colour channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import Canonical, recolour
from airgs_codec.coding.grid import cell_bits, grid_codes
from airgs_codec.encoder.error_bounds import ROUNDING
from airgs_codec.encoder.plan import CODED_HERE, GroupLayout
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.h264 import KEY_QP, qp_step
from airgs_codec.package.layout import KEY

WORTH = 0.25  # share of a key's bytes that keeping rows must save
PROMISED = 0.5 + 0.5 / qp_step(KEY_QP)  # steps that a key channel errs by: half a code, and half a step of the codec
SLIGHT = 0.25  # steps, or cells, by which a value may change and still be kept with whatever error it has
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


def keep_known(layout: GroupLayout, base: BaseGroup, settings: EncodeSettings) -> GroupLayout | None:
    """The layout with every row of the base kept that may be; None where so few may that it is not worth it.

    Kept rows have the unit and the motion class that they have in the base. Viewers of the last level must have a row.
    """
    there = find_kept(layout, base)
    kept = there != CODED_HERE
    units = np.where(kept, base.layout.units[there], layout.units)
    if kept.mean() < WORTH or not (units % layout.tiers < settings.tiers_of(settings.levels[-1])).any():
        return None
    classes = np.where(kept, base.layout.classes[there], layout.classes)
    codes = grid_codes(layout.key.means, classes, layout.grid)
    moved = replace(layout, units=units, classes=classes, codes=codes, base_rows=there)
    return moved.take(np.lexsort((np.where(kept, there.astype(np.uint64), codes), ~kept, units)))


def find_kept(layout: GroupLayout, base: BaseGroup) -> NDArray[np.intp]:
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
    steps = KEY.steps(layout.key_steps, layout.colours)[:, None]
    cells = layout.grid.step * np.exp2(cell_bits(layout.classes, layout.grid))[rows]
    promised = np.concatenate(
        [np.broadcast_to(PROMISED * steps, values.shape), np.broadcast_to(cells / 2, (3, len(rows)))]
    )
    units = np.concatenate([np.broadcast_to(steps, values.shape), np.broadcast_to(cells, (3, len(rows)))])
    decoded = np.concatenate([base.values(layout, there, 0) - values, (base.spaces[0].means[there] - means).T])
    before = np.concatenate([base.originals(layout, there) - values, (base.layout.key.means[there] - means).T])
    return np.abs(decoded) / promised, np.abs(before) / units


def kept_errors(layout: GroupLayout, base: BaseGroup, unit: int, quality: int) -> NDArray[np.float64]:
    """(7 + C,) the most that kept rows of a unit are off in a key quality, in the units of the channels."""
    rows = layout.kept_rows(unit)
    errors = np.abs(base.values(layout, layout.base_rows[rows], quality) - layout.key_values()[:, rows])
    return np.asarray(errors.max(axis=1, initial=0.0) + ROUNDING * np.abs(layout.key_values()[:, rows]).max(axis=1))
