"""A package that grows: groups are encoded and published while somebody still writes the frames of the sequence."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from airgs_codec.analysis.grouping import closed_groups
from airgs_codec.analysis.matching import IN_ORDER, compare_order
from airgs_codec.analysis.rows import restore_rows
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.decide import Surveys, choose
from airgs_codec.encoder.group import Base, encode_group
from airgs_codec.encoder.measure import FIRST, Seen, measure, with_quality
from airgs_codec.encoder.order import Ordered, hold_frames
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.publish import finish, held_to_readers, write_checked
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import Frames, Span, Survey
from airgs_codec.encoder.tables import GroupFiles
from airgs_codec.errors import ConfigError
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock
from airgs_codec.package.package import Package, write_file
from airgs_codec.package.publish import GrowingPackage, staged_package
from airgs_codec.package.tables import Group
from airgs_codec.places.place import Folder, Memory, Storage, place_at
from airgs_codec.places.whole import written_alone
from airgs_codec.progress import Progress, silent
from airgs_codec.render.backend import open_renderer
from airgs_codec.scene.sequence import GaussianSequence, GrowingFolder

LOOK_S = 0.2  # between two looks at the folder
RATED_GROUPS = 64  # groups whose pictures rate the whole package, evenly spread: a package may grow for days


@dataclass(frozen=True, slots=True)
class PublishedGroup:
    """A group that readers can fetch from now on."""

    number: int  # from 1
    group: Group
    waited_s: tuple[float, float]  # from the files of its first and of its last frame until it was published
    notes: list[str]  # what was done about Gaussians that were out of order, up to it


class _Publisher:
    """Folds `encode_group` over the groups of a sequence as they come, and publishes each."""

    def __init__(self, place: Storage, attribution: str | None, owner: ExitStack) -> None:
        """`owner`: holds the package, in which nobody else may write until it is closed."""
        self._place, self._attribution, self._owner = place, attribution, owner
        self._base: Base | None = None
        self._base_files: GroupFiles | None = None  # of the group that `_base` is
        self._seen: list[Seen] = []  # of every `_every`-th group
        self._every = 1
        self.package: GrowingPackage | None = None

    def publish(self, frames: Frames, plan: Plan, survey: Survey | None) -> Manifest:
        """Encode, measure and publish a group; gives the tables of the package."""
        sequence = frames.sequence
        files, base = encode_group(frames, plan, self._base, survey)
        self._base_files = files if base is not self._base else self._base_files
        self._base = base
        if self.package is None:
            self.package = self._begin(sequence, plan, files)
            return self.package.manifest
        with held_to_readers():
            data = {**(self._base_files.files if self._base_files else {}), **files.files}
            m = self._measured(Memory("group", data), self.package.expect(files.table), sequence, plan)
            package = Package(Memory("group", data), self.package.expect(m.groups[-1], m.rungs), 0)
            decode(package, frames.stop - 1)
            for path, content in files.files.items():
                write_file(self.package.files, path, content)
            self.package.add(m.groups[-1], m.rungs)
        return self.package.manifest

    def _begin(self, sequence: GaussianSequence, plan: Plan, files: GroupFiles) -> GrowingPackage:
        available = datetime.fromtimestamp(sequence.paths[0].stat().st_mtime, UTC)
        credit = sequence.attribution if self._attribution is None else self._attribution
        with staged_package(self._place) as stage:
            self._owner.enter_context(written_alone(stage))
            place = Folder(stage)
            for path, data in files.files.items():
                write_file(place, path, data)
            manifest = finish(place, replace(sequence, credit=credit), plan, [files.table])
            manifest = replace(self._measured(place, manifest, sequence, plan), live=True)
            write_checked(place, manifest, LiveClock(available, datetime.now(UTC)))
        return GrowingPackage(self._place, manifest, available)

    def _measured(self, place: Storage, m: Manifest, sequence: GaussianSequence, plan: Plan) -> Manifest:
        """Return the tables with the quality of the newest group, and that of all so far."""
        most, renderer = plan.settings.measure_pictures, open_renderer(plan.settings.device)
        if not most:
            return m
        newest = len(m.groups) - 1
        found = measure(Package(place, m, 0), sequence, plan.views, renderer, min(most, FIRST), m.segments_of(newest))
        rated = with_quality(m, [*self._seen, found], newest=self.package is not None)
        if newest % self._every == 0:
            self._seen.append(found)
        if len(self._seen) == RATED_GROUPS:
            self._seen, self._every = self._seen[::2], 2 * self._every
        return rated


def follow(
    folder: GrowingFolder,
    path: str | Path,
    settings: EncodeSettings,
    *,
    plan: Plan | None = None,
    more: Callable[[int], bool],
    attribution: str | None = None,
    progress: Progress = silent,
) -> Iterator[PublishedGroup]:
    """Encode the sequence in `folder` group by group while it grows, and publish each at `path` when it is whole.

    `more` says whether further frames may come, given how many are there. The plan is decided on the first group, or
    given: groups that it has are waited for, with those that their keyframes are chosen for. The package is closed when
    the last group is published, or when an error ends the work: then it has the groups that were whole. A package that
    is at `path` already is replaced with the first group.

    Raises SceneError, CodecError and ConfigError as `publish.encode` does.
    """
    surveys: Surveys = {}
    planned = [] if plan is None else [plan.spans(number) for number in range(len(plan.groups))]
    number = begun = first_segment = 0
    with ExitStack() as owner:
        publisher = _Publisher(place_at(path), attribution, owner)
        try:
            for whole, first, last in _whole_groups(folder, planned, settings.group_frames, more):
                with closing(hold_frames(whole)) as held:
                    rows = restore_rows(held, settings.rows, progress, range(first, last))
                    sequence, notes = rows.sequence, rows.notes
                    breaks = [frame for frame in sequence.breaks if first < frame < last]  # rows were not matched
                    for start, stop in pairwise([first, *breaks, last]):
                        if plan is None:
                            part = replace(sequence, paths=sequence.paths[:stop], headers=sequence.headers[:stop])
                            ordered = Ordered(replace(rows, sequence=part), 0.0)
                            plan, surveys = choose(ordered, settings, None, progress, run=0)
                        if number < len(plan.groups):
                            frames = plan.part(sequence, number, first_segment)
                        else:
                            begins = _lost(sequence, start, stop) or plan.begins_run(sequence, start, number - begun)
                            read = replace(sequence, max_sh_degree=plan.sh_degree)
                            frames = Frames(read, number, ((start, stop),), first_segment, begins)
                        m = publisher.publish(frames, plan, surveys.pop(number, None))
                        yield _published(m, whole, notes)
                        begun = number if frames.begins else begun
                        notes, number, first_segment = [], number + 1, len(m.segments)
        finally:
            if publisher.package is not None:
                publisher.package.close()


def _whole_groups(
    folder: GrowingFolder, planned: list[tuple[Span, ...]], group_frames: int, more: Callable[[int], bool]
) -> Iterator[tuple[GaussianSequence, int, int]]:
    """Yield each group [start, stop) once all frames that it needs are there, with the sequence as far as it is there.

    `planned`: the spans of groups that are given, as `Plan.spans` has them; then come those that no frame will join.
    """
    at, count, done, left = 0, 0, False, deque(planned)
    while not done:
        done = not more(count)
        sequence = folder.look()
        if sequence is not None:
            count = len(sequence)
            while left and left[0][-1][1] <= count:
                start, at = left.popleft()[0]
                yield sequence, start, at
            for start, stop in [] if left else closed_groups(sequence, at, group_frames, done):
                yield sequence, start, stop
                at = stop
        if not done:
            time.sleep(LOOK_S)
    if left:
        raise ConfigError(f"plan: expected a sequence of at least {left[-1][0][1]} frames, got {count}")
    folder.check_finished()


def _lost(sequence: GaussianSequence, start: int, stop: int) -> bool:
    """Return whether the Gaussians of a group, as its files have them, are others than those of the frame before it."""
    if any(frame in sequence.orders for frame in range(start, stop)):
        return True
    before, here = (sequence.read(number) for number in (start - 1, start))
    return len(before) != len(here) or compare_order(before, here) != IN_ORDER


def _published(m: Manifest, sequence: GaussianSequence, notes: list[str]) -> PublishedGroup:
    group, now = m.groups[-1], time.time()
    first, last = (sequence.paths[frame].stat().st_mtime for frame in (group.start, group.stop - 1))
    return PublishedGroup(len(m.groups), group, (now - first, now - last), notes)
