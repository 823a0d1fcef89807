"""Which row of a frame is which of other rows, by what they look like and where they are.

A row is known by its fingerprint: mean, colour, log-scales and opacity, each in a unit of about what changes from one
frame to the next. Rows are given to their nearest in rounds, the closest pairs first; the number of rounds is bounded,
so that the work grows with N log N. A row is sure if the second nearest is much further away than the nearest (the
ratio test of Lowe, Distinctive Image Features from Scale-Invariant Keypoints, 2004, section 7.1). N rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.scene.gaussians import Gaussians

NONE = -1  # in place of a row
FEWEST_ROWS = 8  # below it medians say nothing
LOOKED_AT = 2000  # rows that tell whether the order was lost
SURE_RATIO = 0.6  # of the distances to the nearest and to the second nearest row
LEAST_SURE = 0.3  # share of the rows; with fewer of them frames take more bytes in one group than alone
LEAST_ELSEWHERE = 0.05  # share of the rows that are surely at another place, of frames that lost their order
ALIKE = 0.1  # of the distance between unrelated rows: what tracked rows stay below
NEARLY_ALL = 95  # percent of the rows
CORRESPONDING = 0.5  # of the difference between unrelated rows: above it rows have nothing to do with each other
ABOUT = 0.5  # share by which the distance between rows of a frame may be too large: a tenth of the time of an exact one
_ROUNDS = 20
_COLOUR, _LOG_SCALE, _ALPHA = 0.05, 0.05, 0.02  # units of the fingerprint; means are in spacings
_NOT_FINITE = 1e4  # what stands for it, in these units
_LARGEST = 1e30  # in these units, so that squares stay finite

IN_ORDER, LOST, UNRELATED = "in order", "lost", "unrelated"


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """The rows of a frame in the order of others."""

    order: NDArray[np.int32]  # (N,) row of the frame for each of the others, or NONE
    sure: float  # share of the rows that no other row is nearly as close to


def attributes(g: Gaussians) -> NDArray[np.float64]:
    """(N, 7) colour, log-scales and opacity, in units of the fingerprint; always finite."""
    scales, alpha = g.log_scales.astype(np.float64) / _LOG_SCALE, g.opacities().astype(np.float64) / _ALPHA
    return _finite(np.column_stack([g.sh_dc.astype(np.float64) / _COLOUR, scales, alpha]))


def fingerprints(g: Gaussians, spacing: float) -> NDArray[np.float64]:
    """(N, 11) mean in units of `spacing` (world units), attributes, number among the rows that equal it."""
    values = np.hstack([_finite(g.means.astype(np.float64) / spacing), attributes(g)])
    return np.column_stack([values, _number_of_equal(values)])


def _finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isfinite(values), np.clip(values, -_LARGEST, _LARGEST), _NOT_FINITE)


def spacing_of(means: NDArray[np.float32]) -> float:
    """The median distance, in world units, from a mean to the nearest other one; 1 where all are at one place."""
    finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    if len(finite) < 2:
        return 1.0
    distances, _ = cKDTree(finite).query(finite[_some(len(finite))], k=2)
    apart = distances[:, 1][distances[:, 1] > 0]
    return float(np.median(apart)) if len(apart) else 1.0


def compare_order(a: Gaussians, b: Gaussians) -> tuple[str, float]:
    """Whether rows of two frames of one length are IN_ORDER, LOST or UNRELATED, and the share of rows that are sure.

    They are in order where nearly every row differs far less from row n of the other frame than from others; lost where
    many surely are another row of it; unrelated where most differ as much as any two rows do.
    """
    first, second = attributes(a), attributes(b)
    if len(a) < FEWEST_ROWS or _alike(first, second):
        return IN_ORDER, 1.0
    spacing = spacing_of(a.means)
    wanted, offered = fingerprints(a, spacing), fingerprints(b, spacing)
    looked = _some(len(a))
    near = _nearest_two(wanted[looked], offered)
    share = float(near.sure.mean())
    if share >= LEAST_SURE and (near.sure & (near.rows != looked)).mean() >= LEAST_ELSEWHERE:
        return LOST, share
    return (IN_ORDER if _correspond(wanted, offered) else UNRELATED), share


def match_rows(expected: Gaussians, frame: Gaussians) -> Matched:
    """The row of a frame that each of N expected rows is; NONE where it is further away than another expected row."""
    spacing = spacing_of(expected.means)
    wanted, offered = fingerprints(expected, spacing), fingerprints(frame, spacing)
    near = _nearest_two(wanted[_some(len(wanted))], offered)
    order, distances = _assign(wanted, offered)
    far = np.flatnonzero((order != NONE) & (distances > SURE_RATIO * np.median(near.second)))
    if len(far):
        order[far[distances[far] > _nearest_two(wanted[far], wanted, ABOUT).second]] = NONE
    return Matched(order, float(near.sure.mean()))


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """The rows that are nearest to n fingerprints."""

    first: NDArray[np.float64]  # (n,) distance of the nearest
    second: NDArray[np.float64]  # (n,) and of the second nearest
    rows: NDArray[np.intp]  # (n,) the nearest

    @property
    def sure(self) -> NDArray[np.bool_]:
        """(n,) whether the second is much further away."""
        return self.first <= SURE_RATIO * self.second


def _nearest_two(wanted: NDArray[np.float64], offered: NDArray[np.float64], about: float = 0.0) -> _Near:
    """The nearest rows of `offered`; where there is but one it is sure. Others may be nearer by the share `about`."""
    distances, rows = cKDTree(offered).query(wanted, k=2, eps=about, workers=-1)
    return _Near(distances[:, 0], distances[:, 1], rows[:, 0])


def _assign(wanted: NDArray[np.float64], offered: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """(N,) a row of `offered` for each of `wanted`, (N, 11) and (M, 11), or NONE, and how far apart both are.

    In every round each asks for its nearest free one.
    """
    order, apart = np.full(len(wanted), NONE, np.int32), np.full(len(wanted), np.inf)
    asking, free = np.arange(len(wanted)), np.arange(len(offered))
    for _ in range(_ROUNDS):
        if not (len(asking) and len(free)):
            break
        distances, nearest = cKDTree(offered[free]).query(wanted[asking], workers=-1)
        closest = np.argsort(distances, kind="stable")
        taken, winners = np.unique(nearest[closest], return_index=True)
        winners = closest[winners]
        order[asking[winners]], apart[asking[winners]] = free[taken], distances[winners]
        asking, free = np.delete(asking, winners), np.delete(free, taken)
    return order, apart


def _number_of_equal(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) how many equal rows come before each: it tells equal rows apart, on which a tree would take for ever."""
    keys = (values * np.random.default_rng(0).random(values.shape[1])).sum(axis=1)
    order = np.argsort(keys, kind="stable")
    changes = np.diff(keys[order], prepend=np.nan) != 0
    starts = np.maximum.accumulate(np.where(changes, np.arange(len(keys)), 0))
    numbers = np.empty(len(keys))
    numbers[order] = np.arange(len(keys)) - starts
    return numbers


