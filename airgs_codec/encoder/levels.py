"""Which rows come first (key tiers) and whose updates are sent (depths). N rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import STATIC

DEFAULT_TIERS = (0.8, 0.2)  # core, rest


def assign_tiers(usage: NDArray[np.float64], shares: Sequence[float] = DEFAULT_TIERS) -> NDArray[np.uint8]:
    """(N,) usage -> (N,) tier: the most used first, ties by row; `shares` of the rows each, summing to 1.

    The first tier has at least one row: some levels do with it.
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
    """(N,) depth: the deepest level that carries a row; STATIC for rows that no level does.

    Level j withholds the `pruned[j]` share of the moving rows with the lowest score (paper: p keeps the Gaussians
    with the highest usage frequency), and with `tiers`, the (N,) tier of each row, all rows that are not in the first
    `level_tiers[j]` of them. Ascending shares and descending tiers make levels nested.
    """
    rows = np.flatnonzero(moving)
    ranked = rows[np.argsort(-score[rows], kind="stable")]
    depths = np.full(len(score), STATIC, np.uint8)
    for level, share in enumerate(pruned):
        kept = ranked[: round((1 - share) * len(ranked))]
        depths[kept if tiers is None else kept[tiers[kept] < level_tiers[level]]] = level
    return depths
