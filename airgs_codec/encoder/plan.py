"""Everything that is chosen for a scene before it is encoded, as one value that can be printed, stored and followed."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from airgs_codec._arguments import brief
from airgs_codec.analysis.grouping import closed_groups, count_changes
from airgs_codec.encoder.layout import split_segments
from airgs_codec.encoder.settings import INTRA, EncodeSettings
from airgs_codec.encoder.survey import Frames, Span
from airgs_codec.encoder.views import SceneViews
from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.package.parse import as_plain, read_as
from airgs_codec.scene.sequence import GaussianSequence

RUN = 8  # groups


@dataclass(frozen=True, slots=True)
class Choice:
    """A choice of a plan: what it was about, what was chosen, what that cost, and what it is worth."""

    about: str
    chosen: str
    seconds: float = 0.0
    gained: str = ""


@dataclass(frozen=True, slots=True)
class Plan:
    """How a sequence is encoded: what an encode does follows from its frames and its plan alone."""

    settings: EncodeSettings  # with the steps and pruning levels of the scene: nothing is left to choose in them
    views: SceneViews
    sh_degree: int  # SH bands above it are left out
    sloped: bool  # segments have slopes: what Gaussians change by, evenly, is a picture of its own
    run: int  # most groups of a run, whose first keyframe is chosen for all; 0: any number, it is chosen for its group
    groups: tuple[Span, ...]  # frames [start, stop) of each; of a growing sequence, of those that were there
    begins: tuple[int, ...]  # the groups that begin runs: their keyframes are coded by themselves
    notes: tuple[str, ...] = ()  # on views, order of Gaussians and groups, for people
    choices: tuple[Choice, ...] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        """Raise ConfigError for groups that do not follow each other, and runs that do not begin with one of them."""
        ends, begins = [0, *(stop for _, stop in self.groups)], list(self.begins)
        if any(start != end or stop <= start for (start, stop), end in zip(self.groups, ends, strict=False)):
            raise ConfigError("groups: expected spans that follow each other from frame 0 on")
        if begins != sorted({*begins, *([0] if self.groups else [])} & set(range(len(self.groups)))):
            raise ConfigError("begins: expected ascending numbers of groups, 0 first")
        if self.run < 0:
            raise ConfigError(f"run: expected 0 or more groups, got {self.run}")

    def with_groups(self, sequence: GaussianSequence, groups: Sequence[Span]) -> Plan:
        """Add groups to the plan."""
        begins = list(self.begins)
        for number, (start, _) in enumerate(groups, len(self.groups)):
            if not begins or self.begins_run(sequence, start, number - begins[-1]):
                begins.append(number)
        return replace(self, groups=(*self.groups, *groups), begins=tuple(begins))

    def begins_run(self, sequence: GaussianSequence, start: int, length: int) -> bool:
        """Return whether a group that starts at a frame begins a run, where the last run has `length` groups.

        It does where it has other Gaussians than the group before it, where that run is full, and where the settings
        ask for it.
        """
        full = self.settings.keyframes == INTRA or 0 < self.run <= length
        return full or start in sequence.breaks or sequence.count(start) != sequence.count(start - 1)

    def of(self, sequence: GaussianSequence) -> Plan:
        """Return the plan with groups for all frames of a sequence. Raises ConfigError where it is of another one."""
        planned = self.groups[-1][1] if self.groups else 0
        if planned > len(sequence):
            raise ConfigError(f"plan: expected a sequence of at least {planned} frames, got {len(sequence)}")
        starts = {start for start, _ in self.groups}
        for frame in {*count_changes(sequence), *sequence.breaks}:
            if frame < planned and frame not in starts:
                raise ConfigError(f"plan: expected equal Gaussians in a group, got others from frame {frame} on")
        return self.with_groups(sequence, closed_groups(sequence, planned, self.settings.group_frames, done=True))

    def spans(self, number: int) -> tuple[Span, ...]:
        """Give the frames of a group, then those of the groups after it that its keyframe is chosen for."""
        later = bisect_right(self.begins, number)
        end = self.begins[later] if later < len(self.begins) else len(self.groups)
        return self.groups[number : end if self.run else number + 1]

    def part(self, sequence: GaussianSequence, number: int, first_segment: int) -> Frames:
        """Give the frames of a group, without the SH bands that are left out."""
        read = replace(sequence, max_sh_degree=self.sh_degree)
        return Frames(read, number, self.spans(number), first_segment, number in self.begins)

    def frames(self, sequence: GaussianSequence) -> list[Frames]:
        """Give the frames of every group."""
        first, found = 0, []
        for number, span in enumerate(self.groups):
            found.append(self.part(sequence, number, first))
            first += len(split_segments(span, self.settings.segment_s, sequence.fps))
        return found

    def runs(self, sequence: GaussianSequence) -> Iterator[list[Frames]]:
        """Give the frames of the groups of each run: none needs another run."""
        frames = self.frames(sequence)
        for start, stop in pairwise([*self.begins, len(self.groups)]):
            yield frames[start:stop]

    def to_json(self) -> str:
        return json.dumps(self, default=as_plain, indent=1)

    @staticmethod
    def from_json(data: str | bytes, where: str = "plan") -> Plan:
        """Read a plan. Raises ConfigError for anything else."""
        try:
            return read_as(Plan, data.encode() if isinstance(data, str) else data, where)
        except FormatError as error:
            raise ConfigError(f"{error.where}: {error.detail}") from error
