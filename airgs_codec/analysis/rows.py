"""Which row of a frame is which of the frame before, and which frames share a canonical space.

Row n of a frame must be the same Gaussian in all frames of a group. Where it is not, since writers sort frames anew and
trainings begin anew, rows are matched with those of the frame before; a frame whose rows cannot be matched starts a
group. N rows.

A row is known by its fingerprint: mean, colour, log-scales and opacity, each in a unit of about what changes from one
frame to the next. Rows are given to their nearest in rounds, the closest pairs first; the number of rounds is bounded,
so that the work grows with N log N. A row is sure if the second nearest is much further away than the nearest (the
ratio test of Lowe, Distinctive Image Features from Scale-Invariant Keypoints, 2004, section 7.1).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.progress import Progress, silent
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

FEWEST_ROWS = 8  # below it medians say nothing
LOOKED_AT = 2000  # rows that tell whether the order was lost
SURE_RATIO = 0.6  # of the distances to the nearest and to the second nearest row
LEAST_SURE = 0.3  # share of the rows; with fewer of them frames take more bytes in one group than alone
LEAST_ELSEWHERE = 0.05  # share of the rows that are surely at another place, of frames that lost their order
ALIKE = 0.1  # of the distance between unrelated rows: what tracked rows stay below
NEARLY_ALL = 95  # percent of the rows
CORRESPONDING = 0.5  # of the difference between unrelated rows: above it rows have nothing to do with each other
_ROUNDS = 20
_COLOUR, _LOG_SCALE, _ALPHA = 0.05, 0.05, 0.02  # units of the fingerprint; means are in spacings
_NOT_FINITE = 1e4  # what stands for it, in these units
_LARGEST = 1e30  # in these units, so that squares stay finite

IN_ORDER, LOST, UNRELATED = "in order", "lost", "unrelated"

ROWS = ("auto", "keep", "match")
AUTO, KEEP, MATCH = ROWS
COST = "a frame coded alone takes five to twenty times the bytes of a tracked one"  # fox 5, spinach 7 and 22

DEFAULT_GROUP_FRAMES = 30


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """The rows of a frame in the order of another."""

    order: NDArray[np.int32]  # (N,) row of the frame for each row of the other
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
    sure, nearest = _sure(wanted[looked], offered)
    share = float(sure.mean())
    if share >= LEAST_SURE and (sure & (nearest != looked)).mean() >= LEAST_ELSEWHERE:
        return LOST, share
    return (IN_ORDER if _correspond(wanted, offered) else UNRELATED), share


def match_rows(reference: Gaussians, frame: Gaussians, before: Gaussians | None = None) -> Matched:
    """The row of a frame that each row of a reference, usually the frame before, is; both have N rows.

    `before`: the frame before the reference, in its order; rows are then looked for where they would go on to.
    """
    spacing = spacing_of(reference.means)
    expected = reference
    if before is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            expected = replace(reference, means=2 * reference.means - before.means)
    wanted, offered = fingerprints(expected, spacing), fingerprints(frame, spacing)
    sure, _ = _sure(wanted[_some(len(wanted))], offered)
    return Matched(_assign(wanted, offered), float(sure.mean()))


def _sure(wanted: NDArray[np.float64], offered: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Which of some fingerprints are sure, and the row of `offered` that is nearest to each."""
    if len(offered) < 2:
        return np.ones(len(wanted), np.bool_), np.zeros(len(wanted), np.intp)
    distances, nearest = cKDTree(offered).query(wanted, k=2, workers=-1)
    return distances[:, 0] <= SURE_RATIO * distances[:, 1], nearest[:, 0]


