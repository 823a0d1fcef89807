"""Assigns rows to key tiers and to the deepest level that carries their updates. N rows of a group."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import STATIC

DEFAULT_TIERS = (0.8, 0.2)  # core, rest


def assign_tiers(usage: NDArray[np.float64], shares: Sequence[float] = DEFAULT_TIERS) -> NDArray[np.uint8]:
    """(N,) tier of each row: the rows with the highest `usage` (N,) are in the first tier, ties by row.

    Tiers hold `shares` of the rows, which sum to 1. The first has at least one row, since some levels have no other.
    """
    order = np.argsort(-usage, kind="stable")
    bounds = np.maximum(np.rint(np.cumsum(shares) * len(usage)), 1).astype(np.intp)
    tiers = np.empty(len(usage), np.uint8)
    tiers[order] = np.searchsorted(bounds[:-1], np.arange(len(usage)), side="right")
    return tiers


def assign_depths(
    score: NDArray[np.float64],
    moving: NDArray[np.bool_],
    pruned: Sequence[float],
    tiers: NDArray[np.uint8] | None = None,
    level_tiers: Sequence[int] = (),
) -> NDArray[np.uint8]:
    """(N,) deepest level that carries each row; STATIC for rows that no level carries.

    Level j withholds the share `pruned[j]` of the `moving` rows, those with the lowest `score` (the paper prunes by
    usage frequency). Where `tiers`, the (N,) tier of each row, is given, it also withholds all rows outside of the
    first `level_tiers[j]` tiers. Shares that ascend and tiers that descend make levels nested.
    """
    rows = np.flatnonzero(moving)
    ranked = rows[np.argsort(-score[rows], kind="stable")]
    depths = np.full(len(score), STATIC, np.uint8)
    for level, share in enumerate(pruned):
        kept = ranked[: round((1 - share) * len(ranked))]
        depths[kept if tiers is None else kept[tiers[kept] < level_tiers[level]]] = level
    return depths
