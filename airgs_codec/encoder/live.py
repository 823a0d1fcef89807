"""A package that grows: groups are encoded and published while somebody still writes the frames of the sequence."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from airgs_codec.analysis.grouping import DEFAULT_GROUP_FRAMES, closed_groups
from airgs_codec.analysis.rows import Restored, restore_rows
from airgs_codec.encoder.encoder import EncodeJob
from airgs_codec.encoder.group import CodedKey, code_group, code_key, keep_key
from airgs_codec.encoder.group_jobs import GroupJobs
from airgs_codec.encoder.look import look_at_frames
from airgs_codec.encoder.measure import Rounds, measure_package
from airgs_codec.encoder.publish import calibrate_job, finish
from airgs_codec.encoder.settings import DEFAULT_LEVELS, KEPT, EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, ViewPlan, plan_views, survey_group
from airgs_codec.encoder.verify import Attempt, encode_verified
from airgs_codec.jobs.work import temporary_work
from airgs_codec.package.folder import Folder
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock
from airgs_codec.package.storage import Storage, open_storage
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Group
from airgs_codec.package.writing import GrowingPackage
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.growing import GrowingFolder
from airgs_codec.scene.sequence import GaussianSequence

POLL_S = 0.2  # between two looks at the folder


@dataclass(frozen=True, slots=True)
class PublishedGroup:
    """A group that readers can fetch from now on."""

    number: int  # from 1
    group: Group
    waited_s: tuple[float, float]  # from the files of its first and of its last frame until it was published
    notes: list[str]  # what was done about rows that were out of order, up to it


@dataclass(frozen=True, slots=True, eq=False)
class _Publisher:
    """What the first group has settled for all that follow."""

    package: GrowingPackage
    settings: EncodeSettings  # nothing is left to calibrate
    views: ViewPlan
    sh_degree: int  # bands above it are not worth their bytes
    rounds: Rounds  # of pictures that measure a segment
    bases: list[CodedKey]  # the newest last: the next group may keep rows of it

    def publish(self, sequence: GaussianSequence, start: int, stop: int) -> None:
        """Encode, measure and publish one more group."""
        m, settings = self.package.manifest, self.settings
        coded_as = replace(sequence, max_sh_degree=self.sh_degree)
        survey = survey_group(coded_as, GroupSpan(len(m.groups), start, stop), self.views)
        key, base = code_key(coded_as, survey, settings), self.bases[-1]
        kept = keep_key(key, base, settings, sequence.fps) if settings.keys == KEPT else None
        if kept is None:
            self.bases[:] = [key]
        group = code_group(coded_as, kept or key, base if kept else None, settings, len(m.segments))
        for path, data in group.files.items():
            self.package.files.write(path, data)
        table = group.table
        if self.rounds.count:
            package, number = Package(self.package.files, self.package.expect(table), 0), len(m.groups)
            [table] = measure_package(package, sequence, self.views, [number], self.rounds).groups
        self.package.add(table)


def follow(
    folder: GrowingFolder,
    path: str | Path,
    settings: EncodeSettings,
    *,
    more: Callable[[int], bool],
    attribution: str | None = None,
    progress: Progress = silent,
) -> Iterator[PublishedGroup]:
    """Encode the sequence in `folder` group by group while it grows, and publish each at `path` when it is whole.

    `more` says whether further frames may come, given how many are there. What is calibrated and repaired on the first
    group holds for all. The package is closed when the last group is published, or when an error ends the work: then
    it has the groups that were whole. A package that is at `path` already is replaced with the first group.

    Raises SceneError, CodecError and ConfigError as `publish.encode` does.
    """
    storage = open_storage(path)
    publisher: _Publisher | None = None
    group_frames = settings.group_frames or DEFAULT_GROUP_FRAMES
    try:
        for whole, first, last in _whole_groups(folder, group_frames, more):
            rows = restore_rows(whole, settings.rows, progress, range(first, last))
            notes = rows.notes
            for start, stop in _parts(rows, first, last):
                if publisher is None:
                    publisher = _begin(rows.sequence, stop, storage, settings, attribution, progress)
                else:
                    publisher.publish(rows.sequence, start, stop)
                yield _published(publisher.package.manifest, whole, notes)
                notes = []
    finally:
        if publisher is not None:
            publisher.package.close()


def _whole_groups(
    folder: GrowingFolder, group_frames: int, more: Callable[[int], bool]
) -> Iterator[tuple[GaussianSequence, int, int]]:
    """Each group [start, stop) once no frame will join it, with the sequence as far as it is there."""
    at, count, done = 0, 0, False
    while not done:
        done = not more(count)
        sequence = folder.look()
        if sequence is not None:
            count = len(sequence)
            for start, stop in closed_groups(sequence, at, group_frames, done):
                yield sequence, start, stop
                at = stop
        if not done:
            time.sleep(POLL_S)
    folder.check_finished()


def _parts(rows: Restored, first: int, last: int) -> list[tuple[int, int]]:
    """Groups [start, stop) of frames [first, last), which were to be one, where some rows could not be matched."""
    starts = [first, *rows.unmatched]
    return list(zip(starts, [*starts[1:], last], strict=True))


def _begin(
    sequence: GaussianSequence,
    stop: int,
    storage: Storage,
    settings: EncodeSettings,
    attribution: str | None,
    progress: Progress,
) -> _Publisher:
    """Settle everything on the first group, frames [0, stop), and publish it."""
    part = replace(sequence, paths=sequence.paths[:stop], headers=sequence.headers[:stop])
    views = plan_views(part, settings)
    credit = sequence.attribution if attribution is None else attribution
    rounds = Rounds(settings.measure_pictures)
    given = settings.levels != DEFAULT_LEVELS
    available = datetime.fromtimestamp(sequence.paths[0].stat().st_mtime, UTC)
    with temporary_work(progress) as work, storage.staged() as stage:
        groups = GroupJobs.of(part, [(0, stop)], look_at_frames(part, work).names, views)
        found = calibrate_job(EncodeJob(groups, work, (), credit), settings)
        verified = encode_verified(Attempt(found.job, groups, found.settings, found.expected, rounds, given))
        decisions = [*verified.manifest.decisions, *found.decisions, *verified.stories]
        manifest = replace(verified.manifest, live=True, decisions=decisions)
        finish(verified, manifest).write(work.store, Folder(stage), LiveClock(available, datetime.now(UTC)))
        base = verified.encoded.base_key()
    turns = manifest.views.measured // max(1, views.measured(rounds.count))
    package = GrowingPackage(storage, manifest, available)
    sh_degree = found.job.groups.sequence.sh_degree
    return _Publisher(package, verified.settings, views, sh_degree, rounds.again(turns), [base])


def _published(m: Manifest, sequence: GaussianSequence, notes: list[str]) -> PublishedGroup:
    """The newest group."""
    group, now = m.groups[-1], time.time()
    first, last = (sequence.paths[frame].stat().st_mtime for frame in (group.start, group.stop - 1))
    return PublishedGroup(len(m.groups), group, (now - first, now - last), notes)
