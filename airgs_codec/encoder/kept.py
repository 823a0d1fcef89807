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
SAME = 0.01  # steps by which two canonical values may differ and count as one: means of equal frames are rounded
CLASSES = 1  # by which the motion class of a row may be finer in the base than it would be in the group


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

    Kept rows have the tier and the motion class that they have in the base. Viewers of the last level must have a row.
    """
    there = find_kept(layout, base)
    kept = there != CODED_HERE
    tiers = np.where(kept, base.layout.tiers[there], layout.tiers)
    if kept.mean() < WORTH or not (tiers < settings.tiers_of(settings.levels[-1])).any():
        return None
    classes = np.where(kept, base.layout.classes[there], layout.classes)
    codes = grid_codes(layout.key.means, classes, layout.grid)
    moved = replace(layout, tiers=tiers, classes=classes, codes=codes, base_rows=there)
    return moved.take(np.lexsort((np.where(kept, there.astype(np.uint64), codes), ~kept, tiers)))


def find_kept(layout: GroupLayout, base: BaseGroup) -> NDArray[np.intp]:
    """(N,) for each row the row of the base that viewers may keep in its place, CODED_HERE where there is none.

    That is the same row of the sequence, if its canonical value is still the same, or else if what viewers decoded of
    it in the best quality is as near to the new one, in every channel, as a fresh coding promises.
    """
    places = np.full(1 + max(int(layout.rows.max()), int(base.layout.rows.max())), CODED_HERE)
    places[base.layout.rows] = np.arange(len(base.layout.rows))
    there: NDArray[np.intp] = places[layout.rows]
    rows = np.flatnonzero(there != CODED_HERE)
    fits = _same(layout, base, rows, there[rows]) | _near(layout, base, rows, there[rows])
    there[rows[~fits]] = CODED_HERE
    return there


def _same(layout: GroupLayout, base: BaseGroup, rows: NDArray[np.intp], there: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(n,) whether rows have the canonical values that they had in the base."""
    change = np.abs(base.originals(layout, there) - layout.key_values()[:, rows])
    moved = np.abs(base.layout.key.means[there].astype(np.float64) - layout.key.means[rows])
    cells = _half_cells(base.layout)[there]
    return _within(layout, change, SAME) & (moved <= SAME * cells[:, None]).all(axis=1)


def _near(layout: GroupLayout, base: BaseGroup, rows: NDArray[np.intp], there: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(n,) whether what was decoded in the best quality does for rows: half a step of the codec, half a code, and
    half a cell are what coding them here would promise.
    """
    errors = np.abs(base.values(layout, there, 0) - layout.key_values()[:, rows])
    moved = np.abs(base.spaces[0].means[there] - layout.key.means[rows])
    finer = layout.classes[rows].astype(int) - base.layout.classes[there]
    near = _within(layout, errors, 0.5 + 0.5 / qp_step(KEY_QP))
    return near & (moved <= _half_cells(layout)[rows, None]).all(axis=1) & (finer >= 0) & (finer <= CLASSES)


def _within(layout: GroupLayout, errors: NDArray[np.float64], steps: float) -> NDArray[np.bool_]:
    """(n,) whether all (7 + C, n) errors are at most so many steps."""
    limits = steps * KEY.steps(layout.key_steps, layout.colours)
    return np.asarray((errors <= limits[:, None]).all(axis=0))


def _half_cells(layout: GroupLayout) -> NDArray[np.float64]:
    """(N,) half the sides of the cells of canonical means in the best quality, world units."""
    return layout.grid.step * np.exp2(cell_bits(layout.classes, layout.grid)) / 2


def kept_errors(layout: GroupLayout, base: BaseGroup, tier: int, quality: int) -> NDArray[np.float64]:
    """(7 + C,) the most that kept rows of a tier are off in a key quality, in the units of the channels."""
    rows = layout.kept_rows(tier)
    errors = np.abs(base.values(layout, layout.base_rows[rows], quality) - layout.key_values()[:, rows])
    return np.asarray(errors.max(axis=1, initial=0.0) + ROUNDING * np.abs(layout.key_values()[:, rows]).max(axis=1))
