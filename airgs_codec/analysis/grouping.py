"""Which frames share a canonical space. Row n of a frame is a Gaussian; N rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airgs_codec.scene.sequence import GaussianSequence

DEFAULT_GROUP_FRAMES = 30
UNTRACKED_RATIO = 0.5  # move of a row / distance to an unrelated row; tracked scenes stay below 0.05
FEWEST_ROWS = 8  # below it a median says nothing


@dataclass(frozen=True, slots=True)
class Grouping:
    """The groups of a sequence, and why they are what they are."""

    spans: list[tuple[int, int]]  # frames [start, stop), one after the other, covering the sequence
    notes: list[str]


def middle_frame(start: int, stop: int) -> int:
    """The frame in the middle of a group [start, stop)."""
    return start + (stop - start) // 2


def count_runs(sequence: GaussianSequence) -> list[tuple[int, int]]:
    """Frames [start, stop) of each run between keyframes that the sequence names and changes of the number of rows."""
    counts = [header.count for header in sequence.headers]
    changes = [i for i in range(1, len(counts)) if counts[i] != counts[i - 1]]
    starts = sorted({0, *changes, *(sequence.keyframes or ())})
    return list(zip(starts, [*starts[1:], len(counts)], strict=True))


def plan_groups(sequence: GaussianSequence, group_frames: int = DEFAULT_GROUP_FRAMES) -> Grouping:
    """Split a sequence into groups: at the keyframes that it names, else every `group_frames` frames.

    A group also starts where the number of Gaussians changes. A group whose rows clearly do not correspond from frame
    to frame is coded all-intra (one frame a group). Notes say where either overrode the keyframes or the length.
    """
    counts = [header.count for header in sequence.headers]
    changes = [i for i in range(1, len(counts)) if counts[i] != counts[i - 1]]
    notes = []
    if sequence.keyframes is None:
        starts = sorted({0, *changes})
    else:
        starts = sorted({*sequence.keyframes, *changes})
        notes = [
            f"frame {i}: the count changes inside a group, a new group starts"
            for i in sorted({*changes} - {*sequence.keyframes})
        ]
    spans = []
    for start, stop in zip(starts, [*starts[1:], len(counts)], strict=True):
        if sequence.keyframes is None:
            spans += [(i, min(i + group_frames, stop)) for i in range(start, stop, group_frames)]
        else:
            spans.append((start, stop))
    return Grouping(*split_untracked(sequence, spans, notes))


def split_untracked(
    sequence: GaussianSequence, spans: list[tuple[int, int]], notes: list[str]
) -> tuple[list[tuple[int, int]], list[str]]:
    """Groups of one frame in place of those whose rows do not correspond, and the notes with theirs."""
    kept: list[tuple[int, int]] = []
    for start, stop in spans:
        if stop - start > 1 and _displacement_ratio(sequence, start) > UNTRACKED_RATIO:
            notes = [*notes, f"frames {start}-{stop - 1}: rows do not correspond (untracked input), coded all-intra"]
            kept += [(i, i + 1) for i in range(start, stop)]
        else:
            kept.append((start, stop))
    return kept, notes


def _displacement_ratio(sequence: GaussianSequence, start: int) -> float:
    """Median move of a row from frame `start` to the next, over the median distance between unrelated rows."""
    a, b = (sequence.read(i).means.astype(np.float64) for i in (start, start + 1))
    finite = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    a, b = a[finite], b[finite]
    if len(a) < FEWEST_ROWS:
        return 0.0
    b = b - np.median(b - a, axis=0)  # a scene that moves as a whole is tracked
    unrelated = np.random.default_rng(0).permutation(len(a))
    distance = float(np.median(np.linalg.norm(b - a[unrelated], axis=1)))
    return float(np.median(np.linalg.norm(b - a, axis=1))) / distance if distance > 0 else 0.0


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
    return split_untracked(sequence, spans, [])[0]
