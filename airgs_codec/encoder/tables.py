"""What was coded -> files of the package and their tables. G groups, S segments of the sequence, T tiers, L levels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airgs_codec import __version__
from airgs_codec.coding.sidecar import pack_key_sidecar
from airgs_codec.encoder.error_bounds import with_bounds
from airgs_codec.encoder.keys import CodedKeys
from airgs_codec.encoder.plan import GroupLayout
from airgs_codec.encoder.representation import Clock, Representation
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.states import CodedStates
from airgs_codec.media.h264 import KEY_QP, STATE_QP, library_versions, qp_step
from airgs_codec.package import tables
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.staging import write_file
from airgs_codec.package.tables import STATIC, FileEntry, Group, GroupTier, Segment, SegmentLevel


def number_units(present: Sequence[Sequence[bool]]) -> list[list[int]]:
    """Numbers of the files of each representation: units that are present count from 1, the others are 0.

    `present` and the result are units x representations.
    """
    numbers: list[list[int]] = (np.cumsum(present, axis=0) * np.array(present)).tolist()
    return numbers


@dataclass(frozen=True, slots=True, eq=False)
class CodedSequence:
    """All that a package is made of."""

    clock: Clock
    layouts: Sequence[GroupLayout]
    keys: Sequence[CodedKeys]
    states: Sequence[CodedStates]
    key_streams: Sequence[Sequence[Representation]]  # T x qualities
    state_streams: Sequence[Representation]  # L
    key_numbers: Sequence[Sequence[int]]  # G x T, of key units; 0: no rows
    segment_numbers: Sequence[Sequence[int]]  # S x L, of state segments; 0: nothing to fetch

    def segments(self) -> Iterator[tuple[int, int, Sequence[int]]]:
        """For each segment of the sequence its group, its place in the group and its numbers (L)."""
        numbers = iter(self.segment_numbers)
        for group, layout in enumerate(self.layouts):
            for place in range(len(layout.segments)):
                yield group, place, next(numbers)


def number_keys(keys: Sequence[CodedKeys]) -> list[list[int]]:
    """G x T numbers of the key units."""
    return number_units([[bool(tier[0].atlas.rows) for tier in group.tiers] for group in keys])


def number_segments(states: Sequence[CodedStates]) -> list[list[int]]:
    """S x L numbers of the state segments."""
    return number_units(
        [
            [escapes is not None for escapes in segment]
            for group in states
            for segment in zip(*(level.escapes for level in group.levels), strict=True)
        ]
    )


def write_files(folder: Path, coded: CodedSequence) -> dict[str, FileEntry]:
    """Write every init segment, media segment and sidecar; gives their entries, sorted by path."""
    files = {path: write_file(folder, path, data) for path, data in _contents(coded)}
    return dict(sorted(files.items()))


def _contents(coded: CodedSequence) -> Iterator[tuple[str, bytes]]:
    """Path and bytes of every file but the manifests."""
    yield from _streams(coded)
    yield from _key_sidecars(coded)
    for group, place, numbers in coded.segments():
        for level, number in enumerate(numbers):
            data = coded.states[group].levels[level].escapes[place]
            if data is not None:
                yield tables.state_sidecar_path(level, number), data


def _streams(coded: CodedSequence) -> Iterator[tuple[str, bytes]]:
    for t, row in enumerate(coded.key_streams):
        for q, representation in enumerate(row):
            if representation.stream:
                yield tables.key_init_path(t, q), representation.stream.init
                for number, media in enumerate(representation.stream.media, 1):
                    yield tables.key_media_path(t, q, number), media
    for level, representation in enumerate(coded.state_streams):
        if representation.stream:
            yield tables.state_init_path(level), representation.stream.init
            for number, media in enumerate(representation.stream.media, 1):
                yield tables.state_media_path(level, number), media


def _key_sidecars(coded: CodedSequence) -> Iterator[tuple[str, bytes]]:
    for g, (layout, keys) in enumerate(zip(coded.layouts, coded.keys, strict=True)):
        for t, number in enumerate(coded.key_numbers[g]):
            if not number:
                continue
            sidecar = layout.sidecar(layout.tier_rows(t), coded.states[g].depths)
            yield tables.key_sidecar_path(t, number), pack_key_sidecar(sidecar, layout.grid, keys.coarser[-1])
            for q, atlas in enumerate(keys.tiers[t]):
                yield tables.key_detail_path(t, q, number), atlas.detail


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a package comes from: what airgs.json records but no picture depends on."""

    settings: EncodeSettings
    region: tables.Region
    views: tables.Views
    attribution: str
    decisions: Sequence[str]  # about views and groups
    frames: int
    sh_degree: int


