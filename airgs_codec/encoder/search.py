"""Trial encodes of the top rung, until it has a PSNR or a size."""

from __future__ import annotations

import itertools
from dataclasses import replace

from airgs_codec.encoder.encoder import EncodeJob, encode_sequence, measure_quality
from airgs_codec.encoder.group_jobs import GroupJobs
from airgs_codec.encoder.limits import find_limit
from airgs_codec.encoder.quality import Rounds
from airgs_codec.encoder.rate_target import PSNR, Goal, OutOfReachError, find_quality
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.package.manifest import Groups, Manifest, pooled_quality
from airgs_codec.package.mpd import write_mpd
from airgs_codec.package.packing import pack_json
from airgs_codec.package.store import root_of
from airgs_codec.package.tables import FileEntry, Group, SegmentLevel, digest

TRIAL_PICTURES = 12  # measured in each segment for a PSNR, where the package itself is not measured


def search_quality(job: EncodeJob, original: GroupJobs, settings: EncodeSettings, goal: Goal) -> tuple[float, Rounds]:
    """The quality factor that brings the top rung to its goal, and the pictures that it was measured with.

    Raises ConfigError for a goal out of reach. The error then names what keeps pictures from a higher PSNR. PSNR is
    measured against `original`, which has all SH bands.
    """
    top = replace(settings, levels=settings.levels[:1], key_factors=settings.key_factors[:1])
    rounds = Rounds(settings.measure_pictures or TRIAL_PICTURES)
    numbers = itertools.count(1)

    def trial(factor: float) -> float:
        nonlocal rounds
        job.work.progress(f"trial {next(numbers)}: quality factor {factor:.3g}", 0, 1)
        encoded = encode_sequence(job, top.at(factor))
        if goal.kind != PSNR:
            return kilobytes_a_frame(encoded.manifest, settings)
        tables = measure_quality(job, encoded, original, rounds)
        rounds = rounds.again(tables.views.measured // original.views.measured(rounds.count))  # the same ones for all
        measured = pooled_quality(tables, 0, 0)
        assert measured is not None
        return measured.psnr

    try:
        return find_quality(goal, trial, settings.quality), rounds
    except OutOfReachError as error:
        if goal.kind != PSNR or error.got > goal.value:
            raise
        part, reached = find_limit(encode_sequence(job, top.at(error.factor)), original)
        why = f"; what holds it back most: {part}, without whose error it would be {reached:.4g} dB"
        raise OutOfReachError(goal, error.got, error.factor, why) from None


def kilobytes_a_frame(top: Manifest, settings: EncodeSettings) -> float:
    """All that a viewer of the top rung fetches, manifests included, if `top` were a package of these settings."""
    return (top.bytes_of(top.rung_files(0, 0)) + _manifest_bytes(top, settings)) / top.frames / 1e3


def _manifest_bytes(m: Manifest, settings: EncodeSettings) -> int:
    """Length of all tables and the MPD if all levels and key qualities were there, each like the only one in `m`."""
    levels, qualities = len(settings.levels), len(settings.key_factors)
    groups = Groups.of([_widen(group, settings) for group in m.groups])
    many = replace(m, qualities=m.qualities * qualities, levels=m.levels * levels, groups=groups)
    return len(pack_json(root_of(many))) + len(write_mpd(many)) + many.bytes_of(many.table_files())


def _widen(group: Group, settings: EncodeSettings) -> Group:
    levels, qualities = len(settings.levels), len(settings.key_factors)
    tiles = [
        replace(
            tile,
            tiers=[
                replace(t, qualities=t.qualities * qualities, pictures=_others(t.pictures * qualities))
                for t in tile.tiers
            ],
            levels=tile.levels * levels,
        )
        for tile in group.tiles
    ]
    segments = [replace(s, levels=_measured(s.levels[0], settings)) for s in group.segments]
    return replace(group, tiles=tiles, segments=segments)


def _others(files: list[FileEntry]) -> list[FileEntry]:
    """The same with digests that differ, as those of other files do."""
    return [FileEntry(f.bytes, digest(f"{i} {f.sha256}".encode()) if f.bytes else "") for i, f in enumerate(files)]


def _measured(level: SegmentLevel, settings: EncodeSettings) -> list[SegmentLevel]:
    """All levels, with figures of the usual length where the package will have them."""
    count = len(settings.key_factors) if settings.measure_pictures else 0
    decibels = [44.44] * count
    like = replace(level, psnr=decibels, worst=decibels, ssim=[0.9999] * count, delta_e=[0.44] * count)
    files = [_others([file] * len(settings.levels)) for file in level.files]  # tile x level
    return [replace(like, files=list(of_level)) for of_level in zip(*files, strict=True)]
