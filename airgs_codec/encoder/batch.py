"""A whole sequence by jobs of one group each, in this process or on a farm: the files and the tables of a package.

Which keys are differences is settled between the keys and the states: a group differs from the last one before it that
is coded by itself, or becomes the one that later groups may differ from.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._settings import available_cores
from airgs_codec.analysis.importance import ExpectedError, WrittenRows
from airgs_codec.encoder.calibrate import Calibration
from airgs_codec.encoder.measure import Measured, pictures_a_segment, pictures_of, with_quality
from airgs_codec.encoder.pipeline import (
    BANDS,
    CALIBRATION,
    DIFFERENCE,
    KEY,
    NOTHING,
    POSTER,
    QUALITY,
    ROWS,
    STATES,
    SURVEY,
    CodedKey,
    GroupFiles,
    PreparedSequence,
    Read,
    made_by,
    with_rows_of_others,
)
from airgs_codec.encoder.plan import split_segments
from airgs_codec.encoder.representation import Clock
from airgs_codec.encoder.settings import KEPT, EncodeSettings
from airgs_codec.encoder.survey import CHECKED, join_surveys
from airgs_codec.encoder.tables import Provenance, build_manifest
from airgs_codec.jobs.job import Job, digest
from airgs_codec.jobs.work import Work
from airgs_codec.media.mp4 import init_segment
from airgs_codec.package.layout import INIT_NAME, POSTER_NAME
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.mpd import largest_picture
from airgs_codec.package.package import Package, root_of
from airgs_codec.package.region import first_views
from airgs_codec.package.tables import Group, Views, file_entry
from airgs_codec.places.place import Memory
from airgs_codec.places.results import user_cache
from airgs_codec.progress import Progress, name_of

# Seconds that a job takes and more for each frame of its group, of scenes of ten thousand Gaussians: only their ratios
# matter, which tell how much of the whole is done. Others take next to nothing.
SECONDS = {
    CALIBRATION.name: (5, 0),
    SURVEY.name: (1, 0.01),
    KEY.name: (2, 0),
    STATES.name: (1, 0.05),
    QUALITY.name: (1, 0.05),
}


class EncodeProgress:
    """Progress of all of an encode: its stage is `encoding`, and after a colon what is being done."""

    def __init__(self, progress: Progress, prepared: PreparedSequence, settings: EncodeSettings) -> None:
        """What comes behind `prepared` is told to `progress`."""
        frames, self._progress = len(prepared.sequence) / len(prepared), progress
        self._units = {name: fixed + each * frames for name, (fixed, each) in SECONDS.items()}
        self._total = sum(len(prepared) * unit for name, unit in self._units.items() if name != CALIBRATION.name)
        if settings.calibrate != "none":
            self._total += self._units[CALIBRATION.name]
        self._done, self._now = 0.0, ("", 0)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of `total` parts of a stage are finished; one that is taken again was not planned for."""
        unit = self._units.get(name_of(stage), 0.0)
        before = self._now[1] if self._now[0] == stage and self._now[1] <= done else 0
        self._now = stage, done
        self._done += unit * (done - before)
        self._total = max(self._total, self._done + unit * (total - done))
        told = f"encoding: {stage}" if total == 1 else f"encoding: {stage}, {done} of {total}"
        self._progress(told, round(self._done), round(self._total))

    def end(self) -> None:
        self._progress("encoding", round(self._total), round(self._total))


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A sequence with the settings that its scene asks for."""

    prepared: PreparedSequence  # without the SH bands that it does not need
    settings: EncodeSettings  # nothing is left to calibrate
    expected: ExpectedError | None  # of the top rung; None: nothing was promised
    decisions: tuple[str, ...]  # about SH bands
    cached: bool
    saved: float = 0.0  # as in `Calibration`


def calibrate_sequence(prepared: PreparedSequence, settings: EncodeSettings, work: Work) -> Calibrated:
    """Find settings for this scene, whose steps of lengths are in its scale, and the SH bands that it needs."""
    settings = replace(settings, steps=settings.steps.at_scale(prepared.views.scale))
    if settings.calibrate == "none":
        return Calibrated(prepared, settings, None, (), False)
    work.progress("calibration", 0, 1)
    subject = _longest(prepared)
    work.run([prepared.job(SURVEY, subject)])
    once = replace(settings, quality=1.0, threads=available_cores())  # what is found holds for all of them
    calibrating = prepared.job(CALIBRATION, subject, once)
    choosing = prepared.job(BANDS, subject, settings, {"calibration": made_by(calibrating)})
    found, cached = work.cached(calibrating, user_cache("calibration"))
    work.progress("calibration", 1, 1)
    calibration: Calibration = found
    bands, note = work.result(choosing)
    expected = calibration.expected.at(settings.quality) if settings.calibrate == "ladder" else None
    settings, notes = calibration.apply(settings), () if note is None else (note,)
    needed = replace(prepared, sequence=replace(prepared.sequence, max_sh_degree=bands)) if notes else prepared
    return Calibrated(needed, settings, expected, notes, cached, calibration.saved)


def _longest(prepared: PreparedSequence) -> int:
    most = max(span.frames for span in prepared.spans)
    longest = [span.index for span in prepared.spans if span.frames == most]
    return longest[len(longest) // 2]


@dataclass(frozen=True, slots=True, eq=False)
class Encoded:
    """A package of which all jobs are done, but which is not written."""

    manifest: Manifest  # without measured quality
    shared: Mapping[str, bytes]  # files that are no group's
    files: Sequence[Job]  # for each group: its `GroupFiles`
    base: Job  # the key that a next group may differ from
    work: Work

    def group(self, number: int) -> GroupFiles:
        """Give what one group is made of."""
        found = self.work.result(self.files[number])
        assert isinstance(found, GroupFiles)
        return found

    def base_key(self) -> CodedKey:
        """Give the group that a next one may differ from."""
        key = self.work.result(self.base)
        assert isinstance(key, CodedKey)
        return key

    def package(self) -> Package:
        """Give all of it in memory, to look at."""
        parts = [self.group(number).files for number in range(len(self.files))]
        files = {path: data for part in parts for path, data in part.items()}
        return Package(Memory("encoded package", {**self.shared, **files}), self.manifest, 0)


def encode_sequence(
    prepared: PreparedSequence, settings: EncodeSettings, work: Work, original: PreparedSequence | None = None
) -> Encoded:
    """Do all that a package needs but its quality, window by window.

    The quality of a window is measured at once, while its frames are held, where there are several windows and the
    `original` is given: the sequence with all SH bands.

    All groups are surveyed before any is coded, since a base has rows that later groups need.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails.
    """
    segments = [len(split_segments(span, settings.segment_s, prepared.sequence.fps)) for span in prepared.spans]
    firsts = list(itertools.accumulate(segments, initial=0))
    keys = _Keys(prepared, settings, work)
    files: list[Job] = []
    tables: list[Group] = []
    poster = _draw_poster(prepared, work)
    for window in prepared.windows:
        work.run([prepared.job(SURVEY, g) for g in window])
        work.run([prepared.job(ROWS, g, settings) for g in window])
    for window in prepared.windows:
        keys.extend(window)
        for g in window:
            given = {"coded": made_by(keys.jobs[g]), "first_segment": Read(firsts[g], firsts[g])}
            files.append(prepared.job(STATES, g, settings, given))
        work.run(files[window.start :])
        tables += [work.result(one).table for one in files[window.start :]]
        manifest, shared = _package_of(prepared, settings, tables, poster)
        encoded = Encoded(manifest, shared, tuple(files), keys.base, work)
        if original and settings.measure_pictures and len(prepared.windows) > 1:
            count = pictures_a_segment(settings.measure_pictures, firsts[-1])
            work.run(_quality_jobs(encoded, original, count, window))
    return encoded


def _package_of(
    prepared: PreparedSequence, settings: EncodeSettings, tables: Sequence[Group], poster: bytes
) -> tuple[Manifest, dict[str, bytes]]:
    """The tables of a package that has these groups, and the files that are no group's."""
    clock = Clock.of(prepared.sequence.fps)
    shared = {INIT_NAME: init_segment(clock.timescale, *largest_picture(tables)), POSTER_NAME: poster}
    entries = {name: file_entry(data) for name, data in shared.items()}
    return build_manifest(_about(prepared, settings, tables), clock, entries, Groups.of(tables)), shared


