"""Gaussians -> files and tables of a package, group after group.

The canonical frame of a group makes its key; what that decodes to is the space that the states of its frames are
differences to. The frames of one group are in memory at a time.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.encoder.kept import BaseGroup, keep_known
from airgs_codec.encoder.keys import CodedKeys, code_keys, decode_base, encode_keys, key_bytes
from airgs_codec.encoder.plan import CODED_HERE, GroupLayout, keep_rows, lay_out
from airgs_codec.encoder.representation import Clock, Done, Representation
from airgs_codec.encoder.settings import KEPT, EncodeSettings
from airgs_codec.encoder.states import code_states, encode_states
from airgs_codec.encoder.survey import Survey
from airgs_codec.encoder.tables import CodedGroup, Provenance, build_manifest, publish_group
from airgs_codec.encoder.views import ViewPlan
from airgs_codec.media.fragments import init_segment
from airgs_codec.package.folder import Folder
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.paths import INIT_NAME
from airgs_codec.package.tables import Group
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(frozen=True, slots=True, eq=False)
class EncodeJob:
    """What every encode of one sequence shares, whatever the settings."""

    sequence: GaussianSequence
    surveys: Sequence[Survey]  # one a group
    views: ViewPlan
    notes: Sequence[str] = ()  # what grouping found
    attribution: str = ""

    def about(self, settings: EncodeSettings) -> Provenance:
        """What a package says of where it comes from."""
        return Provenance(
            settings,
            self.views.region,
            self.views.world,
            self.views.table(settings.measure_pictures),
            self.attribution,
            [*self.views.notes, *self.notes],
            len(self.sequence),
            self.sequence.sh_degree,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Encoded:
    """What an encode wrote, and which rows it wrote."""

    manifest: Manifest  # without measured quality
    layouts: Sequence[GroupLayout]
    depths: Sequence[NDArray[np.uint8]]  # of the rows of each group, in file order
    base: BaseGroup  # whose rows the next group may keep


def encode_sequence(job: EncodeJob, settings: EncodeSettings, folder: Path, progress: Progress = silent) -> Encoded:
    """Write every file of a package into `folder` but tables and manifests.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails.
    """
    clock = Clock.of(job.sequence.fps)
    finished, most = itertools.count(1), len(job.surveys) * count_streams(settings)
    groups: list[Group] = []
    layouts, depths = [], []
    base: BaseGroup | None = None
    progress("encoding", 0, most)
    with tempfile.TemporaryDirectory(prefix=".scratch", dir=folder) as scratch:
        for survey in job.surveys:
            first = sum(len(group.segments) for group in groups)
            task = GroupTask(job.sequence, survey, first, Path(scratch), base)
            coded = code_group(task, settings, lambda: progress("encoding", next(finished), most))
            groups.append(publish_group(Folder(folder), coded))
            base = coded.base
            layouts.append(coded.layout)
            depths.append(coded.states.depths)
    init = Folder(folder).write(INIT_NAME, init_segment(clock.timescale, *largest_picture(groups)))
    about = job.about(settings)
    about = replace(about, decisions=[*about.decisions, *_note_kept(groups, layouts)])
    return Encoded(build_manifest(about, clock, init, Groups.of(groups)), layouts, depths, coded.base)


def _note_kept(groups: Sequence[Group], layouts: Sequence[GroupLayout]) -> list[str]:
    """A line on the groups that keep rows, if any do."""
    keeping = [place for place, group in enumerate(groups) if group.keeps is not None]
    if not keeping:
        return []
    kept = sum(int((layouts[place].base_rows != CODED_HERE).sum()) for place in keeping)
    share = kept / sum(groups[place].count for place in keeping)
    return [f"{len(keeping)} of {len(groups)} groups keep {share:.0%} of their Gaussians from an earlier one"]


@dataclass(frozen=True, slots=True, eq=False)
class GroupTask:
    """A group that is to be encoded."""

    sequence: GaussianSequence
    survey: Survey
    first_segment: int  # how many segments the groups before it have
    scratch: Path  # a folder for samples that wait to be encoded
    base: BaseGroup | None = None  # an earlier group whose rows it may keep


def count_streams(settings: EncodeSettings) -> int:
    """How many streams of pictures a group has."""
    return len(settings.tiers) * len(settings.key_factors) + len(settings.levels)


def code_group(task: GroupTask, settings: EncodeSettings, done: Done) -> CodedGroup:
    """Quantise and encode a group; `done` is called after every stream of pictures.

    Raises SceneError for a group that cannot be coded, CodecError when the video encoder fails.
    """
    sequence, survey = task.sequence, task.survey
    clock = Clock.of(sequence.fps)
    loaded = sequence.load(range(survey.span.start, survey.span.stop))
    fresh = lay_out(loaded, survey, keep_rows(loaded.frames, survey, settings), settings, sequence.fps)
    coded = _encode_kept(task, fresh, settings, done)
    layout, keys, key_pictures = coded or (fresh, *_encode_keys(fresh, clock, settings, done))
    base = task.base if coded else None
    spaces = [None] * len(settings.key_factors) if base is None else base.spaces
    decoded = [decode_base(layout, keys, key_pictures, settings, q, space) for q, space in enumerate(spaces)]
    bases = [part.space for part in decoded]
    states = code_states(layout, bases, loaded.frames, settings, task.scratch)
    state_pictures = encode_states(layout, states, clock, settings, done)
    size = key_bytes(layout, keys, key_pictures, base.layout if base else None)
    kept_of = base or BaseGroup(layout, [part.channels for part in decoded], bases, size)
    return CodedGroup(layout, keys, states, key_pictures, state_pictures, task.first_segment, kept_of)


def _encode_keys(
    layout: GroupLayout, clock: Clock, settings: EncodeSettings, done: Done
) -> tuple[CodedKeys, list[list[Representation]]]:
    keys = code_keys(layout, settings)
    return keys, encode_keys(layout, keys, clock, settings, done)


def _encode_kept(
    task: GroupTask, fresh: GroupLayout, settings: EncodeSettings, done: Done
) -> tuple[GroupLayout, CodedKeys, list[list[Representation]]] | None:
    """The key of a group that keeps rows; None where it has none to keep or that saves too little."""
    if task.base is None or settings.keys != KEPT:
        return None
    layout = keep_known(fresh, task.base, settings)
    if layout is None:
        return None
    keys, pictures = _encode_keys(layout, Clock.of(task.sequence.fps), settings, lambda: None)
    if key_bytes(layout, keys, pictures, task.base.layout) > task.base.worth_bytes(len(layout.rows)):
        return None
    for _ in itertools.chain(*pictures):
        done()
    return layout, keys, pictures


def largest_picture(groups: Sequence[Group]) -> tuple[int, int]:
    """Width and height that no picture of the groups exceeds."""
    atlases = [atlas for g in groups for row in (*(tier.qualities for tier in g.tiers), g.levels) for atlas in row]
    return max(atlas.width for atlas in atlases), max(atlas.height for atlas in atlases)
