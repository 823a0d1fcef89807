"""Coded groups, and sound -> files of the package and their tables."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from airgs_codec import __version__
from airgs_codec.coding.channels import pack_matrix
from airgs_codec.coding.sidecar import pack_keyframe_sidecar
from airgs_codec.encoder.deltas import CodedDeltas
from airgs_codec.encoder.keyframes import CodedKeyframes, keyframe_sidecar
from airgs_codec.encoder.layout import GroupLayout
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.streams import Clock, ErrorModel, Representation, with_bounds
from airgs_codec.encoder.views import CHECKED
from airgs_codec.media.h264 import DELTA_QP, KEYFRAME_QP, library_versions, qp_step
from airgs_codec.media.movie import SoundTrack
from airgs_codec.media.mp4 import init_segment, sound_segment
from airgs_codec.package import tables
from airgs_codec.package.layout import (
    DELTA,
    INIT_NAME,
    KEYFRAME,
    POSTER_NAME,
    SOUND_INIT_NAME,
    Layout,
    delta_media_path,
    keyframe_media_path,
    keyframe_sidecar_path,
    sound_path,
)
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.mpd import largest_picture
from airgs_codec.package.tables import (
    NO_FILE,
    STATIC,
    FileEntry,
    Group,
    GroupTier,
    Segment,
    SegmentLevel,
    file_entry,
)
from airgs_codec.scene.frames import ZERO
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(frozen=True, slots=True, eq=False)
class CodedGroup:
    """All that the files and the table of a group are made of."""

    layout: GroupLayout
    keyframes: CodedKeyframes
    deltas: CodedDeltas
    keyframe_pictures: Sequence[Sequence[Representation]]  # keyframe tier x keyframe quality
    delta_pictures: Sequence[Representation]  # of each level
    first_segment: int  # how many segments the groups before it have

    @property
    def number(self) -> int:
        """The group in paths: it counts from 1."""
        return self.layout.number


Files = Mapping[str, FileEntry]  # by path


def finish_group(group: CodedGroup) -> tuple[Group, dict[str, bytes]]:
    """The table of a group, without measured quality, and the bytes of its pictures and sidecars by their paths."""
    contents = dict(itertools.chain(_keyframe_files(group), _delta_files(group)))
    return _group_table(group, {path: file_entry(data) for path, data in contents.items()}), contents


def _keyframe_files(group: CodedGroup) -> Iterator[tuple[str, bytes]]:
    """Path and bytes of the files of every keyframe tier that has rows."""
    layout, keyframes = group.layout, group.keyframes
    for t, pictures in enumerate(group.keyframe_pictures):
        rows = layout.tier_rows(t)
        if rows.start == rows.stop:
            continue
        sidecar = keyframe_sidecar(layout, t, group.deltas.depths)
        yield keyframe_sidecar_path(t, group.number), pack_keyframe_sidecar(sidecar, layout.grid, keyframes.coarser[-1])
        for q, (atlas, representation) in enumerate(zip(keyframes.tiers[t], pictures, strict=True)):
            if not atlas.atlas.rows:
                continue
            yield keyframe_media_path(t, q, group.number), representation.gops[0].media(atlas.detail)


def _delta_files(group: CodedGroup) -> Iterator[tuple[str, bytes]]:
    """Path and bytes of every segment that is fetched."""
    for j, (level, representation) in enumerate(zip(group.deltas.levels, group.delta_pictures, strict=True)):
        gops = iter(representation.gops)
        for place, escapes in enumerate(level.escapes, group.first_segment):
            if escapes is not None:
                yield delta_media_path(j, place + 1), next(gops).media(escapes)


def build_manifest(
    plan: Plan, sequence: GaussianSequence, attribution: str, groups: Sequence[Group], poster: bytes
) -> tuple[Manifest, dict[str, bytes]]:
    """Make the tables of a package of these groups, without measured quality, and the files that are no group's."""
    settings, views, clock = plan.settings, plan.views, Clock.of(sequence.fps)
    shared = {INIT_NAME: init_segment(clock.timescale, *largest_picture(groups)), POSTER_NAME: poster}
    decisions, differing = list(plan.notes), sum(group.keeps is not None for group in groups)
    if differing:
        decisions.append(f"{differing} of {len(groups)} keyframes are coded as what differs from an earlier one")
    manifest = Manifest(
        version=tables.VERSION,
        generator=tables.Generator(__version__, library_versions(), settings.table()),
        attribution=attribution,
        decisions=decisions,
        frame_rate=[clock.fps.numerator, clock.fps.denominator],
        timescale=clock.timescale,
        frames=groups[-1].stop - groups[0].start,
        live=False,
        sh_degree=plan.sh_degree,
        keyframe_gain=qp_step(KEYFRAME_QP),
        delta_gain=qp_step(DELTA_QP),
        region=views.region,
        world=views.world,
        origin=None if sequence.origin == ZERO else list(sequence.origin),
        poster=file_entry(poster),
        views=tables.Views(views.decided + CHECKED, 0, "original" if settings.measure_pictures else "none"),
        qualities=[
            tables.KeyframeQuality(f"Q{q}", factor, coarser)
            for q, (factor, coarser) in enumerate(zip(settings.keyframe_factors, settings.coarser, strict=True))
        ],
        levels=[
            tables.Level(f"L{j}", level.pruned, level.factor, settings.tiers_of(level), level.quality)
            for j, level in enumerate(settings.levels)
        ],
        tiers=len(settings.tiers),
        rungs=[],
        sound=None,
        init=file_entry(shared[INIT_NAME]),
        groups=Groups.of(groups),
    )
    return manifest, shared