def build_manifest(coded: CodedSequence, files: dict[str, FileEntry], about: Provenance) -> tables.Manifest:
    """The tables of a package, without measured quality; `files` are those of `write_files`."""
    settings, clock = about.settings, coded.clock
    parts = [(keys.left_out, states.left_out) for keys, states in zip(coded.keys, coded.states, strict=True)]
    return tables.Manifest(
        version=tables.VERSION,
        generator=tables.Generator(__version__, library_versions(), settings.table()),
        attribution=about.attribution,
        repairs=[note for layout in coded.layouts for note in layout.notes],
        decisions=list(about.decisions),
        frame_rate=[clock.fps.numerator, clock.fps.denominator],
        timescale=clock.timescale,
        frames=about.frames,
        sh_degree=about.sh_degree,
        key_gain=qp_step(KEY_QP),
        state_gain=qp_step(STATE_QP),
        region=about.region,
        views=about.views,
        qualities=[
            tables.KeyQuality(f"Q{q}", factor, coarser)
            for q, (factor, coarser) in enumerate(zip(settings.key_factors, settings.coarser, strict=True))
        ],
        levels=[
            tables.Level(f"L{j}", level.pruned, level.factor, settings.tiers_of(level), level.quality)
            for j, level in enumerate(settings.levels)
        ],
        key_pictures=[[representation.picture() for representation in row] for row in coded.key_streams],
        state_pictures=[representation.picture() for representation in coded.state_streams],
        groups=[_group_table(coded, group) for group in range(len(coded.layouts))],
        segments=[_segment_table(coded, *segment) for segment in coded.segments()],
        left_out=[entry for group in parts for side in group for entry in side],
        files=files,
    )


def _group_table(coded: CodedSequence, group: int) -> Group:
    layout, states = coded.layouts[group], coded.states[group]
    return Group(
        start=layout.span.start,
        stop=layout.span.stop,
        count=len(layout.rows),
        static=int((states.depths == STATIC).sum()),
        unused=layout.count - len(layout.rows),
        grid=layout.grid,
        key_steps=layout.key_steps,
        state_steps=layout.state_steps,
        colour_transform=tables.pack_matrix(layout.transform),
        tiers=[_tier_table(coded, group, tier) for tier in range(len(coded.key_streams))],
        levels=[_level_table(coded, group, level) for level in range(len(coded.state_streams))],
    )


def _tier_table(coded: CodedSequence, group: int, tier: int) -> GroupTier:
    number = coded.key_numbers[group][tier]
    qualities = coded.keys[group].tiers[tier]
    atlases = []
    for part, representation in zip(qualities, coded.key_streams[tier], strict=True):
        differences = [representation.differences[number - 1]] if number else []
        atlases.append(with_bounds(part.atlas, part.error, differences, KEY))
    return GroupTier(qualities[0].atlas.rows, number, atlases)


def _level_table(coded: CodedSequence, group: int, level: int) -> tables.Atlas:
    numbers = [numbers[level] for g, _, numbers in coded.segments() if g == group]
    differences = [coded.state_streams[level].differences[number - 1] for number in numbers if number]
    part = coded.states[group].levels[level]
    return with_bounds(part.atlas, part.error, differences, STATE)


def _segment_table(coded: CodedSequence, group: int, place: int, numbers: Sequence[int]) -> Segment:
    levels = []
    for number, representation in zip(numbers, coded.state_streams, strict=True):
        sizes = representation.stream.picture_bytes[number - 1] if number and representation.stream else []
        levels.append(SegmentLevel(number, sizes, [], [], [], []))
    return Segment(group, *coded.layouts[group].segments[place], levels)