def _assign(wanted: NDArray[np.float64], offered: NDArray[np.float64]) -> NDArray[np.int32]:
    """A row of `offered` for each of `wanted`, both (N, 11): in every round each asks for its nearest free one."""
    order = np.full(len(wanted), -1, np.int32)
    asking, free = np.arange(len(wanted)), np.arange(len(offered))
    for _ in range(_ROUNDS):
        if not len(asking):
            break
        distances, nearest = cKDTree(offered[free]).query(wanted[asking], workers=-1)
        closest = np.argsort(distances, kind="stable")
        taken, winners = np.unique(nearest[closest], return_index=True)
        order[asking[closest[winners]]] = free[taken]
        asking, free = np.delete(asking, closest[winners]), np.delete(free, taken)
    order[asking] = free
    return order


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


@dataclass(frozen=True, slots=True, eq=False)
class Restored:
    """A sequence whose rows correspond inside every group, and what was done about those that did not."""

    sequence: GaussianSequence
    matched: tuple[int, ...] = ()  # frames whose rows were put into the order of those before
    sure: float = 1.0  # share of their rows, the mean over these frames
    unmatched: tuple[int, ...] = ()  # frames whose rows could not be matched with those of the frame before
    alone: tuple[int, ...] = ()  # frames with another number of rows than those on both sides

    @property
    def notes(self) -> list[str]:
        """Tell what happened, and what it costs, in a sentence each."""
        notes = []
        if self.matched:
            how = f"matched again, {self.sure:.1%} of them with confidence"
            notes.append(f"{_spans(self.matched)}: rows were out of order; {how}")
        if self.unmatched:
            reason = f"rows are not those of the frame before (under {LEAST_SURE:.0%} could be matched with confidence)"
            notes.append(f"{_spans(self.unmatched)}: {reason}; each starts a group, and {COST}")
        if self.alone:
            reason = "each has another number of Gaussians than the frames beside it, so that rows cannot be matched"
            notes.append(f"{_spans(self.alone)}: {reason}; coded one by one, and {COST}")
        return notes


def restore_rows(
    sequence: GaussianSequence,
    rows: str = AUTO,
    progress: Progress = silent,
    frames: range | None = None,
    *,
    in_order: bool = False,
) -> Restored:
    """Put the rows of every frame into the order of the first frame of its run; see `count_runs`.

    `rows`: "auto" compares each frame with the one before and matches those that lost their order; "keep" takes rows as
    they are; "match" matches every frame, whether it looks out of order or not. `frames`: only these are looked at, by
    default all. `in_order`: somebody has looked at all of them, and none lost its order. Raises SceneError for a broken
    frame.
    """
    asked = range(len(sequence)) if frames is None else frames
    if rows == KEEP:
        return Restored(sequence)
    runs = [(max(a, asked.start), min(b, asked.stop)) for a, b in count_runs(sequence)]
    runs = [(start, stop) for start, stop in runs if start < stop]
    alone = tuple(frame for frame in _alone(sequence) if frame in asked)
    if rows == AUTO and in_order:
        return Restored(sequence, alone=alone)
    orders: dict[int, NDArray[np.int32]] = {}
    sure, breaks = {}, []
    for start, stop in runs:
        run = _Run(sequence.read(start), rows)
        for frame in range(start + 1, stop):
            progress("order of rows", frame, len(sequence))
            run.add(sequence.read(frame))
            if run.order is not None:
                orders[frame] = run.order
            if run.fresh is not None:
                sure[frame] = run.fresh
            if run.broken:
                breaks.append(frame)
    if not orders and not breaks:
        return Restored(sequence, alone=alone)
    restored = replace(sequence, orders=orders, breaks=(*sequence.breaks, *breaks))
    share = float(np.mean(list(sure.values()))) if sure else 1.0
    return Restored(restored, tuple(sure), share, tuple(breaks), alone)