def add_sound(m: Manifest, track: SoundTrack) -> tuple[Manifest, dict[str, bytes]]:
    """The tables of a package with sound, and its files by their paths."""
    files = {SOUND_INIT_NAME: track.init}
    groups: list[Group] = []
    for number, group in enumerate(m.groups, 1):
        span = m.packets(group.start, group.stop)
        if span:
            files[sound_path(number)] = sound_segment(track.packets[span.start : span.stop], span.start)
        entry = file_entry(files[sound_path(number)]) if span else NO_FILE
        groups.append(replace(group, sound=entry))
    sound = tables.Sound(track.channels, track.pre_skip, file_entry(track.init))
    return replace(m, sound=sound, groups=Groups.of(groups)), files


def _group_table(group: CodedGroup, files: Files) -> Group:
    layout, deltas = group.layout, group.deltas
    levels = zip(deltas.levels, group.delta_pictures, strict=True)
    return Group(
        start=layout.span[0],
        stop=layout.span[1],
        count=len(layout.rows),
        static=int((deltas.depths == STATIC).sum()),
        unused=layout.count - len(layout.rows),
        grid=layout.grid,
        keyframe_steps=layout.keyframe_steps,
        delta_steps=layout.delta_steps,
        colour_transform=pack_matrix(layout.transform),
        tiers=[_tier_table(group, files, t) for t in range(len(layout.factors))],
        levels=[_bounded(level.atlas, level.error if of.gops else None, of, DELTA) for level, of in levels],
        segments=_segment_tables(group, files),
        left_out=[*group.keyframes.left_out, *deltas.left_out],
        repairs=[*layout.notes, *deltas.notes],
        keeps=layout.keeps,
    )


def _tier_table(group: CodedGroup, files: Files, t: int) -> GroupTier:
    parts, pictures, layout = group.keyframes.tiers[t], group.keyframe_pictures[t], group.layout
    channels, rows = KEYFRAME if layout.keeps is None else DELTA, layout.tier_rows(t)
    atlases = [_bounded(part.atlas, part.error, shown, channels) for part, shown in zip(parts, pictures, strict=True)]
    media = [files.get(keyframe_media_path(t, q, group.number), NO_FILE) for q in range(len(parts))]
    sidecar = files.get(keyframe_sidecar_path(t, group.number), NO_FILE)
    return GroupTier(rows.stop - rows.start, layout.factors[t], sidecar, atlases, media)


def _bounded(
    atlas: tables.Atlas, error: ErrorModel | None, representation: Representation, layout: Layout
) -> tables.Atlas:
    """The atlas with its largest errors and the size of its pictures; one without planes has none."""
    width, height = representation.size if atlas.planes else (0, 0)
    return replace(with_bounds(atlas, error, representation.differences, layout), width=width, height=height)


def _segment_tables(group: CodedGroup, files: Files) -> list[Segment]:
    gops = [iter(representation.gops) for representation in group.delta_pictures]

    def level(j: int, number: int) -> SegmentLevel:
        file = files.get(delta_media_path(j, number), NO_FILE)
        sizes = next(gops[j]).picture_bytes if file.bytes else []
        line = group.deltas.levels[j].lines[number - 1 - group.first_segment]
        return SegmentLevel(file, sizes, [], [], True if line else None)

    return [
        Segment(*span, [level(j, index + 1) for j in range(len(gops))])
        for index, span in enumerate(group.layout.segments, group.first_segment)
    ]
