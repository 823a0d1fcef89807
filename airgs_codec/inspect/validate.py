"""Is a package whole and does it decode? Errors are returned, not raised."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.coding.channels import Canonical
from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.decoder.sound import decode_group
from airgs_codec.errors import AirgsError, FormatError
from airgs_codec.inspect.errors import Measured
from airgs_codec.media.h264 import BRIGHTEST, DARKEST, check_segment, in_range, open_segment
from airgs_codec.package.layout import JSON_NAME, MPD_NAME, POSTER_NAME, belongs, group_path
from airgs_codec.package.mpd import check_mpd, check_shared, check_sound, still_files
from airgs_codec.package.package import Package, find_file, open_files, read_file
from airgs_codec.package.parse import MAX_TABLE_BYTES
from airgs_codec.package.tables import Atlas, file_entry
from airgs_codec.places.place import Storage, place_at
from airgs_codec.places.whole import finished_path
from airgs_codec.scene.gaussians import Gaussians


def validate(path: str | Path) -> list[FormatError]:
    """Return everything that is wrong with the package at a path or an address: an empty list for a good one.

    Checks the tables, the MPD against them, every file's length and digest, that there is no other file, and that every
    keyframe tier and every segment of every level decodes to the promised pictures and to finite numbers. Never raises
    for a bad package; TransportError where a store does not answer.
    """
    return validate_files(place_at(path))


def validate_files(files: Storage) -> list[FormatError]:
    try:
        package = open_files(files)
    except FormatError as error:
        return [error]
    errors = list(_check_tables(package))
    if errors:  # without all tables nothing can be said of what they list
        return errors
    errors = [*_check_files(package), *_check_measures(package)]
    errors += _attempt(MPD_NAME, partial(_check_mpd, package))
    if not errors:  # broken files would only repeat themselves
        errors = list(_check_decoding(package))
        for path in package.manifest.shared_files():
            errors += _attempt(path, partial(check_shared, package, path))
    return errors


def exceeded(measured: Iterable[Measured]) -> list[FormatError]:
    """Return every `max_error` that a comparison with the original (`errors.measure_errors`) found too small."""
    words = "{0.attribute}: max_error {0.bound:g}, measured {0.error:g}".format
    return [FormatError("bound_exceeded", m.where, words(m)) for m in measured if m.error > m.bound]


def _attempt(where: str, work: Callable[[], object]) -> list[FormatError]:
    try:
        work()
    except FormatError as error:
        return [error]
    except (AirgsError, OverflowError) as error:  # a group without keyframes; a number that fits no array
        return [FormatError("bad_value", where, str(error))]
    return []


def _check_mpd(package: Package) -> None:
    size, read = find_file(package.files, MPD_NAME)
    if size > MAX_TABLE_BYTES:
        raise FormatError("too_large", MPD_NAME, f"expected at most {MAX_TABLE_BYTES} bytes")
    check_mpd(read(), package.manifest)


def _check_tables(package: Package) -> Iterator[FormatError]:
    """Check that every page and group table can be read, and that the group its keyframes are differences to fits."""
    m = package.manifest
    for number in m.groups.places.sweep():
        if isinstance(number, FormatError):
            yield number
        else:
            yield from _attempt(group_path(number + 1), partial(m.base_of, number))


def _check_files(package: Package) -> Iterator[FormatError]:
    listed = set(package.manifest.files())
    for relative in sorted(listed):
        yield from _attempt(relative, partial(package.read, relative))
    stills: dict[str, bytes] = {}
    yield from _attempt(MPD_NAME, lambda: stills.update(still_files(package.manifest)))
    for relative, data in stills.items():
        yield from _attempt(relative, partial(read_file, package.files, relative, file_entry(data)))
    for relative in package.files.paths():
        if relative not in listed | stills.keys() | {JSON_NAME, MPD_NAME}:
            yield from _attempt(relative, partial(_check_unlisted, package, relative))


def _check_unlisted(package: Package, relative: str) -> None:
    """Raise FormatError for a file that is not listed and for a link, but not for what a killed run may leave."""
    finished = finished_path(relative)
    left = finished == POSTER_NAME or (finished != relative and belongs(finished))
    if package.files.open(relative) is None or not left:
        raise FormatError("foreign_file", relative, "not listed in the tables")


def _check_measures(package: Package) -> Iterator[FormatError]:
    """Check that the H.264 bytes of the frames of a segment are no more than the file that holds them."""
    for s, segment in enumerate(package.manifest.segments):
        for j, level in enumerate(segment.levels):
            if (total := sum(level.frame_bytes)) > level.file.bytes:
                detail = f"frame_bytes add up to {total}, the file has {level.file.bytes}"
                yield FormatError("size_mismatch", f"segment {s} L{j}", detail)


def _check_decoding(package: Package) -> Iterator[FormatError]:
    m = package.manifest
    for g in range(len(m.groups)):
        sound = partial(decode_group, package, g), partial(check_sound, package, g)
        yield from _attempt(f"group {g}", sound[0]) or _attempt(f"group {g}", sound[1])
        for q in range(len(m.qualities)):
            yield from _attempt(f"group {g}", partial(_decode_keyframe, package, g, q))
        try:
            with np.errstate(all="ignore"):
                base = decode_canonical(package, g, 0)
        except (AirgsError, OverflowError):
            continue  # found above
        for s in m.segments_of(g):
            for j in range(len(m.levels)):
                yield from _attempt(f"segment {s}", partial(_decode_delta, package, s, j, base))


def _decode_keyframe(package: Package, group: int, quality: int) -> None:
    with np.errstate(all="ignore"):  # _expect_finite says it better
        base = decode_canonical(package, group, quality)
        _expect_finite(base.to_gaussians(), f"group {group} Q{quality}")
    m, entry = package.manifest, package.manifest.groups[group]
    start, lasts = (frame * m.frame_ticks for frame in (entry.start, entry.stop - entry.start))
    for t, tier in enumerate(entry.tiers):
        for media in m.keyframe_files(group, t, quality)[1:]:
            _expect_pictures(package, media, tier.qualities[quality], 1, False)
            check_segment(package.read(media), media, start, lasts, tier.qualities[quality].pages, False)


def _decode_delta(package: Package, index: int, level: int, base: Canonical) -> None:
    m = package.manifest
    segment = m.segments[index]
    length, linear = segment.stop - segment.start, bool(segment.levels[level].slopes)
    for media in m.delta_files(index, level):
        with np.errstate(all="ignore"):
            for frame in decode_segment(package, index, base, level, range(length)):
                _expect_finite(frame, media)
        atlas = m.groups[m.group_of(index)].levels[level]
        _expect_pictures(package, media, atlas, length, linear)
        check_segment(package.read(media), media, segment.start * m.frame_ticks, m.frame_ticks, atlas.pages, linear)


def _expect_pictures(package: Package, media: str, atlas: Atlas, count: int, linear: bool) -> None:
    """Raise FormatError unless all luma is in range and as many pictures come; one more with linear motion."""
    _, pictures = open_segment(package.read(media), media, atlas.pages)
    inside = [in_range(picture) for picture in (itertools.chain(*pictures.cut()) if linear else pictures)]
    if len(inside) != count + linear:
        raise FormatError("bad_picture", media, f"expected {count + linear} pictures, got {len(inside)}")
    if not all(inside):
        where = f"picture {inside.index(False)}"
        raise FormatError("bad_picture", media, f"expected luma of {DARKEST} to {BRIGHTEST}, {where} has other samples")


def _expect_finite(frame: Gaussians, where: str) -> None:
    for field in fields(frame):
        if not np.isfinite(getattr(frame, field.name)).all():
            raise FormatError("bad_value", where, f"{field.name} decode to numbers that are not finite")
