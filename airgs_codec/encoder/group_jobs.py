"""The jobs that the groups of a sequence are encoded by, each named by the content of all that it reads.

What only decides how fast a job is done (threads), or where files lie, is in its arguments but not in its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from airgs_codec._settings import available_cores
from airgs_codec.encoder.group import GroupFiles, code_group, code_key, keep_key
from airgs_codec.encoder.measure import Round, RoundErrors, measure_round
from airgs_codec.encoder.sample import compare_lengths
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, ViewPlan, survey_group
from airgs_codec.jobs.digest import code_digest, digest
from airgs_codec.jobs.job import Job
from airgs_codec.package.memory import MemoryFiles
from airgs_codec.package.store import Package, manifest_of
from airgs_codec.package.tables import Group, Root
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(frozen=True, eq=False)
class GroupJobs:
    """The groups of one sequence, as they are looked at."""

    sequence: GaussianSequence
    spans: tuple[GroupSpan, ...]
    names: tuple[str, ...]  # of the content of all frames of the sequence as they are in their files
    views: ViewPlan

    @staticmethod
    def of(
        sequence: GaussianSequence, spans: Sequence[tuple[int, int]], names: Sequence[str], views: ViewPlan
    ) -> GroupJobs:
        """Groups of frames [start, stop)."""
        numbered = tuple(GroupSpan(index, *span) for index, span in enumerate(spans))
        return GroupJobs(sequence, numbered, tuple(names), views)

    def __len__(self) -> int:
        return len(self.spans)

    @cached_property
    def _seen(self) -> str:
        views = self.views
        return digest(views.deciding, views.decided, views.trusted, views.renderer)

    @cached_property
    def _contents(self) -> tuple[str, ...]:
        return tuple(self._content(span) for span in self.spans)

    def content(self, group: int) -> str:
        """The name of all frames of a group as they are read, and of what the trainer measured of them."""
        return self._contents[group]

    def _content(self, span: GroupSpan) -> str:
        s = self.sequence
        orders = [s.orders.get(frame) for frame in range(span.start, span.stop)]
        usage = s.usage(span.start, span.stop)
        return digest(self.names[span.start : span.stop], orders, s.sh_degree, s.fps, usage, span)

    def survey(self, group: int) -> Job:
        """What its views say about the rows of a group: a `Survey`."""
        arguments = (self.sequence, self.spans[group], self.views)
        return self._job("survey", group, survey_group, arguments, self.content(group), self._seen)

    def key(self, group: int, settings: EncodeSettings) -> Job:
        """The key of a group by itself: a `CodedKey`."""
        survey, choices = self.survey(group), _deciding(settings)
        return self._job("keys", group, code_key, (self.sequence, survey.result, settings), survey.entry, choices)

    def keep(self, group: int, base: int, settings: EncodeSettings) -> Job:
        """The key of a group that keeps rows of an earlier one: a `CodedKey`, or None."""
        fresh, of = self.key(group, settings), self.key(base, settings)
        arguments = (fresh.result, of.result, settings, self.sequence.fps)
        return self._job("kept rows", group, keep_key, arguments, fresh.entry, of.entry)

    def files(self, group: int, key: Job, base: Job | None, first_segment: int, settings: EncodeSettings) -> Job:
        """The files and the table of a group: `GroupFiles`. `base` made the key whose rows it keeps."""
        of = None if base is None else base.result
        arguments = (self.sequence, key.result, of, settings, first_segment)
        parts = (key.entry, None if base is None else base.entry, first_segment)
        return self._job("states", group, code_group, arguments, *parts)

    def measure(self, files: Sequence[Job], group: int, asked: Round, tables: tuple[Root, Sequence[Group]]) -> Job:
        """A round of pictures of the rungs of a group beside its frames as they are here: `RoundErrors`.

        `files`: of all groups; `tables`: those of the package that they make.
        """
        root, groups = tables
        keeps = groups[group].keeps
        base = None if keeps is None else files[keeps - 1]
        arguments = (self.sequence, self.views, tables, (group, asked), files[group].result, base and base.result)
        first = sum(len(table.segments) for table in groups[:group])
        total = sum(len(table.segments) for table in groups)
        pictures = [
            self.views.measure(asked.number * total + first + place, segment.start, segment.stop, asked.count)
            for place, segment in enumerate(groups[group].segments)
        ]
        parts = (files[group].entry, base and base.entry, self.content(group), pictures, self.views.renderer)
        return self._job("quality", group, measure_files, arguments, *parts, root.levels, root.qualities)

    def _job(self, kind: str, group: int, function: object, arguments: tuple[object, ...], *content: object) -> Job:
        span = self.spans[group]
        entry = digest(code_digest(), kind, *content)
        assert callable(function)
        return Job(kind, f"frames {span.start}-{span.stop - 1}", entry, function, arguments, code=code_digest())


def _deciding(settings: EncodeSettings) -> EncodeSettings:
    """The settings without those that decide nothing about the files of a group."""
    return replace(settings, threads=1, device="auto", measure_pictures=0, region=None, margin=None, world=None)


def length_job(sequence: GaussianSequence, names: Sequence[str], views: ViewPlan, settings: EncodeSettings) -> Job:
    """What groups of different lengths cost: a list of `LengthCost`."""
    orders = [sequence.orders.get(frame) for frame in range(len(sequence))]
    content = (names, orders, sequence.breaks, sequence.keyframes, sequence.fps, views.deciding, views.trusted)
    entry = digest(code_digest(), "lengths", content, views.renderer, _deciding(settings))
    alone = replace(settings, threads=available_cores())
    return Job("lengths of groups", "", entry, compare_lengths, (sequence, views, alone), code=code_digest())


def measure_files(
    original: GaussianSequence, views: ViewPlan, tables: tuple[Root, Sequence[Group]], asked: tuple[int, Round],
    own: GroupFiles, base: GroupFiles | None,
) -> RoundErrors:  # fmt: skip
    """A round of pictures of a group, from its files and those of the group whose rows it keeps.

    `tables`: those of the package; `asked`: the group, and which pictures.
    """
    files = {**own.files, **(base.files if base else {})}
    package = Package(MemoryFiles("encoded groups", files), manifest_of(*tables), 0)
    return measure_round(package, original, views, *asked)
