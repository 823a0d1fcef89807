"""Sequences whose rows lost their order: writers sort every frame anew, trainings begin anew with every frame.

Row n of a frame must be the same Gaussian in all frames of a group. Where it is not, rows are matched with those of the
frame before; a frame whose rows cannot be matched starts a group.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.grouping import count_runs
from airgs_codec.analysis.matching import IN_ORDER, LEAST_SURE, LOST, compare_order, match_rows
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

ROWS = ("auto", "keep", "match")
AUTO, KEEP, MATCH = ROWS
COST = "a frame coded alone takes five to twenty times the bytes of a tracked one"  # fox 5, spinach 7 and 22


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
        """What happened, and what it costs, in a sentence each."""
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
