"""Is what only DASH players and pages read, and the sound, as the writer makes it? Checked without decoding video."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from airgs_codec.errors import CodecError, FormatError
from airgs_codec.media.image import decode_jpeg
from airgs_codec.media.mp4 import check_boxes, init_segment, read_samples, sound_init, sound_segment
from airgs_codec.package.layout import INIT_NAME, POSTER_NAME, SOUND_INIT_NAME
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package
from airgs_codec.package.tables import MAX_POSTER_SIDE, Group


def largest_picture(groups: Sequence[Group]) -> tuple[int, int]:
    """Give the width and height that no picture of the groups exceeds."""
    atlases = [a for g in groups for row in (*(tier.qualities for tier in g.tiers), g.levels) for a in row]
    return max(atlas.width for atlas in atlases), max(atlas.height for atlas in atlases)


def check_shared(package: Package, path: str) -> None:
    """Raise FormatError unless a file that is no group's, the poster or what tracks begin with, is what it should be.

    Reasons: bad_picture, bad_sound, and what `Package.read` raises.
    """
    m, data = package.manifest, package.read(path)
    if path == POSTER_NAME:
        try:
            decode_jpeg(data, MAX_POSTER_SIDE)
        except ValueError as error:
            raise FormatError("bad_picture", path, f"expected a JPEG: {error}") from error
        return
    wanted = [sound_init(m.sound.channels, m.sound.pre_skip)] if m.sound and path == SOUND_INIT_NAME else _inits(m)
    try:
        if data not in wanted:
            check_boxes(wanted[-1], data)
    except CodecError as error:
        raise FormatError("bad_picture" if path == INIT_NAME else "bad_sound", path, str(error)) from error


def _inits(m: Manifest) -> list[bytes]:
    """What init.mp4 may be: it is made for the largest picture of the groups that were there when it was written."""
    sizes = accumulate((largest_picture([g]) for g in m.groups), lambda a, b: (max(a[0], b[0]), max(a[1], b[1])))
    return [init_segment(m.timescale, *size) for size in dict.fromkeys(sizes)]


def check_sound(package: Package, group: int) -> None:
    """Raise FormatError(bad_sound) unless the sound of a group is the boxes and times of its packets."""
    m = package.manifest
    span = m.packets(m.groups[group].start, m.groups[group].stop)
    for path in m.sound_files(group):
        data = package.read(path)
        try:
            check_boxes(sound_segment(read_samples(data), span.start), data)
        except CodecError as error:
            raise FormatError("bad_sound", path, str(error)) from error