def _alike(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether nearly all rows n of (N, 7) attributes differ far less than unrelated ones do."""
    own, unrelated = (np.linalg.norm(b - rows, axis=1) for rows in (a, a[_unrelated(len(a))]))
    return bool(np.percentile(own, NEARLY_ALL) < ALIKE * np.median(unrelated))


def _correspond(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether rows n of (N, 11) differ less than unrelated ones: in most attributes, or in means if those are equal."""
    unrelated = _unrelated(len(a))
    parts = [slice(i, i + 1) for i in range(3, 10)]
    moved = b[:, :3] - a[:, :3]
    b = np.hstack([b[:, :3] - np.median(moved, axis=0), b[:, 3:]])  # a scene that moves as a whole is tracked
    ratios = [_ratio(a[:, part], b[:, part], unrelated) for part in parts]
    known = [ratio for ratio in ratios if ratio is not None] or [_ratio(a[:, :3], b[:, :3], unrelated) or 0.0]
    return float(np.median(known)) <= CORRESPONDING


def _ratio(a: NDArray[np.float64], b: NDArray[np.float64], unrelated: NDArray[np.intp]) -> float | None:
    """Median difference of rows n over that of unrelated rows; None where these do not differ."""
    most = float(np.median(np.linalg.norm(b - a[unrelated], axis=1)))
    return float(np.median(np.linalg.norm(b - a, axis=1))) / most if most > 0 else None


def _unrelated(count: int) -> NDArray[np.intp]:
    return np.random.default_rng(0).permutation(count)


def _some(count: int) -> NDArray[np.intp]:
    """At most LOOKED_AT of so many rows, drawn alike every time."""
    return np.sort(np.random.default_rng(1).permutation(count)[:LOOKED_AT])
