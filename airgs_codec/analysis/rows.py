"""Sequences whose rows lost their order, or are missing in some frames: rows of a run of frames made to correspond.

Row n of a frame must be the same Gaussian in all frames of a group. Where it is not, since writers sort frames anew and
drop Gaussians that they do not need, rows are matched with those of earlier frames; a missing row has no opacity in a
frame. A frame whose rows cannot be matched starts a group. N Gaussians of a run, n rows of a frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.grouping import count_changes, count_runs, named_runs
from airgs_codec.analysis.matching import IN_ORDER, LEAST_SURE, LOST, NONE, compare_order, match_rows
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.gaussians import Gaussians, mix_rows
from airgs_codec.scene.sequence import GaussianSequence

ROWS = ("auto", "keep", "match")
AUTO, KEEP, MATCH = ROWS
COST = "a frame coded alone takes two to thirteen times the bytes of a tracked one"  # docs/results/size.md


@dataclass(frozen=True, slots=True, eq=False)
class Restored:
    """A sequence whose rows correspond inside every group, and how."""

    sequence: GaussianSequence
    matched: tuple[int, ...] = ()  # frames whose rows were put into the order of those before
    sure: float = 1.0  # share of their rows, the mean over these frames
    missing: float = 0.0  # share of the Gaussians of a run that are missing in a frame, the mean over all frames
    unmatched: tuple[int, ...] = ()  # frames whose rows could not be matched with those of the frame before
    alone: tuple[int, ...] = ()  # of these, frames with another number of rows than those on both sides

    @property
    def notes(self) -> list[str]:
        """Return what happened, and what it costs, in a sentence each."""
        notes = []
        if self.matched:
            how = f"matched again, {self.sure:.1%} of them with confidence"
            missing = f"; a frame lacks {self.missing:.1%} of them on average" if self.missing else ""
            notes.append(f"{spans_of(self.matched)}: rows were out of order; {how}{missing}")
        if self.unmatched:
            reason = f"rows are not those of the frame before (under {LEAST_SURE:.0%} could be matched with confidence)"
            notes.append(f"{spans_of(self.unmatched)}: {reason}; each starts a group, and {COST}")
        if self.alone:
            reason = "each has another number of Gaussians than the frames beside it, and rows cannot be matched"
            notes.append(f"{spans_of(self.alone)}: {reason}; coded one by one, and {COST}")
        return notes


def first_look(sequence: GaussianSequence, rows: str = AUTO) -> tuple[bool, str]:
    """Return whether the first three frames share rows, in whatever order, and a phrase unless they are in order.

    Raises SceneError for a broken frame.
    """
    count = min(3, len(sequence))
    found = restore_rows(sequence, rows, frames=range(count))
    if found.unmatched or len(found.sequence.breaks) > len(sequence.breaks):
        return False, f"rows: the first {count} frames do not share them"
    if found.missing > 0.1:  # rows are hardly the same
        return False, f"rows: of those of the first {count} frames, each lacks {found.missing:.0%}"
    return True, "rows: out of order, so they are matched again" if found.matched else ""


def restore_rows(
    sequence: GaussianSequence,
    rows: str = AUTO,
    progress: Progress = silent,
    frames: range | None = None,
    *,
    in_order: bool = False,
) -> Restored:
    """Put the rows of every frame into the order of one list of Gaussians for each run of frames; see `named_runs`.

    `rows`: "auto" compares each frame with the one before and matches those that lost their order or have another
    number of rows; "keep" takes rows as they are; "match" matches every frame, whether it looks out of order or not.
    `frames`: only these are looked at, by default all. `in_order`: all frames of equal numbers of rows were compared,
    and none lost its order. Raises SceneError for a broken frame.
    """
    changes = set(count_changes(sequence))
    if rows == KEEP or (rows == AUTO and in_order and not changes):
        return Restored(sequence)
    asked = range(len(sequence)) if frames is None else frames
    runs = [(max(a, asked.start), min(b, asked.stop)) for a, b in named_runs(sequence)]
    runs, done = [(start, stop) for start, stop in runs if start < stop], list[_Run]()
    for start, stop in runs:
        done.append(_Run(start, sequence.read(start), rows))
        for frame in range(start + 1, stop):
            progress("order of rows", frame, len(sequence))
            g = sequence.read(frame)
            if not done[-1].add(frame, g):
                done.append(_Run(frame, g, rows))
    breaks = sorted({run.start for run in done} - {start for start, _ in runs})
    orders = {frame: order for run in done for frame, order in run.orders().items()}
    sure = {frame: share for run in done for frame, share in run.sure.items()}
    restored = replace(sequence, orders=orders, breaks=(*sequence.breaks, *breaks)) if orders or breaks else sequence
    share = float(np.mean(list(sure.values()))) if sure else 1.0
    missing = float(np.mean([(order == NONE).mean() for order in orders.values()])) if orders else 0.0
    unmatched = tuple(frame for frame in breaks if frame not in changes)
    alone = tuple(frame for frame in _single_frames(sequence) if frame in asked and frame not in orders)
    return Restored(restored, tuple(sure), share, missing, unmatched, alone)


class _Run:
    """Frames one after the other that share a list of N Gaussians, which grows by those that no frame had before."""

    def __init__(self, start: int, first: Gaussians, rows: str) -> None:
        self.start, self._matches_all = start, rows == MATCH
        self.sure: dict[int, float] = {}  # share of sure rows, of frames that were put into another order
        self._file, self._at = first, start  # the newest frame, as its file has it
        self._ids = [np.arange(len(first), dtype=np.int32)]  # of each frame (n,): which Gaussian each row is
        self._known = first  # N Gaussians as they were seen last
        self._seen = np.full(len(first), start)  # (N,) in which frame
        self._velocity = np.zeros((len(first), 3), np.float32)  # (N, 3) world units a frame

    def add(self, number: int, frame: Gaussians) -> bool:
        """Take the next frame; False where it is unrelated to those before, and not of the run."""
        state, ids = LOST, self._ids[-1]
        if not self._matches_all and len(frame) == len(self._file):
            state = compare_order(self._file, frame)
        if state != IN_ORDER:
            found = self._match(frame) if state == LOST else None
            if found is None:
                return False
            ids, sure = found
            if len(frame) != len(self._file) or not np.array_equal(ids, self._ids[-1]):
                self.sure[number] = sure
        self._take(number, frame, ids)
        return True

    def _match(self, frame: Gaussians) -> tuple[NDArray[np.int32], float] | None:
        """Return (n,) which Gaussian each row is, and the share of sure ones; None where too few are known."""
        with np.errstate(over="ignore", invalid="ignore"):
            expected = replace(self._known, means=self._known.means + self._velocity)
        order, sure = match_rows(expected, frame)
        known = np.flatnonzero(order != NONE)
        ids = np.full(len(frame), NONE, np.int32)
        ids[order[known]] = known
        born = np.flatnonzero(ids == NONE)
        if len(frame) != len(self._file) and (sure < LEAST_SURE or len(born) > 0.5 * len(frame)):
            return None
        count = len(self._known) + len(born)
        if 0.5 * count > max(len(frame), *map(len, self._ids)):  # the fullest frame would not have half of them
            return None
        ids[born] = np.arange(len(self._known), count)
        return ids, sure

    def _take(self, number: int, frame: Gaussians, ids: NDArray[np.int32]) -> None:
        born = np.flatnonzero(ids >= len(self._known))
        if len(born):
            self._known = Gaussians.join([self._known, frame.take(born)])
            self._seen = np.concatenate([self._seen, np.full(len(born), number)])
            self._velocity = np.concatenate([self._velocity, np.zeros((len(born), 3), np.float32)])
        order = _inverse(ids, len(self._known))
        present, now = order != NONE, frame.take(np.maximum(order, 0))
        moved = present & (self._seen == self._at)
        with np.errstate(over="ignore", invalid="ignore"):
            self._velocity = np.where(moved[:, None], now.means - self._known.means, np.float32(0))
        self._known = mix_rows(now, self._known, present)
        self._seen[present] = number
        self._ids.append(ids)
        self._file, self._at = frame, number

    def orders(self) -> dict[int, NDArray[np.int32]]:
        """Return (N,) rows of the file of each frame that does not have just these rows in just this order."""
        count = len(self._known)
        found = {self.start + i: _inverse(ids, count) for i, ids in enumerate(self._ids)}
        return {frame: order for frame, order in found.items() if not np.array_equal(order, np.arange(count))}


def _inverse(ids: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Return (count,) the row of each Gaussian, NONE where it has none, from (n,) the Gaussian of each row."""
    order = np.full(count, NONE, np.int32)
    order[ids] = np.arange(len(ids))
    return order


def _single_frames(sequence: GaussianSequence) -> tuple[int, ...]:
    """Return frames between two changes of the number of rows, where there are several and no named keyframes."""
    breaks = {*sequence.breaks}
    ones = [start for start, stop in count_runs(sequence) if stop - start == 1 and not {start, stop} & breaks]
    return tuple(ones) if len(ones) > 1 and sequence.keyframes is None else ()


def spans_of(frames: Sequence[int]) -> str:
    """Return frame numbers, ascending, in words: frame 7, or frames 1-4, 7, 9-11."""
    spans: list[str] = []
    for _, members in itertools.groupby(enumerate(frames), key=lambda pair: pair[1] - pair[0]):
        numbers = [number for _, number in members]
        spans.append(str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]}-{numbers[-1]}")
    return f"frame{'s' * (len(frames) > 1)} {', '.join(spans)}"