def _draw_poster(prepared: PreparedSequence, work: Work) -> bytes:
    """The first frame from where viewers begin."""
    camera = first_views(prepared.views.region, prepared.views.world)[0]
    job = prepared.job(POSTER, 0, None, {"frame": Read(0, 0), "camera": Read(camera, camera)})
    return bytes(work.result(job))


class _Keys:
    """The keys of groups, window by window: each by itself, or as what differs from the last one that is."""

    def __init__(self, prepared: PreparedSequence, settings: EncodeSettings, work: Work) -> None:
        self._prepared, self._settings, self._work = prepared, settings, work
        self.jobs: list[Job] = []  # of each group so far

    def extend(self, window: range) -> None:
        """Code the keys of more groups.

        Groups that might differ from the same one are tried at the same time, ever more while they do.
        """
        if self._settings.keys != KEPT:
            self.jobs += [self._prepared.job(KEY, g, self._settings) for g in window]
            self._work.run(self.jobs[window.start :])
            self.base = self.jobs[-1]
            return
        together = 1
        while len(self.jobs) < window.stop:
            tried = range(len(self.jobs), min(window.stop, len(self.jobs) + together))
            jobs = [self._difference(g) for g in tried] if self.jobs else []
            self._work.run(jobs)
            self.jobs += itertools.takewhile(lambda job: self._work.result(job) is not None, jobs)
            together *= 2
            if len(self.jobs) < tried.stop:
                self.base, together = self._alone(range(len(self.jobs), len(self._prepared))), 1
                self.jobs.append(self.base)
                self._work.run([self.base])

    def _difference(self, group: int) -> Job:
        return self._prepared.job(DIFFERENCE, group, self._settings, {"base": made_by(self.base)})

    def _alone(self, groups: range) -> Job:
        """The key of the first of some groups by itself, with the rows that those need which may differ from it."""
        prepared, result, first = self._prepared, self._work.result, groups[0]
        sequence, start = prepared.sequence, prepared.spans[first].start
        written: WrittenRows = result(prepared.job(ROWS, first, self._settings))

        def needed() -> Iterator[NDArray[np.intp]]:
            yield written.rows
            for g in groups[1:]:
                there = prepared.spans[g].start
                if sequence.count(there) != sequence.count(start) or any(start < at <= there for at in sequence.breaks):
                    return
                yield result(prepared.job(ROWS, g, self._settings)).rows

        rows, together = with_rows_of_others(needed())
        if together == 1:
            return prepared.job(KEY, first, self._settings)
        surveys = [prepared.job(SURVEY, g) for g in groups[:together]]
        given = {
            "survey": Read(join_surveys([result(job) for job in surveys]), [job.entry for job in surveys]),
            "written": Read(replace(written, rows=rows), digest(rows)),
        }
        return prepared.job(KEY, first, self._settings, given)


