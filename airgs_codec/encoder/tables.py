"""What was coded -> files of the package and their tables. T frames, N rows of a group, L levels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.coding.sidecar import KeySidecar, pack_key_sidecar
from airgs_codec.encoder.plan import GroupPlan
from airgs_codec.media.h264 import Stream
from airgs_codec.package import tables
from airgs_codec.package.staging import write_file
from airgs_codec.package.tables import STATIC, FileEntry, Group, GroupTier, Picture, Segment


@dataclass(frozen=True, slots=True, eq=False)
class Coded:
    """A representation, if it has anything to show, and its picture size."""

    stream: Stream | None
    size: tuple[int, int]
    differences: list[NDArray[np.uint8]]  # (H, W) largest luma error over each closed GOP, see `h264.check_stream`

    def picture(self) -> Picture:
        """Its entry in the tables."""
        return Picture(*self.size, self.stream.codecs) if self.stream else Picture(0, 0, "")


def escapes_path(scratch: Path, group: int, level: int, segment: int) -> Path:
    """Where the escapes of a segment wait until its number is known."""
    return scratch / f"escapes-{group}-{level}-{segment}.bin"


def write_streams(folder: Path, keys: list[list[Coded]], states: list[Coded]) -> dict[str, FileEntry]:
    """Init and media segments of every representation."""
    files = {}
    for t, row in enumerate(keys):
        for q, coded in enumerate(row):
            if coded.stream:
                path = tables.key_init_path(t, q)
                files[path] = write_file(folder, path, coded.stream.init)
                for n, media in enumerate(coded.stream.media, 1):
                    path = tables.key_media_path(t, q, n)
                    files[path] = write_file(folder, path, media)
    for j, coded in enumerate(states):
        if coded.stream:
            path = tables.state_init_path(j)
            files[path] = write_file(folder, path, coded.stream.init)
            for n, media in enumerate(coded.stream.media, 1):
                path = tables.state_media_path(j, n)
                files[path] = write_file(folder, path, media)
    return files


def write_sidecars(
    folder: Path,
    plans: list[GroupPlan],
    spans: list[list[tuple[int, int]]],
    fetched: list[list[list[bool]]],
    scratch: Path,
    levels: int,
) -> dict[str, FileEntry]:
    """Sidecars of every key unit and state segment."""
    files = {}
    numbers = [0] * levels
    for g, plan in enumerate(plans):
        for tier, number in enumerate(plan.numbers):
            if number:
                rows = plan.tier_rows(tier)
                sidecar = KeySidecar(plan.codes[rows], plan.classes[rows], plan.depths[rows])
                path = tables.key_sidecar_path(tier, number)
                files[path] = write_file(folder, path, pack_key_sidecar(sidecar, plan.grid))
                for q, bases in enumerate(plan.key_bases[tier]):
                    path = tables.key_escapes_path(tier, q, number)
                    files[path] = write_file(folder, path, encode_columns(escapes.columns(bases[None])))
        for s in range(len(spans[g])):
            for level in range(levels):
                if fetched[g][s][level]:
                    numbers[level] += 1
                    path = tables.state_sidecar_path(level, numbers[level])
                    files[path] = write_file(folder, path, escapes_path(scratch, g, level, s).read_bytes())
    return files


def group_tables(plans: list[GroupPlan]) -> list[Group]:
    """The groups as airgs.json lists them."""
    return [
        Group(
            start=plan.start,
            stop=plan.stop,
            canonical=plan.canonical,
            count=len(plan.rows),
            static=int((plan.depths == STATIC).sum()),
            unused=plan.count - len(plan.rows),
            grid=plan.grid,
            key_steps=plan.key_steps,
            state_steps=plan.state_steps,
            colour_transform=plan.transform,
            tiers=[
                GroupTier(atlases[0].rows, number, atlases)
                for atlases, number in zip(plan.key_atlases, plan.numbers, strict=True)
            ],
            levels=plan.levels,
        )
        for plan in plans
    ]


def segment_tables(
    spans: list[list[tuple[int, int]]], fetched: list[list[list[bool]]], states: list[Coded]
) -> list[Segment]:
    """The segments as airgs.json lists them, without measured quality."""
    segments = []
    numbers = [0] * len(states)
    for g, group_spans in enumerate(spans):
        for s, (start, stop) in enumerate(group_spans):
            levels = []
            for j, coded in enumerate(states):
                wanted = fetched[g][s][j]
                numbers[j] += wanted
                sizes = coded.stream.picture_bytes[numbers[j] - 1] if wanted and coded.stream else []
                levels.append(tables.SegmentLevel(numbers[j] if wanted else 0, sizes, [], [], []))
            segments.append(Segment(g, start, stop, levels))
    return segments
