"""A whole sequence to the files and tables of a package, by jobs of one group each.

The canonical frame of a group makes its key; what that decodes to is the space that the states of its frames are
differences to. Which groups keep rows of which is settled between the keys and the states: a group keeps rows of the
last one before it that keeps none, or becomes the one that later groups may keep rows of.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

from airgs_codec.encoder.group import CodedKey, GroupFiles
from airgs_codec.encoder.group_jobs import GroupJobs
from airgs_codec.encoder.measure import Measured, Round, RoundErrors, Rounds, measure_groups
from airgs_codec.encoder.plan import split_segments
from airgs_codec.encoder.representation import Clock
from airgs_codec.encoder.settings import KEPT, EncodeSettings
from airgs_codec.encoder.tables import Provenance, build_manifest
from airgs_codec.jobs.job import Job
from airgs_codec.jobs.work import Work
from airgs_codec.media.fragments import init_segment
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.memory import MemoryFiles
from airgs_codec.package.paths import INIT_NAME
from airgs_codec.package.store import Package, root_of
from airgs_codec.package.tables import Group, file_entry


@dataclass(frozen=True, slots=True, eq=False)
class EncodeJob:
    """What every encode of one sequence shares, whatever the settings."""

    groups: GroupJobs
    work: Work
    notes: Sequence[str] = ()  # what grouping found
    attribution: str = ""

    def about(self, settings: EncodeSettings) -> Provenance:
        """What a package says of where it comes from."""
        views, sequence = self.groups.views, self.groups.sequence
        return Provenance(
            settings,
            views.region,
            views.world,
            views.table(settings.measure_pictures),
            self.attribution,
            [*views.notes, *self.notes],
            len(sequence),
            sequence.sh_degree,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Encoded:
    """A package of which all jobs are done, but which is not written."""

    manifest: Manifest  # without measured quality
    init: bytes
    files: Sequence[Job]  # for each group: its `GroupFiles`
    base: Job  # the key whose rows a next group may keep
    work: Work

    def group(self, number: int) -> GroupFiles:
        """What one group is made of."""
        found = self.work.result(self.files[number])
        assert isinstance(found, GroupFiles)
        return found

    def base_key(self) -> CodedKey:
        """The group whose rows a next group may keep."""
        key = self.work.result(self.base)
        assert isinstance(key, CodedKey)
        return key

    def package(self) -> Package:
        """All of it in memory, to look at."""
        parts = [self.group(number).files for number in range(len(self.files))]
        files = {path: data for part in parts for path, data in part.items()}
        return Package(MemoryFiles("encoded package", {INIT_NAME: self.init, **files}), self.manifest, 0)


def encode_sequence(job: EncodeJob, settings: EncodeSettings) -> Encoded:
    """Do all that a package needs but its quality.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails.
    """
    groups, work = job.groups, job.work
    clock = Clock.of(groups.sequence.fps)
    everyone = range(len(groups))
    work.run([groups.survey(g) for g in everyone])
    work.run([groups.key(g, settings) for g in everyone])
    bases = _choose_bases(job, settings)
    segments = [len(split_segments(span, settings.segment_s, clock.fps)) for span in groups.spans]
    files = []
    for g, first in zip(everyone, itertools.accumulate(segments, initial=0), strict=False):
        base = bases[g]
        key = groups.key(g, settings) if base is None else groups.keep(g, base, settings)
        files.append(groups.files(g, key, None if base is None else groups.key(base, settings), first, settings))
    work.run(files)
    tables: list[Group] = [work.result(one).table for one in files]
    init = init_segment(clock.timescale, *largest_picture(tables))
    about = job.about(settings)
    about = replace(about, decisions=[*about.decisions, *_note_kept(tables)])
    last = len(groups) - 1 if bases[-1] is None else bases[-1]
    manifest = build_manifest(about, clock, file_entry(init), Groups.of(tables))
    return Encoded(manifest, init, files, groups.key(last, settings), work)


def _choose_bases(job: EncodeJob, settings: EncodeSettings) -> list[int | None]:
    """For each group the earlier one whose rows it keeps; None where it keeps none.

    Groups that might keep rows of the same one are tried at the same time, ever more while they do.
    """
    groups, work = job.groups, job.work
    bases: list[int | None] = [None]
    base, together = 0, 1
    while len(bases) < len(groups):
        if settings.keys != KEPT:
            bases.append(None)
            continue
        tried = range(len(bases), min(len(groups), len(bases) + together))
        jobs = [groups.keep(g, base, settings) for g in tried]
        work.run(jobs)
        together *= 2
        for g, tried_job in zip(tried, jobs, strict=True):
            kept = work.result(tried_job) is not None
            bases.append(base if kept else None)
            if not kept:
                base, together = g, 1
                break
    return bases


def measure_quality(job: EncodeJob, encoded: Encoded, original: GroupJobs, rounds: Rounds) -> Manifest:
    """The tables of an encoded package with the quality of every segment, level and key quality.

    `original` has all SH bands; `quality.measure_groups` says what is measured.
    """
    m = encoded.manifest
    tables = root_of(m), list(m.groups)

    def ask(asked: Round) -> list[RoundErrors]:
        jobs = [original.measure(encoded.files, g, asked, tables) for g in range(len(m.groups))]
        job.work.run(jobs)
        return [job.work.result(one) for one in jobs]

    measured: Measured = measure_groups(m, range(len(m.groups)), original.views, rounds, ask)
    return measured.whole(m)


def _note_kept(groups: Sequence[Group]) -> list[str]:
    """A line on the groups that keep rows, if any do."""
    keeping = [group for group in groups if group.keeps is not None]
    if not keeping:
        return []
    kept = sum(unit.kept for group in keeping for unit in group.units)
    share = kept / sum(group.count for group in keeping)
    return [f"{len(keeping)} of {len(groups)} groups keep {share:.0%} of their Gaussians from an earlier one"]


def largest_picture(groups: Sequence[Group]) -> tuple[int, int]:
    """Width and height that no picture of the groups exceeds."""
    tiles = [tile for group in groups for tile in group.tiles]
    atlases = [a for tile in tiles for row in (*(tier.qualities for tier in tile.tiers), tile.levels) for a in row]
    return max(atlas.width for atlas in atlases), max(atlas.height for atlas in atlases)
