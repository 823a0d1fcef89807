"""Looks at all frames of a sequence before it is encoded: which of them lost the order of their Gaussians."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from airgs_codec.analysis.grouping import count_runs
from airgs_codec.analysis.rows import IN_ORDER, Restored, compare_order, restore_rows, spans_of
from airgs_codec.progress import Progress, Stopwatch, silent
from airgs_codec.scene.frames import HeldFrames
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

STRANGE = 3.0  # times the extent of the frame before, in size or distance
SOME = 4096  # Gaussians of a frame whose median shows where it lies
HELD_SHARE = 8  # of the machine's memory: an eighth may hold frames, since coding a group takes several times its size


@dataclass(frozen=True, slots=True)
class Ordered:
    """A sequence whose Gaussians are in order inside every group."""

    restored: Restored
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def sequence(self) -> GaussianSequence:
        return self.restored.sequence


def hold_frames(sequence: GaussianSequence) -> GaussianSequence:
    """Return the sequence with memory for frames that were read, until it is closed."""
    if sequence.held is not None:
        return sequence
    known = hasattr(os, "sysconf")
    held = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // HELD_SHARE if known else 1 << 30
    return replace(sequence, held=HeldFrames(held))


def order_rows(sequence: GaussianSequence, rows: str, progress: Progress = silent) -> Ordered:
    """Look at all frames and put their Gaussians into order; `rows` is as in `restore_rows`.

    Raises SceneError for a broken frame.
    """
    watch = Stopwatch()
    in_order, reaches = look_at_frames(sequence, progress)
    restored = restore_rows(sequence, rows, progress, in_order=in_order)
    return Ordered(restored, watch.lap(), (*restored.notes, *_strange(reaches)))


Reach = tuple[tuple[float, ...], float]


def look_at_frames(sequence: GaussianSequence, progress: Progress = silent) -> tuple[bool, list[Reach]]:
    """Say whether the Gaussians of each frame are those of the frame before it, and where those of each lie."""
    starts, before, in_order, reaches = {start for start, _ in count_runs(sequence)}, None, True, []
    for number in range(len(sequence)):
        frame = sequence.read(number)
        if before is not None and number not in starts:
            in_order &= compare_order(before, frame) == IN_ORDER
        reaches.append(_reach(frame))
        before = frame
        progress("frames", number + 1, len(sequence))
    return in_order, reaches


def _reach(frame: Gaussians) -> Reach:
    """Return the median place of some Gaussians that are finite, and their median distance from it."""
    means = frame.means[:: max(1, len(frame) // SOME)].astype(np.float64)
    means = means[np.isfinite(means).all(axis=1)]
    if not len(means):
        return (0.0, 0.0, 0.0), 0.0
    middle = np.median(means, axis=0)
    return tuple(middle.tolist()), float(np.median(np.linalg.norm(means - middle, axis=1)))


def _strange(reaches: Sequence[Reach]) -> tuple[str, ...]:
    """Return a sentence on frames whose Gaussians lie elsewhere than those of the frame before."""
    frames = []
    for number, ((at, reach), (other, far)) in enumerate(pairwise(reaches), 1):
        low, high = sorted([reach, far])
        if high > STRANGE * low or np.linalg.norm(np.subtract(at, other)) > STRANGE * high:
            frames.append(number)
    if not frames:
        return ()
    where = f"{spans_of(frames)}: Gaussians lie elsewhere than in the frame before, or {STRANGE:g} times as far apart"
    return (f"{where}: are they of another scene?",)