class _Run:
    """The frames of a run, one after the other."""

    def __init__(self, first: Gaussians, rows: str) -> None:
        self._rows = rows
        self._file = self._last = first  # the newest frame, as its file has it and in order
        self._before: Gaussians | None = None
        self.order: NDArray[np.int32] | None = None  # of the newest frame; None: as its file has it
        self.fresh: float | None = None  # share of sure rows, where the newest frame was matched
        self.broken = False  # the newest frame has nothing to do with the one before

    def add(self, frame: Gaussians) -> None:
        """One more frame."""
        state, _ = (LOST, 1.0) if self._rows == MATCH else compare_order(self._file, frame)
        self.fresh, self.broken = None, False
        if state == LOST:
            matched = match_rows(self._last, frame, self._before)
            as_in_file = np.arange(len(frame))
            if not np.array_equal(matched.order, as_in_file if self.order is None else self.order):
                self.order, self.fresh = matched.order, matched.sure
            if np.array_equal(matched.order, as_in_file):
                self.order = None
        elif state != IN_ORDER:
            self.order, self.broken = None, True
        self._file, self._before = frame, None if self.broken else self._last
        self._last = frame if self.order is None else frame.take(self.order)


def _alone(sequence: GaussianSequence) -> tuple[int, ...]:
    """Frames between two changes of the number of rows, where there is more than one such; no named keyframes."""
    breaks = {*sequence.breaks}
    ones = [start for start, stop in count_runs(sequence) if stop - start == 1 and not {start, stop} & breaks]
    return tuple(ones) if len(ones) > 1 and sequence.keyframes is None else ()


def _spans(frames: Sequence[int]) -> str:
    """Frame numbers, ascending, in words: frame 7, or frames 1-4, 7, 9-11."""
    spans: list[str] = []
    for _, members in itertools.groupby(enumerate(frames), key=lambda pair: pair[1] - pair[0]):
        numbers = [number for _, number in members]
        spans.append(str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]}-{numbers[-1]}")
    return f"frame{'s' * (len(frames) > 1)} {', '.join(spans)}"


@dataclass(frozen=True, slots=True)
class Grouping:
    """The groups of a sequence, and why they are what they are."""

    spans: list[tuple[int, int]]  # frames [start, stop), one after the other, covering the sequence
    notes: list[str]


def middle_frame(start: int, stop: int) -> int:
    """The frame in the middle of a group [start, stop)."""
    return start + (stop - start) // 2


def count_runs(sequence: GaussianSequence) -> list[tuple[int, int]]:
    """Frames [start, stop) of each run: between named keyframes, changes of the number of rows, and `breaks`."""
    starts = sorted({0, *_changes(sequence), *sequence.breaks, *(sequence.keyframes or ())})
    return list(zip(starts, [*starts[1:], len(sequence)], strict=True))


def _changes(sequence: GaussianSequence) -> list[int]:
    """Frames with another number of rows than the one before."""
    counts = [header.count for header in sequence.headers]
    return [i for i in range(1, len(counts)) if counts[i] != counts[i - 1]]


def plan_groups(sequence: GaussianSequence, group_frames: int = DEFAULT_GROUP_FRAMES) -> Grouping:
    """Split a sequence into groups: at the keyframes that it names, else every `group_frames` frames.

    A group also starts where the number of Gaussians changes, or rows are not those of the frame before
    (`analysis.rows`). Notes say where the number overrode the keyframes.
    """
    if sequence.keyframes is None:
        runs = count_runs(sequence)
        return Grouping(
            [(i, min(i + group_frames, stop)) for start, stop in runs for i in range(start, stop, group_frames)], []
        )
    added = sorted({*_changes(sequence)} - {*sequence.keyframes})
    notes = [f"frame {i}: the count changes inside a group, a new group starts" for i in added]
    return Grouping(count_runs(sequence), notes)


def closed_groups(sequence: GaussianSequence, start: int, group_frames: int, done: bool) -> list[tuple[int, int]]:
    """Groups [start, stop) from frame `start` on that no frame will join any more, as `plan_groups` makes them.

    The sequence is the part of a growing one that is there; `done` says that no more will come.
    """
    spans = []
    for first, stop in count_runs(sequence):
        most = group_frames if sequence.keyframes is None else stop - first
        for i in range(max(start, first), stop, most):
            end = min(i + most, stop)
            if done or stop < len(sequence) or (sequence.keyframes is None and end - i == most):
                spans.append((i, end))
    return spans
