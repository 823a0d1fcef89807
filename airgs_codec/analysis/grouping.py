"""Which frames of a sequence share a group: runs of frames with the same rows, cut into groups."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from airgs_codec.scene.sequence import GaussianSequence

DEFAULT_GROUP_FRAMES = 30


@dataclass(frozen=True, slots=True)
class Grouping:
    """The groups of a sequence, and why they are what they are."""

    spans: list[tuple[int, int]]  # frames [start, stop), one after the other, covering the sequence
    notes: list[str]


def named_runs(sequence: GaussianSequence) -> list[tuple[int, int]]:
    """Return frames [start, stop) of each run between named keyframes and `breaks`."""
    return _between({*sequence.breaks, *(sequence.keyframes or ())}, len(sequence))


def count_runs(sequence: GaussianSequence) -> list[tuple[int, int]]:
    """Return frames [start, stop) of each run between named keyframes, changes of the number of rows, and `breaks`."""
    return _between({*count_changes(sequence), *sequence.breaks, *(sequence.keyframes or ())}, len(sequence))


def _between(starts: set[int], frames: int) -> list[tuple[int, int]]:
    return list(itertools.pairwise([*sorted({0, *starts}), frames]))


def count_changes(sequence: GaussianSequence) -> list[int]:
    """Return the frames that are read with another number of rows than the one before."""
    counts = [sequence.count(frame) for frame in range(len(sequence))]
    return [i for i in range(1, len(counts)) if counts[i] != counts[i - 1]]


def plan_groups(sequence: GaussianSequence, group_frames: int = DEFAULT_GROUP_FRAMES) -> Grouping:
    """Split a sequence into groups: at the keyframes that it names, else evenly, at most `group_frames` frames each.

    A group also starts where the number of Gaussians changes, or rows are not those of the frame before
    (`analysis.rows`). Notes say where the number overrode the keyframes.
    """
    if sequence.keyframes is None:
        return Grouping([span for run in count_runs(sequence) for span in _evenly(*run, group_frames)], [])
    added = sorted({*count_changes(sequence)} - {*sequence.keyframes})
    notes = [f"frame {i}: the count changes inside a group, a new group starts" for i in added]
    return Grouping(count_runs(sequence), notes)


def _evenly(start: int, stop: int, most: int) -> Iterator[tuple[int, int]]:
    parts = -(-(stop - start) // most)
    return itertools.pairwise(start + i * (stop - start) // parts for i in range(parts + 1))


def closed_groups(sequence: GaussianSequence, start: int, group_frames: int, done: bool) -> list[tuple[int, int]]:
    """Return groups [start, stop) from frame `start` on that no frame will join any more, whether or not rows match.

    The sequence is the present part of a growing one, which is complete if `done`.
    """
    spans = []
    for first, stop in named_runs(sequence):
        most = group_frames if sequence.keyframes is None else stop - first
        for i in range(max(start, first), stop, most):
            end = min(i + most, stop)
            if done or stop < len(sequence) or (sequence.keyframes is None and end - i == most):
                spans.append((i, end))
    return spans
