"""Coded groups, and sound -> files of the package and their tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from airgs_codec import __version__
from airgs_codec.coding.channels import pack_matrix
from airgs_codec.encoder.deltas import CodedDeltas
from airgs_codec.encoder.keyframes import CodedKeyframe
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.streams import FrameClock
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
class GroupFiles:
    """A group as it goes into a package."""

    table: Group  # without measured quality
    files: Mapping[str, bytes]  # by path: its pictures and sidecars


def finish_group(keyframe: CodedKeyframe, deltas: CodedDeltas, first_segment: int) -> GroupFiles:
    """Make the table and the files of a group; `first_segment`: how many segments the groups before it have."""
    layout, channels = keyframe.layout, KEYFRAME if keyframe.layout.base is None else DELTA
    files: dict[str, bytes] = {}

    def written(path: str, data: bytes) -> FileEntry:
        files[path] = data
        return file_entry(data)

    tiers = []
    for t, parts in enumerate(keyframe.tiers):
        rows, packed = layout.tier_rows(t), keyframe.sidecar(t, deltas.depths)
        sidecar = written(keyframe_sidecar_path(t, layout.number), packed) if packed else NO_FILE
        media = [
            written(keyframe_media_path(t, q, layout.number), part.pictures.gops[0].media(part.detail))
            if part.atlas.rows
            else NO_FILE
            for q, part in enumerate(parts)
        ]
        atlases = [part.pictures.described(part.atlas, part.error, channels) for part in parts]
        tiers.append(GroupTier(rows.stop - rows.start, layout.factors[t], sidecar, atlases, media))
    segments: list[Segment] = [Segment(*span, []) for span in layout.segments]
    for j, level in enumerate(deltas.levels):
        gops = iter(level.pictures.gops)
        for place, (segment, escaped) in enumerate(zip(segments, level.escapes, strict=True)):
            if escaped is None:
                segment.levels.append(SegmentLevel(NO_FILE, [], [], []))
                continue
            gop = next(gops)
            file = written(delta_media_path(j, first_segment + place + 1), gop.media(escaped))
            segment.levels.append(SegmentLevel(file, gop.picture_bytes, [], [], True if level.slopes[place] else None))
    table = Group(
        start=layout.span[0],
        stop=layout.span[1],
        count=len(layout.rows),
        static=int((deltas.depths == STATIC).sum()),
        unused=layout.count - len(layout.rows),
        grid=layout.grid,
        keyframe_steps=layout.keyframe_steps,
        delta_steps=layout.delta_steps,
        colour_transform=pack_matrix(layout.transform),
        tiers=tiers,
        levels=[
            level.pictures.described(level.atlas, level.error if level.pictures.gops else None, DELTA)
            for level in deltas.levels
        ],
        segments=segments,
        left_out=[*keyframe.left_out, *deltas.left_out],
        repairs=[*layout.notes, *deltas.notes],
        base=layout.base,
    )
    return GroupFiles(table, files)


def build_manifest(
    plan: Plan, sequence: GaussianSequence, attribution: str, groups: Sequence[Group], poster: bytes
) -> tuple[Manifest, dict[str, bytes]]:
    """Make the tables of a package of these groups, without measured quality, and the files that are no group's."""
    settings, views, clock = plan.settings, plan.views, FrameClock.of(sequence.fps)
    shared = {INIT_NAME: init_segment(clock.timescale, *largest_picture(groups)), POSTER_NAME: poster}
    decisions, differing = list(plan.notes), sum(group.base is not None for group in groups)
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
        views=tables.Views(views.decided + views.checked, 0, "original" if settings.measure_pictures else "none"),
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
    """Return the tables of a package with sound, and its files by their paths."""
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
