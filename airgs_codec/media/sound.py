"""Sound: any file that FFmpeg reads to packets of Opus, and packets to samples. C channels, 48,000 samples a second.

Packets last 20 ms. Packet k decodes to the samples from PACKET_TICKS * k - pre_skip on: Opus lags behind (RFC 7845).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

import av
import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import CodecError, SceneError
from airgs_codec.media.mp4 import PACKET_TICKS, SOUND_RATE, sound_init
from airgs_codec.places.whole import expect_plain

LAYOUTS = {1: "mono", 2: "stereo"}  # by channels
BITS_S = {1: 64_000, 2: 96_000}  # of the encoder, by channels
MOST_S = 21_600  # of a sound, most of which would be silence
TOLERANCE_S = Fraction(1, 25)  # time stamps of files are this rough; a larger gap is silence


@dataclass(frozen=True, slots=True)
class SoundTrack:
    """Packets of Opus as long as a sequence."""

    packets: tuple[bytes, ...]
    channels: int
    pre_skip: int  # samples
    note: str  # on its length, for people; empty where it fits

    @property
    def init(self) -> bytes:
        return sound_init(self.channels, self.pre_skip)


def encode_sound(path: Path, seconds: Fraction) -> SoundTrack:
    """The first sound of a file, as long as a sequence of so many seconds: cut at its end, or silent from its own on.

    Raises SceneError for a file without sound, one that cannot be read, and a sequence longer than MOST_S, CodecError
    when the encoder fails.
    """
    if seconds > MOST_S:
        raise SceneError(f"{path}: expected at most {MOST_S} s of pictures beside sound, got {float(seconds):.0f}")
    count = math.ceil(seconds * SOUND_RATE / PACKET_TICKS)
    try:
        return _encode(_Source(path), count, seconds)
    except av.FFmpegError as error:
        raise CodecError(f"{path}: cannot encode the sound: {error}") from error


def _encode(source: _Source, count: int, seconds: Fraction) -> SoundTrack:
    encoder = _opus("w", source.channels)
    encoder.bit_rate, encoder.format = BITS_S[source.channels], "s16"
    packets: list[bytes] = []
    given = 0
    for samples in source.parts(count * PACKET_TICKS):
        frame = av.AudioFrame.from_ndarray(samples.reshape(1, -1), "s16", LAYOUTS[source.channels])
        frame.sample_rate, frame.pts = SOUND_RATE, given
        given += len(samples)
        packets += [bytes(packet) for packet in encoder.encode(frame)]
    packets += [bytes(packet) for packet in encoder.encode(None)]
    note = ""
    if source.longer:
        note = f"cut after {float(seconds):.2f} s, where the pictures end"
    elif source.heard < (seconds - TOLERANCE_S) * SOUND_RATE:
        note = f"silent after {source.heard / SOUND_RATE:.2f} of {float(seconds):.2f} s"
    pre_skip = int.from_bytes((encoder.extradata or b"")[10:12], "little")  # of OpusHead
    return SoundTrack(tuple(packets[:count]), source.channels, pre_skip, note)


def decode_sound(packets: Iterable[bytes], channels: int) -> NDArray[np.int16]:
    """(n, C) samples of packets, PACKET_TICKS of each; the first WARM_UP are not right where others came before.

    Raises CodecError.
    """
    decoder = _opus("r", channels)
    parts = [np.zeros((0, channels), np.int16)]
    try:
        for packet in packets:
            parts += [_samples(frame, channels) for frame in decoder.decode(av.Packet(packet))]
    except av.FFmpegError as error:
        raise CodecError(f"a packet of sound cannot be decoded: {error}") from error
    return np.concatenate(parts)


def _samples(frame: av.AudioFrame, channels: int) -> NDArray[np.int16]:
    """(n, C) samples of a frame of 16 bits."""
    return np.asarray(frame.to_ndarray(), np.int16).reshape(-1, channels)


def _opus(mode: Literal["r", "w"], channels: int) -> av.AudioCodecContext:
    coder = av.CodecContext.create("libopus", mode)
    assert isinstance(coder, av.AudioCodecContext)
    coder.sample_rate, coder.layout = SOUND_RATE, LAYOUTS[channels]
    return coder


class _Source:
    """The samples of a file, in order, from its beginning on."""

    def __init__(self, path: Path) -> None:
        """Raises SceneError."""
        self._path = path
        self.heard = 0  # samples until the last one of the file that was given
        self.longer = False  # whether it has others
        try:
            expect_plain(path)
            self._container = av.open(str(path), "r")
        except (av.FFmpegError, OSError) as error:
            raise SceneError(f"{path}: expected a file with sound: {error}") from error
        if not self._container.streams.audio:
            self._container.close()
            raise SceneError(f"{path}: expected a file with sound, got one without")
        self._stream = self._container.streams.audio[0]
        self.channels = min(2, self._stream.codec_context.layout.nb_channels)
        if not self.channels:
            self._container.close()
            raise SceneError(f"{path}: expected a file with sound, got a track of no channels")

    def parts(self, count: int) -> Iterator[NDArray[np.int16]]:
        """(n, C) parts that have `count` samples together; silence where the file has none.

        Raises SceneError where it cannot be decoded.
        """
        given = rest = 0
        for at, samples in self._placed():
            if at - given > TOLERANCE_S * SOUND_RATE:
                yield from self._silence(min(at, count) - given)
                given = min(at, count)
            elif not given:
                samples = samples[max(0, -at) :]
            rest += max(0, len(samples) - (count - given))
            samples = samples[: count - given]
            self.heard = given = given + len(samples)
            if len(samples):
                yield samples
            self.longer = rest > TOLERANCE_S * SOUND_RATE
            if self.longer:
                return
        yield from self._silence(count - given)

    def _silence(self, count: int) -> Iterator[NDArray[np.int16]]:
        """So many samples, a second at a time."""
        for start in range(0, count, SOUND_RATE):
            yield np.zeros((min(SOUND_RATE, count - start), self.channels), np.int16)

    def _placed(self) -> Iterator[tuple[int, NDArray[np.int16]]]:
        """Samples with their places in the file, counted from where all of its streams begin."""
        resampler = av.AudioResampler("s16", LAYOUTS[self.channels], SOUND_RATE)
        begins = Fraction(self._container.start_time or 0, av.time_base)
        at: int | None = None
        try:
            for frame in itertools.chain(self._container.decode(self._stream), [None]):
                if frame and frame.pts is not None and frame.time_base:
                    stamp = round((frame.pts * frame.time_base - begins) * SOUND_RATE)
                    at = stamp if at is None or stamp - at > TOLERANCE_S * SOUND_RATE else at
                for part in resampler.resample(frame):
                    samples = _samples(part, self.channels)
                    yield at or 0, samples
                    at = (at or 0) + len(samples)
        except av.FFmpegError as error:
            raise SceneError(f"{self._path}: cannot decode the sound: {error}") from error
