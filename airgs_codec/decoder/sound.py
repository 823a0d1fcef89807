"""The sound of a package: packets of Opus by groups, decoded to samples. C channels, 48,000 samples a second."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import CodecError, FormatError
from airgs_codec.media.movie import decode_sound
from airgs_codec.media.mp4 import PACKET_TICKS, SOUND_RATE, WARM_UP, read_samples, read_start
from airgs_codec.package.package import Package


def decode_all(package: Package, groups: range | None = None) -> NDArray[np.int16] | None:
    """Return samples (n, C) of some groups, or of all, from their first frame on; None without sound.

    A group whose sound cannot be read is silent.
    """
    m = package.manifest
    if m.sound is None:
        return None
    parts, before = list[NDArray[np.int16]](), tuple[bytes, ...]()  # packets of the group before
    numbers = groups or range(len(m.groups))
    places = [m.groups.places.entry(number) for number in numbers]
    for number, place in zip(numbers, places, strict=True):
        try:
            parts.append(decode_group(package, number, before[-WARM_UP:]))
            before = _read_packets(package, number)
        except FormatError:
            silent, before = len(m.packets(place.start, place.stop)) * PACKET_TICKS, ()
            parts.append(np.zeros((silent, m.sound.channels), np.int16))
    start, stop = (round(frame / m.fps * SOUND_RATE) for frame in (places[0].start, places[-1].stop))
    early = start - m.packets(places[0].start, places[0].stop).start * PACKET_TICKS + m.sound.pre_skip
    samples = np.concatenate(parts)
    samples = samples[early:] if early >= 0 else np.pad(samples, ((-early, 0), (0, 0)))
    return np.pad(samples, ((0, max(0, stop - start - len(samples))), (0, 0)))[: stop - start]


def decode_group(package: Package, number: int, before: tuple[bytes, ...] = ()) -> NDArray[np.int16]:
    """Return samples (n, C) of all packets of a group, counted from 0; none without sound.

    `before`: the packets that come before them. Raises FormatError: bad_sound, and what `Package.read` raises.
    """
    m = package.manifest
    packets, channels = [*before, *_read_packets(package, number)], m.sound.channels if m.sound else 1
    try:
        samples, wanted = decode_sound(packets, channels), PACKET_TICKS * len(packets)
        if len(samples) != wanted:
            raise CodecError(f"expected {wanted} samples, got {len(samples)}")
    except CodecError as error:
        raise FormatError("bad_sound", m.sound_files(number)[0], str(error)) from error
    return samples[PACKET_TICKS * len(before) :]


def _read_packets(package: Package, number: int) -> tuple[bytes, ...]:
    m = package.manifest
    span = m.packets(m.groups[number].start, m.groups[number].stop)
    for path in m.sound_files(number):
        data = package.read(path)
        try:
            packets, start = read_samples(data), read_start(data)
            if (got := (start, len(packets))) != (expected := (span.start * PACKET_TICKS, len(span))):
                raise CodecError(f"expected the start and number of packets {expected}, got {got}")
            return packets
        except CodecError as error:
            raise FormatError("bad_sound", path, str(error)) from error
    return ()
