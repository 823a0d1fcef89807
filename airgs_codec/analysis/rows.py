"""Sequences whose rows lost their order, or that lack rows in some frames: rows of a run of frames made to correspond.

Row n of a frame must be the same Gaussian in all frames of a group. Where it is not, since writers sort frames anew and
drop Gaussians that they do not need, rows are matched with those that were seen before; a row that a frame lacks has no
opacity in it. A frame whose rows cannot be matched starts a group. N Gaussians of a run, n rows of a frame.
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
COST = "a frame coded alone takes five to twenty times the bytes of a tracked one"  # fox 5, spinach 7 and 22
LEAST_KNOWN = 0.5  # share of the rows of a frame that a run knows; with fewer the frame starts another
LOOKED_FRAMES = 3  # of a sequence, before work begins
FEW_MISSING = 0.1  # share of the Gaussians that a frame may lack; with more of them rows are hardly the same
MOST_MISSING = 0.5  # share of the Gaussians of a run that its fullest frame may lack; with more it ends


@dataclass(frozen=True, slots=True, eq=False)
class Restored:
    """A sequence whose rows correspond inside every group, and what was done about those that did not."""

    sequence: GaussianSequence
    matched: tuple[int, ...] = ()  # frames whose rows were put into the order of those before
    sure: float = 1.0  # share of their rows, the mean over these frames
    missing: float = 0.0  # share of the Gaussians of a run that a frame lacks, the mean over all frames
    unmatched: tuple[int, ...] = ()  # frames whose rows could not be matched with those of the frame before
    alone: tuple[int, ...] = ()  # of these, frames with another number of rows than those on both sides

    @property
    def notes(self) -> list[str]:
        """Tell what happened, and what it costs, in a sentence each."""
        notes = []
        if self.matched:
            how = f"matched again, {self.sure:.1%} of them with confidence"
            lacking = f"; a frame lacks {self.missing:.1%} of them on average" if self.missing else ""
            notes.append(f"{spans_of(self.matched)}: rows were out of order; {how}{lacking}")
        if self.unmatched:
            reason = f"rows are not those of the frame before (under {LEAST_SURE:.0%} could be matched with confidence)"
            notes.append(f"{spans_of(self.unmatched)}: {reason}; each starts a group, and {COST}")
        if self.alone:
            reason = "each has another number of Gaussians than the frames beside it, and rows cannot be matched"
            notes.append(f"{spans_of(self.alone)}: {reason}; coded one by one, and {COST}")
        return notes


@dataclass(frozen=True, slots=True)
class Outlook:
    """What the first frames say of the rows of all."""

    shared: bool  # rows are the same Gaussians, in whatever order
    words: str  # what is known of them; empty where they are in order


def outlook(sequence: GaussianSequence, rows: str = AUTO) -> Outlook:
    """Look at the rows of the first LOOKED_FRAMES frames. Raises SceneError for a broken frame."""
    looked = min(LOOKED_FRAMES, len(sequence))
    found = restore_rows(sequence, rows, frames=range(looked))
    if found.unmatched or len(found.sequence.breaks) > len(sequence.breaks):
        return Outlook(False, f"rows: the first {looked} frames do not share them")
    if found.missing > FEW_MISSING:
        return Outlook(False, f"rows: of those of the first {looked} frames, each lacks {found.missing:.0%}")
    return Outlook(True, "rows: out of order, so they are matched again" if found.matched else "")


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
    `frames`: only these are looked at, by default all. `in_order`: somebody has looked at all frames of equal numbers
    of rows, and none lost its order. Raises SceneError for a broken frame.
    """
    asked = range(len(sequence)) if frames is None else frames
    if rows == KEEP:
        return Restored(sequence)
    runs = [(max(a, asked.start), min(b, asked.stop)) for a, b in named_runs(sequence)]
    runs = [(start, stop) for start, stop in runs if start < stop]
    changes = set(count_changes(sequence))
    lone = [frame for frame in _alone(sequence) if frame in asked]
    if rows == AUTO and in_order and not changes:
        return Restored(sequence)
    done: list[_Run] = []
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
    return Restored(
        restored,
        tuple(sure),
        float(np.mean(list(sure.values()))) if sure else 1.0,
        float(np.mean([(order == NONE).mean() for order in orders.values()])) if orders else 0.0,
        tuple(frame for frame in breaks if frame not in changes),
        tuple(frame for frame in lone if frame not in orders),
    )


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
        """Take the next frame; False where it has nothing to do with those before, and is not of the run."""
        state = LOST
        if not self._matches_all and len(frame) == len(self._file):
            state, _ = compare_order(self._file, frame)
        if state == IN_ORDER:
            ids = self._ids[-1]
        elif state == LOST:
            found = self._match(frame)
            if found is None:
                return False
            ids, sure = found
            if len(frame) != len(self._file) or not np.array_equal(ids, self._ids[-1]):
                self.sure[number] = sure
        else:
            return False
        self._take(number, frame, ids)
        return True

    def _match(self, frame: Gaussians) -> tuple[NDArray[np.int32], float] | None:
        """(n,) which Gaussian each row of a frame is, and the share of sure ones; None where too few are known."""
        with np.errstate(over="ignore", invalid="ignore"):
            expected = replace(self._known, means=self._known.means + self._velocity)
        matched = match_rows(expected, frame)
        there = np.flatnonzero(matched.order != NONE)
        ids = np.full(len(frame), NONE, np.int32)
        ids[matched.order[there]] = there
        born = np.flatnonzero(ids == NONE)
        others = len(frame) != len(self._file)
        if others and (matched.sure < LEAST_SURE or len(born) > (1 - LEAST_KNOWN) * len(frame)):
            return None
        count = len(self._known) + len(born)
        if count * (1 - MOST_MISSING) > max(len(frame), *(len(known) for known in self._ids)):
            return None
        ids[born] = np.arange(len(self._known), count)
        return ids, matched.sure

    def _take(self, number: int, frame: Gaussians, ids: NDArray[np.int32]) -> None:
        """Remember what the rows of a frame look like."""
        born = np.flatnonzero(ids >= len(self._known))
        if len(born):
            self._known = Gaussians.join([self._known, frame.take(born)])
            self._seen = np.concatenate([self._seen, np.full(len(born), number)])
            self._velocity = np.concatenate([self._velocity, np.zeros((len(born), 3), np.float32)])
        order = _inverse(ids, len(self._known))
        there = order != NONE
        now = frame.take(np.maximum(order, 0))
        goes_on = there & (self._seen == self._at)
        with np.errstate(over="ignore", invalid="ignore"):
            self._velocity = np.where(goes_on[:, None], now.means - self._known.means, np.float32(0))
        self._known = mix_rows(now, self._known, there)
        self._seen[there] = number
        self._ids.append(ids)
        self._file, self._at = frame, number

    def orders(self) -> dict[int, NDArray[np.int32]]:
        """(N,) rows of the file of each frame that does not have just these rows in just this order."""
        count = len(self._known)
        as_in_file = np.arange(count)
        found = {self.start + i: _inverse(ids, count) for i, ids in enumerate(self._ids)}
        return {frame: order for frame, order in found.items() if not np.array_equal(order, as_in_file)}


def _inverse(ids: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """(count,) the row that each Gaussian is, from (n,) the Gaussian that each row is; NONE for those without one."""
    order = np.full(count, NONE, np.int32)
    order[ids] = np.arange(len(ids))
    return order


def _alone(sequence: GaussianSequence) -> tuple[int, ...]:
    """Frames between two changes of the number of rows, where there is more than one such; no named keyframes."""
    breaks = {*sequence.breaks}
    ones = [start for start, stop in count_runs(sequence) if stop - start == 1 and not {start, stop} & breaks]
    return tuple(ones) if len(ones) > 1 and sequence.keyframes is None else ()


def spans_of(frames: Sequence[int]) -> str:
    """Frame numbers, ascending, in words: frame 7, or frames 1-4, 7, 9-11."""
    spans: list[str] = []
    for _, members in itertools.groupby(enumerate(frames), key=lambda pair: pair[1] - pair[0]):
        numbers = [number for _, number in members]
        spans.append(str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]}-{numbers[-1]}")
    return f"frame{'s' * (len(frames) > 1)} {', '.join(spans)}"
