"""What was coded -> files of the package and their tables. G groups, S segments of the sequence, T tiers, L levels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
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
from airgs_codec.media.fragments import init_segment, with_columns
from airgs_codec.media.h264 import KEY_QP, STATE_QP, library_versions, qp_step
from airgs_codec.package import paths, tables
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.staging import write_file
from airgs_codec.package.tables import NO_FILE, STATIC, FileEntry, Group, GroupTier, Segment, SegmentLevel


def number_units(present: Sequence[Sequence[bool]]) -> list[list[int]]:
    """Places of units in their streams: units that are present count from 1, the others are 0.

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
    key_numbers: Sequence[Sequence[int]]  # G x T, places of key units in their streams; 0: no rows
    segment_numbers: Sequence[Sequence[int]]  # S x L, places of state segments; 0: nothing to fetch

    def segments(self) -> Iterator[tuple[int, int, Sequence[int]]]:
        """For each segment of the sequence its group, its place in the group and its places in the streams (L)."""
        numbers = iter(self.segment_numbers)
        for group, layout in enumerate(self.layouts):
            for place in range(len(layout.segments)):
                yield group, place, next(numbers)

    def first_segment(self, group: int) -> int:
        """How many segments the groups before it have."""
        return sum(len(layout.segments) for layout in self.layouts[:group])


def number_keys(keys: Sequence[CodedKeys]) -> list[list[int]]:
    """G x T places of the key units."""
    return number_units([[bool(tier[0].atlas.rows) for tier in group.tiers] for group in keys])


def number_segments(states: Sequence[CodedStates]) -> list[list[int]]:
    """S x L places of the state segments."""
    return number_units(
        [
            [escapes is not None for escapes in segment]
            for group in states
            for segment in zip(*(level.escapes for level in group.levels), strict=True)
        ]
    )


Files = Mapping[str, FileEntry]  # by path


def write_files(folder: Path, coded: CodedSequence) -> Files:
    """Write everything but the tables and the MPD: the init segment, pictures and sidecars; gives their entries."""
    return {path: write_file(folder, path, data) for path, data in _contents(coded)}


def _contents(coded: CodedSequence) -> Iterator[tuple[str, bytes]]:
    """Path and bytes of every file but the tables and manifests."""
    sizes = [r.size for row in (*coded.key_streams, coded.state_streams) for r in row]
    width, height = (max(size[axis] for size in sizes) for axis in (0, 1))
    yield paths.INIT_NAME, init_segment(coded.clock.timescale, width, height)
    for group in range(len(coded.layouts)):
        yield from _key_files(coded, group)
    for index, (group, place, numbers) in enumerate(coded.segments(), 1):
        for level, number in enumerate(numbers):
            escapes = coded.states[group].levels[level].escapes[place]
            stream = coded.state_streams[level].stream
            if stream and escapes is not None:
                yield paths.state_media_path(level, index), with_columns(stream.media[number - 1], escapes)


def _key_files(coded: CodedSequence, group: int) -> Iterator[tuple[str, bytes]]:
    layout, keys = coded.layouts[group], coded.keys[group]
    for t, number in enumerate(coded.key_numbers[group]):
        if not number:
            continue
        sidecar = layout.sidecar(layout.tier_rows(t), coded.states[group].depths)
        yield paths.key_sidecar_path(t, group + 1), pack_key_sidecar(sidecar, layout.grid, keys.coarser[-1])
        for q, (atlas, representation) in enumerate(zip(keys.tiers[t], coded.key_streams[t], strict=True)):
            assert representation.stream
            media = representation.stream.media[number - 1]
            yield paths.key_media_path(t, q, group + 1), with_columns(media, atlas.detail)


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


def build_manifest(coded: CodedSequence, files: Files, about: Provenance) -> Manifest:
    """The tables of a package, without measured quality; `files` are those of `write_files`."""
    settings, clock = about.settings, coded.clock
    return Manifest(
        version=tables.VERSION,
        generator=tables.Generator(__version__, library_versions(), settings.table()),
        attribution=about.attribution,
        decisions=list(about.decisions),
        frame_rate=[clock.fps.numerator, clock.fps.denominator],
        timescale=clock.timescale,
        frames=about.frames,
        live=False,
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
        tiers=len(coded.key_streams),
        init=files[paths.INIT_NAME],
        groups=Groups.of([_group_table(coded, files, group) for group in range(len(coded.layouts))]),
    )


def _group_table(coded: CodedSequence, files: Files, group: int) -> Group:
    layout, keys, states = coded.layouts[group], coded.keys[group], coded.states[group]
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
        tiers=[_tier_table(coded, files, group, tier) for tier in range(len(coded.key_streams))],
        levels=[_level_table(coded, group, level) for level in range(len(coded.state_streams))],
        segments=_segment_tables(coded, files, group),
        left_out=[*keys.left_out, *states.left_out],
        repairs=list(layout.notes),
    )


def _tier_table(coded: CodedSequence, files: Files, group: int, tier: int) -> GroupTier:
    number = coded.key_numbers[group][tier]
    qualities = coded.keys[group].tiers[tier]
    atlases = []
    for part, representation in zip(qualities, coded.key_streams[tier], strict=True):
        differences = [representation.differences[number - 1]] if number else []
        atlases.append(_shown(with_bounds(part.atlas, part.error, differences, KEY), representation))
    pictures = [files.get(paths.key_media_path(tier, q, group + 1), NO_FILE) for q in range(len(qualities))]
    sidecar = files.get(paths.key_sidecar_path(tier, group + 1), NO_FILE)
    return GroupTier(qualities[0].atlas.rows, sidecar, atlases, pictures)


def _level_table(coded: CodedSequence, group: int, level: int) -> tables.Atlas:
    representation = coded.state_streams[level]
    numbers = [numbers[level] for g, _, numbers in coded.segments() if g == group]
    differences = [representation.differences[number - 1] for number in numbers if number]
    part = coded.states[group].levels[level]
    return _shown(with_bounds(part.atlas, part.error, differences, STATE), representation)


def _shown(atlas: tables.Atlas, representation: Representation) -> tables.Atlas:
    """The atlas with the size of its pictures; a level without planes has none."""
    width, height = representation.size if atlas.planes else (0, 0)
    return replace(atlas, width=width, height=height)


def _segment_tables(coded: CodedSequence, files: Files, group: int) -> list[Segment]:
    first, segments = coded.first_segment(group), coded.layouts[group].segments
    return [
        Segment(*span, [_segment_level(coded, files, index, level) for level in range(len(coded.state_streams))])
        for index, span in enumerate(segments, first)
    ]


def _segment_level(coded: CodedSequence, files: Files, index: int, level: int) -> SegmentLevel:
    number, stream = coded.segment_numbers[index][level], coded.state_streams[level].stream
    sizes = stream.picture_bytes[number - 1] if number and stream else []
    return SegmentLevel(files.get(paths.state_media_path(level, index + 1), NO_FILE), sizes, [], [], [], [])
