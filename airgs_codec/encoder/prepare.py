"""From a sequence as it is given to one that is ready to be encoded: frames named, rows in order, groups split."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from airgs_codec.analysis.grouping import count_runs, plan_groups
from airgs_codec.analysis.rows import IN_ORDER, Restored, compare_order, restore_rows, spans_of
from airgs_codec.encoder.pipeline import PreparedSequence
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import ViewPlan, plan_views
from airgs_codec.jobs.engines import InProcess
from airgs_codec.jobs.job import digest
from airgs_codec.jobs.work import Work
from airgs_codec.scene.frames import HeldFrames
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

CHUNK = 16  # frames that are looked at by one call
STRANGE = 3.0  # times as far apart as in the frame before, or from where that is
SOME = 4096  # rows of a frame that tell where it lies
Reach = tuple[tuple[float, ...], float]
HELD_SHARE = 8  # one byte in so many of the memory may hold frames: the arrays of a group take several times its own


@dataclass(frozen=True, slots=True)
class Ordered:
    """A sequence whose frames are named and whose rows are in order."""

    names: tuple[str, ...]  # SHA-256 of each frame as it is read
    rows: Restored
    notes: tuple[str, ...] = ()  # on frames that may be of another scene


def hold_frames(sequence: GaussianSequence) -> GaussianSequence:
    """The sequence with memory for frames that are read, until it is closed; processes read on their own.

    Each is read once where it has room for all of them, else three times: to name it, while its group is surveyed and
    while it is encoded.
    """
    return sequence if sequence.held is not None else replace(sequence, held=HeldFrames(held_bytes()))


def held_bytes() -> int:
    """Bytes of frames that may be held: 1 of HELD_SHARE of the machine's, or 1 GiB where it does not say."""
    if not hasattr(os, "sysconf"):
        return 1 << 30
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // HELD_SHARE


def order_rows(sequence: GaussianSequence, settings: EncodeSettings, work: Work) -> Ordered:
    """Look at all frames, name them and put their rows into order. Raises SceneError for a broken one."""
    names, in_order, reaches = look_at_frames(sequence, work)
    restored = restore_rows(sequence, settings.rows, work.progress, in_order=in_order)
    return Ordered(names, restored, _strange(reaches))


def _strange(reaches: Sequence[Reach]) -> tuple[str, ...]:
    """A sentence on frames whose Gaussians lie otherwise than those of the frame before."""
    frames = []
    for number, ((at, reach), (other, far)) in enumerate(pairwise(reaches), 1):
        low, high = sorted([reach, far])
        if high > STRANGE * low or np.linalg.norm(np.subtract(at, other)) > STRANGE * high:
            frames.append(number)
    if not frames:
        return ()
    where = f"{spans_of(frames)}: Gaussians lie elsewhere than in the frame before, or {STRANGE:g} times as far apart"
    return (f"{where}: are they of another scene?",)


def prepare(
    ordered: Ordered, settings: EncodeSettings, work: Work, attribution: str | None, views: ViewPlan | None = None
) -> PreparedSequence:
    """Choose the views of a sequence and split it into groups.

    `attribution`: who made the scene, by default what the sequence says. `views`: those that are chosen already.
    """
    sequence = ordered.rows.sequence
    views = views or plan_views(sequence, settings)
    grouping = plan_groups(sequence, settings.group_frames)
    notes = (*sequence.notes, *ordered.notes, *ordered.rows.notes, *grouping.notes)
    credit = sequence.attribution if attribution is None else attribution
    together = held_bytes() if isinstance(work.engine, InProcess) else None  # processes read on their own
    return PreparedSequence(sequence, ordered.names, grouping.spans, views, notes, credit, together)


def look_at_frames(sequence: GaussianSequence, work: Work) -> tuple[tuple[str, ...], bool, list[Reach]]:
    """Name all frames of a sequence, say whether rows of each are those of the frame before it, and where they lie.

    Raises SceneError for a broken frame.
    """
    starts = [start for start, _ in count_runs(sequence)]
    bounds = [(at, min(at + CHUNK, len(sequence))) for at in range(0, len(sequence), CHUNK)]
    looked = work.map("frames", look, [(sequence, *bound, starts) for bound in bounds])
    names, reaches = ([one for part in looked for one in part[place]] for place in (0, 2))
    return tuple(names), all(in_order for _, in_order, _ in looked), reaches


def look(
    sequence: GaussianSequence, start: int, stop: int, starts: Sequence[int]
) -> tuple[list[str], bool, list[Reach]]:
    """Look at frames [start, stop); those that `starts` names begin runs, whose rows are not those before."""
    before = sequence.read(start - 1) if start and start not in starts else None
    names, in_order, reaches = [], True, []
    for number in range(start, stop):
        frame = sequence.read(number)
        names.append(digest(frame))
        reaches.append(_reach(frame))
        if before is not None and number not in starts and in_order:
            in_order = compare_order(before, frame)[0] == IN_ORDER
        before = frame
    return names, in_order, reaches


def _reach(frame: Gaussians) -> Reach:
    """The median place of some rows that are finite, and their median distance from it."""
    means = frame.means[:: max(1, len(frame) // SOME)].astype(np.float64)
    means = means[np.isfinite(means).all(axis=1)]
    if not len(means):
        return (0.0, 0.0, 0.0), 0.0
    middle = np.median(means, axis=0)
    return tuple(middle.tolist()), float(np.median(np.linalg.norm(means - middle, axis=1)))
