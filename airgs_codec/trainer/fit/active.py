"""Finding what may change at a frame: the rows that make what moves, and the tiles of the views that show them.

A row is active when a good part of what it gives to all pictures falls on pixels that do not rest. The other rows are
no variables at all and stay as they are, bit for bit. N Gaussians, A of them active, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render import cpu
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import Recent, View
from airgs_codec.trainer.fit.parameters import InMotion, Parameters, loading

SHARE = 0.2  # of a row's blending weights over all views that fall on moving pixels, from which it is active
REST_BYTES = 1 << 30  # of whole pictures, 16 bytes a pixel; those that are no longer buffered are drawn again
SHOWN = 8.0  # pixels of active rows in a tile, from which it is drawn


@dataclass(frozen=True, slots=True, eq=False)
class Active:
    """The rows that may change at a frame, and the views that show them."""

    rows: NDArray[np.intp]  # (A,) ascending
    views: list[View]  # those that show it, with the tiles that do


@dataclass(frozen=True, slots=True, eq=False)
class Scope:
    """The part of the rows that a fit may change, and the views that it is fitted to."""

    views: Sequence[View]
    resting: Resting | None = None  # None: anything may change

    @property
    def empty(self) -> bool:
        return self.resting is not None and not (len(self.resting.active) and self.views)

    def rows(self, p: Parameters) -> Parameters:
        """The rows that may change, of a value for each."""
        if self.resting is None:
            return p
        return {name: value[self.resting.active] for name, value in p.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Resting:
    """Rows of which only some are fitted; rows that are added come after them."""

    rows: Parameters  # (N, ...) as they are
    active: torch.Tensor  # (A,)

    def joined(self, fitted: Parameters) -> Parameters:
        """All rows, from the A that are fitted and what was added after them."""
        count = len(self.active)
        if len(fitted["means"]) == count:
            return {name: value.index_copy(0, self.active, fitted[name]) for name, value in self.rows.items()}
        whole = {name: value.index_copy(0, self.active, fitted[name][:count]) for name, value in self.rows.items()}
        return {name: torch.cat([value, fitted[name][count:]]) for name, value in whole.items()}

    def picked(self, values: torch.Tensor) -> torch.Tensor:
        """The inverse of `joined`: of a value for each row, those of the rows that are fitted."""
        n = len(self.rows["means"])
        return torch.cat([values[:n][self.active], values[n:]])


def find_active(
    before: Gaussians | InMotion, views: Sequence[View], moving: Sequence[NDArray[np.bool_]], renderer: Renderer = CPU
) -> Active:
    """Find what may change, from the Gaussians of the frame before and what moves (H, W) in each view."""
    loaded, rows = loading(before, renderer), len(before.gaussians if isinstance(before, InMotion) else before)
    rests: Recent[int, _Rest] = Recent(
        lambda place: _Rest(loaded(views[place].after).draw(views[place].camera)), REST_BYTES
    )
    weights, on_moving, whole = [], np.zeros(rows), np.zeros(rows)
    for place, (view, mask) in enumerate(zip(views, moving, strict=True)):
        w = loaded(view.after).weights(view.camera, mask)
        on_moving += np.bincount(w.ids, w.inside, rows)
        whole += np.bincount(w.ids, w.total, rows)
        rests.put(place, _Rest(w.picture))
        weights.append((w.shape, w.tiles, w.ids, w.total))
    active = on_moving > SHARE * np.maximum(whole, 1e-9)
    drawn = []
    for place, (view, mask, (shape, of_pair, ids, total)) in enumerate(zip(views, moving, weights, strict=True)):
        shown = np.bincount(of_pair, total * active[ids], shape[0] * shape[1]).reshape(shape)
        tiles = (shown >= SHOWN) | _any_in_tiles(mask, shape)
        if tiles.any():
            drawn.append(replace(view, redraw=cpu.Redraw(tiles, partial(_picture, rests, place), active)))
    return Active(np.flatnonzero(active), drawn)


@dataclass(frozen=True, slots=True, eq=False)
class _Rest:
    """The whole picture of a view before anything changes."""

    picture: cpu.Render

    @property
    def nbytes(self) -> int:
        return self.picture.rgb.nbytes + self.picture.transmittance.nbytes


def _picture(rests: Recent[int, _Rest], place: int) -> cpu.Render:
    return rests.get(place).picture


def _any_in_tiles(mask: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(down, across) whether a tile has a pixel of the mask (H, W)."""
    side = cpu.TILE
    padded = np.zeros((shape[0] * side, shape[1] * side), np.bool_)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(padded.reshape(shape[0], side, shape[1], side).any(axis=(1, 3)))
