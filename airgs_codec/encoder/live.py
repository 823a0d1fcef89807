"""A package that grows: groups are encoded and published while somebody still writes the frames of the sequence."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.grouping import closed_groups
from airgs_codec.analysis.importance import WrittenRows
from airgs_codec.analysis.matching import IN_ORDER, compare_order
from airgs_codec.analysis.rows import Restored, restore_rows
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.batch import calibrate_sequence, measure_encoded
from airgs_codec.encoder.measure import pictures_of, with_errors
from airgs_codec.encoder.pipeline import (
    DIFFERENCE,
    KEY,
    QUALITY,
    ROWS,
    STATES,
    SURVEY,
    CodedKey,
    GroupFiles,
    PreparedSequence,
    with_rows_of_others,
)
from airgs_codec.encoder.prepare import hold_frames, look_at_frames
from airgs_codec.encoder.publish import held_to_readers, write_package
from airgs_codec.encoder.repair import encode_repaired
from airgs_codec.encoder.settings import KEPT, EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, Survey, ViewPlan, join_surveys, plan_views
from airgs_codec.jobs.work import temporary_work
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock
from airgs_codec.package.package import Package, root_of, write_file
from airgs_codec.package.publish import GrowingPackage, staged_package
from airgs_codec.package.tables import Group
from airgs_codec.places.place import Folder, Memory, Place, place_at
from airgs_codec.places.whole import written_alone
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.sequence import GaussianSequence, GrowingFolder

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
    """Choices that the first group has settled for all that follow."""

    package: GrowingPackage
    settings: EncodeSettings  # nothing is left to calibrate
    views: ViewPlan
    sh_degree: int  # bands above it are not worth their bytes
    pictures: int  # that measure a segment; 0: none
    bases: list[tuple[CodedKey, GroupFiles]]  # one: the next group may differ from it
    seen: list[tuple[Survey, WrittenRows]]  # of groups whose rows a next key by itself might have, the newest first

    def publish(self, sequence: GaussianSequence, start: int, stop: int) -> None:
        """Encode, measure and publish one more group, by the steps of `pipeline` one after the other."""
        m, (base, base_files) = self.package.manifest, self.bases[-1]
        known: dict[str, Any] = {
            "sequence": replace(sequence, max_sh_degree=self.sh_degree),
            "span": GroupSpan(len(m.groups), start, stop),
            "views": self.views,
            "settings": self.settings,
            "row_error": self.settings.row_error,
            "base": base,
            "first_segment": len(m.segments),
        }
        SURVEY.do(known)
        ROWS.do(known)
        difference = None
        if self.settings.keys == KEPT:
            difference = DIFFERENCE.do(known)
            rows = self._remember(known)
            if difference is None and rows is not None:
                known["written"] = replace(known["written"], rows=rows)
                known["survey"] = join_surveys([survey for survey, _ in self.seen])
        known["coded"] = difference or KEY.do(known)
        group = STATES.do(known)
        if difference is None:
            self.bases[:] = [(known["coded"], group)]
        table = self._measured(sequence, known, base_files if difference else None)
        with held_to_readers():
            whole = Memory("group", {**base_files.files, **group.files})
            decode(Package(whole, self.package.expect(table), 0), stop - 1)
            for path, data in group.files.items():
                write_file(self.package.files, path, data)
            self.package.add(table)

    def _remember(self, known: dict[str, Any]) -> NDArray[np.intp] | None:
        """The rows of a key of this group by itself: its own, and those that groups before it needed (`seen`).

        None, and nothing is remembered, where its frames were put in order: rows of the next group are others. Groups
        before it are forgotten where they have other rows than it, or too many.
        """
        survey, written, sequence = known["survey"], known["written"], known["sequence"]
        start, frames = survey.span.start, range(survey.span.start, survey.span.stop)
        if any(frame in sequence.orders for frame in frames):
            self.seen.clear()
            return None
        if self.seen and not _in_order(sequence, start):
            self.seen.clear()
        self.seen.insert(0, (survey, written))
        rows, together = with_rows_of_others(some.rows for _, some in self.seen)
        del self.seen[together:]
        return rows

    def _measured(self, sequence: GaussianSequence, known: dict[str, Any], base: GroupFiles | None) -> Group:
        """The table of a group whose files are known, with its quality where that is measured."""
        table: Group = known["files"].table
        if not self.pictures:
            return table
        m = self.package.expect(table)
        tables, number = (root_of(m), list(m.groups)), len(m.groups) - 1
        known |= {"sequence": sequence, "renderer": self.views.renderer, "tables": tables, "base_files": base}
        known["pictures"] = pictures_of(self.views, m, number, self.pictures)
        return with_errors(m, number, QUALITY.do(known))


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
    place = place_at(path)
    publisher: _Publisher | None = None
    owner = ExitStack()  # holds the package, in which nobody else may write until it is closed
    try:
        for whole, first, last in _whole_groups(folder, settings.group_frames, more):
            with closing(hold_frames(whole)) as held:
                rows = restore_rows(held, settings.rows, progress, range(first, last))
                notes = rows.notes
                for start, stop in _parts(rows, first, last):
                    if publisher is None:
                        publisher = _begin(rows.sequence, stop, place, settings, attribution, progress, owner)
                    else:
                        publisher.publish(rows.sequence, start, stop)
                    yield _published(publisher.package.manifest, whole, notes)
                    notes = []
    finally:
        with owner:
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


def _in_order(sequence: GaussianSequence, frame: int) -> bool:
    """Whether the rows of a frame are those of the one before it, as their files have them."""
    before, here = (sequence.read(number) for number in (frame - 1, frame))
    return len(before) == len(here) and compare_order(before, here)[0] == IN_ORDER


def _parts(rows: Restored, first: int, last: int) -> list[tuple[int, int]]:
    """Groups [start, stop) of frames [first, last), which were to be one, where some rows could not be matched."""
    starts = [first, *(frame for frame in rows.sequence.breaks if first < frame < last)]
    return list(zip(starts, [*starts[1:], last], strict=True))


def _begin(
    sequence: GaussianSequence,
    stop: int,
    place: Place,
    settings: EncodeSettings,
    attribution: str | None,
    progress: Progress,
    owner: ExitStack,
) -> _Publisher:
    """Settle everything on the first group, frames [0, stop), and publish it."""
    part = replace(sequence, paths=sequence.paths[:stop], headers=sequence.headers[:stop])
    views = plan_views(part, settings)
    credit = sequence.attribution if attribution is None else attribution
    available = datetime.fromtimestamp(sequence.paths[0].stat().st_mtime, UTC)
    with temporary_work(progress) as work, staged_package(place) as stage:
        owner.enter_context(written_alone(stage))
        names = look_at_frames(part, work)[0]
        original = PreparedSequence(part, names, [(0, stop)], views, (), credit)
        found = calibrate_sequence(original, settings, work)
        encoded, chosen, repairs = encode_repaired(found, found.settings, work)
        manifest = encoded.manifest
        if settings.measure_pictures:
            manifest = measure_encoded(encoded, original, settings.measure_pictures).manifest
        manifest = replace(manifest, live=True, decisions=[*manifest.decisions, *found.decisions, *repairs])
        write_package(Folder(stage, alone=True), encoded, manifest, LiveClock(available, datetime.now(UTC)))
        base = encoded.base_key(), encoded.group(0)
        needed = (found.prepared.job(SURVEY, 0), found.prepared.job(ROWS, 0, chosen))
        shared = chosen.keys == KEPT and not any(frame in sequence.orders for frame in range(stop))
        first = [tuple(work.result(job) for job in needed)] if shared else []
    package = GrowingPackage(replace(place, alone=True) if isinstance(place, Folder) else place, manifest, available)
    sh_degree = found.prepared.sequence.sh_degree
    return _Publisher(package, chosen, views, sh_degree, manifest.views.measured, [base], first)


def _published(m: Manifest, sequence: GaussianSequence, notes: list[str]) -> PublishedGroup:
    group, now = m.groups[-1], time.time()
    first, last = (sequence.paths[frame].stat().st_mtime for frame in (group.start, group.stop - 1))
    return PublishedGroup(len(m.groups), group, (now - first, now - last), notes)