def measure_encoded(encoded: Encoded, original: PreparedSequence, pictures: int) -> Measured:
    """An encoded package with its quality, in so many pictures that are spread over its segments, at least 1 each.

    `original`: the sequence with all SH bands.
    """
    m = encoded.manifest
    count = pictures_a_segment(pictures, len(m.segments))
    jobs = _quality_jobs(encoded, original, count, range(len(m.groups)))
    encoded.work.run(jobs)
    return with_quality(m, [encoded.work.result(job) for job in jobs], count)


def _quality_jobs(encoded: Encoded, original: PreparedSequence, count: int, groups: range) -> list[Job]:
    """The jobs that measure some groups, in `count` pictures of each segment."""
    m = encoded.manifest
    root = root_of(m)
    tables = Read((root, list(m.groups)), (root.levels, root.qualities))
    files = [made_by(job) for job in encoded.files]
    jobs = []
    for group in groups:
        keeps = m.groups[group].keeps
        pictures = pictures_of(original.views, m, group, count)
        base = NOTHING if keeps is None else files[keeps - 1]
        given = {"tables": tables, "pictures": Read(pictures, pictures), "files": files[group], "base_files": base}
        jobs.append(original.job(QUALITY, group, None, given))
    return jobs


def _about(prepared: PreparedSequence, settings: EncodeSettings, groups: Sequence[Group]) -> Provenance:
    """Say where a package comes from, with a line on the groups that are differences, if any are."""
    views, differing = prepared.views, sum(group.keeps is not None for group in groups)
    decisions = [*views.notes, *prepared.notes]
    if differing:
        decisions.append(f"{differing} of {len(groups)} groups are coded as what differs from an earlier one")
    return Provenance(
        settings,
        views.region,
        views.world,
        prepared.sequence.origin,
        Views(views.decided + CHECKED, 0, "original" if settings.measure_pictures else "none"),
        prepared.attribution,
        decisions,
        len(prepared.sequence),
        prepared.sequence.sh_degree,
    )
