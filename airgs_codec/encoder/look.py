"""A first look at all frames: names of their content, and whether rows kept their order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from airgs_codec.analysis.grouping import count_runs
from airgs_codec.analysis.rows import IN_ORDER, compare_order
from airgs_codec.jobs.digest import digest
from airgs_codec.jobs.work import Work
from airgs_codec.scene.sequence import GaussianSequence

CHUNK = 16  # frames that are read by one call


@dataclass(frozen=True, slots=True)
class Looked:
    """What is known of some frames."""

    names: tuple[str, ...]  # SHA-256 of each frame as it is read
    in_order: bool  # rows of each are those of the frame before it

    @staticmethod
    def join(parts: Iterable[Looked]) -> Looked:
        """The frames of all parts, one after another."""
        known = list(parts)
        return Looked(tuple(name for part in known for name in part.names), all(part.in_order for part in known))


def look_at_frames(sequence: GaussianSequence, work: Work) -> Looked:
    """Look at all frames of a sequence. Raises SceneError for a broken one."""
    starts = [start for start, _ in count_runs(sequence)]
    bounds = [(at, min(at + CHUNK, len(sequence))) for at in range(0, len(sequence), CHUNK)]
    return Looked.join(work.map("frames", look, [(sequence, *bound, starts) for bound in bounds]))


def look(sequence: GaussianSequence, start: int, stop: int, starts: Sequence[int]) -> Looked:
    """Look at frames [start, stop); those that `starts` names begin runs, whose rows are not those before."""
    before = sequence.read(start - 1) if start and start not in starts else None
    names, in_order = [], True
    for number in range(start, stop):
        frame = sequence.read(number)
        names.append(digest(frame))
        if before is not None and number not in starts and in_order:
            in_order = compare_order(before, frame)[0] == IN_ORDER
        before = frame
    return Looked(tuple(names), in_order)
