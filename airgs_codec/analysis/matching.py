"""Matching the rows of a frame with other rows, by what they look like and where they are.

A row has a fingerprint: mean, colour, log-scales and opacity, each in a unit of about what changes from one frame to
the next. Rows are assigned to their nearest in rounds, the closest pairs first; the number of rounds is bounded, so
that the work grows with N log N. A row is sure if the second nearest is much further away than the nearest (the ratio
test of Lowe, Distinctive Image Features from Scale-Invariant Keypoints, 2004, section 7.1). N rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.scene.gaussians import Gaussians

NONE = -1  # in place of a row
SURE_RATIO = 0.6  # of the distances to the nearest and to the second nearest row
LEAST_SURE = 0.3  # share of the rows; with fewer of them frames take more bytes in one group than singly

IN_ORDER, LOST, UNRELATED = "in order", "lost", "unrelated"
Rows = NDArray[np.intp]
Values = NDArray[np.float64]


def attributes(g: Gaussians) -> Values:
    """Return (N, 7) colour, log-scales and opacity, in units of the fingerprint; always finite."""
    scales, alpha = g.log_scales.astype(np.float64) / 0.05, g.opacities().astype(np.float64) / 0.02
    return _finite(np.column_stack([g.sh_dc.astype(np.float64) / 0.05, scales, alpha]))


def fingerprints(g: Gaussians, spacing: float) -> Values:
    """Return (N, 11) mean in units of `spacing` (world units), attributes, number among the rows that equal it."""
    values = np.hstack([_finite(g.means.astype(np.float64) / spacing), attributes(g)])
    return np.column_stack([values, _number_of_equal(values)])


def _finite(values: Values) -> Values:
    return np.where(np.isfinite(values), np.clip(values, -1e30, 1e30), 1e4)  # squares stay finite


def spacing_of(means: NDArray[np.float32]) -> float:
    """Return the median distance, in world units, from a mean to the nearest other one; 1 where all are equal."""
    finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    if len(finite) < 2:
        return 1.0
    distances = cKDTree(finite).query(finite[_some(len(finite))], k=2)[0][:, 1]
    return float(np.median(distances[distances > 0])) if distances.any() else 1.0


def compare_order(a: Gaussians, b: Gaussians) -> str:
    """Return whether rows of two frames of one length are IN_ORDER, LOST or UNRELATED.

    They are in order where nearly every row differs far less from row n of the other frame than from others; lost where
    many surely are another row of it; unrelated where most differ as much as any two rows do. Some rows tell it.
    """
    some = _some(len(a))
    first, second = attributes(a.take(some)), attributes(b.take(some))
    own, others = (np.linalg.norm(second - rows, axis=1) for rows in (first, first[_unrelated(len(some))]))
    # Of fewer than eight rows medians say nothing; tracked rows stay below a tenth of the distance of unrelated ones.
    if len(a) < 8 or np.percentile(own, 95) < 0.1 * np.median(others):
        return IN_ORDER
    spacing = spacing_of(a.means)
    wanted, offered = fingerprints(a, spacing), fingerprints(b, spacing)
    rows, _, sure = _nearest_two(wanted[some], offered)
    if sure.mean() >= LEAST_SURE and (sure & (rows != some)).mean() >= 0.05:
        return LOST
    return IN_ORDER if _correspond(wanted, offered) else UNRELATED


def match_rows(expected: Gaussians, frame: Gaussians) -> tuple[NDArray[np.int32], float]:
    """Return (N,) the row of a frame that each expected row is, and the share of rows that are sure.

    NONE where it is further away than another expected row.
    """
    spacing = spacing_of(expected.means)
    wanted, offered = fingerprints(expected, spacing), fingerprints(frame, spacing)
    _, second, sure = _nearest_two(wanted[_some(len(wanted))], offered)
    order, distances = _assign(wanted, offered)
    far = np.flatnonzero((order != NONE) & (distances > SURE_RATIO * np.median(second)))
    if len(far):  # a distance that may be half too large takes a tenth of the time of an exact one
        order[far[distances[far] > _nearest_two(wanted[far], wanted, 0.5)[1]]] = NONE
    return order, float(sure.mean())


def _nearest_two(wanted: Values, offered: Values, eps: float = 0.0) -> tuple[Rows, Values, NDArray[np.bool_]]:
    """Return the nearest row of `offered` to each of n, the second one's distance, and if that is much larger."""
    distances, rows = cKDTree(offered).query(wanted, k=2, eps=eps, workers=-1)
    return rows[:, 0], distances[:, 1], distances[:, 0] <= SURE_RATIO * distances[:, 1]


def _assign(wanted: Values, offered: Values) -> tuple[NDArray[np.int32], Values]:
    """Return (N,) a row of `offered` for each of `wanted`, (N, 11) and (M, 11), or NONE, and their distance.

    In every round each asks for its nearest free one.
    """
    order, away = np.full(len(wanted), NONE, np.int32), np.full(len(wanted), np.inf)
    asking, free = np.arange(len(wanted)), np.arange(len(offered))
    for _ in range(20):
        if not (len(asking) and len(free)):
            break
        distances, nearest = cKDTree(offered[free]).query(wanted[asking], workers=-1)
        closest = np.argsort(distances, kind="stable")
        taken, winners = np.unique(nearest[closest], return_index=True)
        winners = closest[winners]
        order[asking[winners]], away[asking[winners]] = free[taken], distances[winners]
        asking, free = np.delete(asking, winners), np.delete(free, taken)
    return order, away


def _number_of_equal(values: Values) -> Values:
    """Return (N,) how many equal rows precede each, which separates them: a tree of equal rows would be a list."""
    keys = (values * np.random.default_rng(0).random(values.shape[1])).sum(axis=1)
    order = np.argsort(keys, kind="stable")
    changes = np.diff(keys[order], prepend=np.nan) != 0
    starts = np.maximum.accumulate(np.where(changes, np.arange(len(keys)), 0))
    numbers = np.empty(len(keys))
    numbers[order] = np.arange(len(keys)) - starts
    return numbers


def _correspond(a: Values, b: Values) -> bool:
    """Return whether rows n of (N, 11) differ half as much as unrelated ones in most attributes, else in means."""
    b = np.hstack([b[:, :3] - np.median(b[:, :3] - a[:, :3], axis=0), b[:, 3:]])  # a scene may move as a whole
    own, unrelated = b - a, b - a[_unrelated(len(a))]
    near, far = (np.median(np.abs(of[:, 3:10]), axis=0) for of in (own, unrelated))
    if not (far > 0).any():
        near, far = (np.median(np.linalg.norm(of[:, :3], axis=1), keepdims=True) for of in (own, unrelated))
    ratios = near[far > 0] / far[far > 0]
    return float(np.median(ratios)) <= 0.5 if len(ratios) else True


def _unrelated(count: int) -> Rows:
    return np.random.default_rng(0).permutation(count)


def _some(count: int) -> Rows:
    return np.sort(np.random.default_rng(1).permutation(count)[:2000])
