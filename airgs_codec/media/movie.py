"""Films and sound by FFmpeg: videos of cameras, films that people watch, and sound as packets of Opus.

H x W pixels, C channels of 48,000 samples a second. Packets last 20 ms. Packet k decodes to the samples from
PACKET_TICKS * k - pre_skip on: Opus lags behind (RFC 7845).
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import CodecError, SceneError
from airgs_codec.media.mp4 import PACKET_TICKS, SOUND_RATE, sound_init
from airgs_codec.places.whole import atomic_path, expect_plain

Bytes = NDArray[np.uint8]
X264_OPTIONS = {"crf": "18", "preset": "medium"}  # nearly without visible loss
MOST_OFF = 0.25  # frames that a picture may be off an even rate before a remark says so
LAYOUTS = {1: "mono", 2: "stereo"}  # by channels
BITS_S = {1: 64_000, 2: 96_000}  # of the encoder of sound, by channels
MOST_S = 21_600  # of a sound, most of which would be silence
TOLERANCE_S = Fraction(1, 25)  # time stamps of sound are this rough; a larger gap is silence


def write_movie(path: Path, frames: Iterable[Bytes], fps: Fraction, sound: NDArray[np.int16] | None = None) -> None:
    """Write (H, W, 3) RGB frames as an H.264 film, whole or not at all, without an odd last row or column.

    `sound`: (n, C) samples, added as AAC. Raises CodecError when there is no frame or it cannot be written.
    """
    try:
        with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
            stream = voice = None
            heard = 0
            for number, picture in enumerate(frames, 1):
                if stream is None:
                    stream = container.add_stream("libx264", rate=fps, options=X264_OPTIONS)
                    stream.height, stream.width = (side - side % 2 for side in picture.shape[:2])
                    stream.pix_fmt = "yuv420p"
                    if sound is not None:
                        voice = container.add_stream("aac", rate=SOUND_RATE, layout=LAYOUTS[sound.shape[1]])
                even = np.ascontiguousarray(picture[: stream.height, : stream.width])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(even, "rgb24")))
                if voice and sound is not None and len(part := sound[heard : round(number / fps * SOUND_RATE)]):
                    container.mux(voice.encode(_audio_frame(part, heard)))
                    heard += len(part)
            if stream is None:
                raise CodecError(f"{path}: expected at least one frame")
            container.mux(stream.encode(None))
            if voice:
                container.mux(voice.encode(None))
    except (av.FFmpegError, OSError) as error:
        raise CodecError(f"{path}: cannot write the film: {error}") from error


def _audio_frame(samples: NDArray[np.int16], at: int) -> av.AudioFrame:
    channels = samples.shape[1]
    frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(samples).reshape(1, -1), "s16", LAYOUTS[channels])
    frame.sample_rate, frame.pts = SOUND_RATE, at
    return frame


@dataclass(frozen=True, slots=True)
class Clock:
    """When the pictures of a video are shown, in frames of an even rate."""

    fps: Fraction | None  # None: unknown
    start_s: Fraction  # when frame 0 is shown
    pictures: Mapping[int, int]  # frame -> the number of its picture; a frame that was dropped has none
    remarks: tuple[str, ...] = ()  # for people, each in a few words

    @staticmethod
    def of(stamps: Sequence[int], unit: Fraction, rates: Sequence[Fraction | None]) -> Clock:
        """Return the clock of pictures at ascending times, in units of `unit` seconds.

        Each picture is of the frame that is nearest, and a frame has the nearest picture. The first of the `rates` that
        fits the times is taken; where none does, it is measured.
        """
        times = np.array(stamps, np.float64) - stamps[0]
        gaps = np.diff(times)
        if not len(gaps):
            return Clock(rates[0], stamps[0] * unit, {0: 0})
        count = len(gaps)
        if gaps.max() >= 2 * gaps.min() - 3:  # units, to each of which times are rounded: frames may be dropped
            gaps_of_one = gaps[np.rint(gaps / np.sort(gaps)[(count - 1) // 2]) == 1]
            count = int(np.rint(gaps / gaps_of_one.mean()).sum())
        at = times * (count / times[-1])
        off = np.abs(at - np.rint(at))
        pictures = {int(frame): number for number, frame in sorted(enumerate(np.rint(at)), key=lambda p: -off[p[0]])}
        span_s = (stamps[-1] - stamps[0]) * unit
        fitting = (rate for rate in rates if rate and abs(count / rate - span_s) <= unit)
        fps = next(fitting, (count / span_s).limit_denominator(1001))
        left = len(stamps) - len(pictures)
        varies = f"rate varies, pictures are up to {off.max():.1f} frames off and {left} too many"
        return Clock(fps, stamps[0] * unit, pictures, (varies,) if left or off.max() > MOST_OFF else ())


class VideoReader:
    """Pictures of any video that FFmpeg reads, by number, upright, as RGB; fast when read forward, or the last again.

    Their numbers count those that can be decoded, in the order in which they are shown.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reading = threading.Lock()
        self._last: NDArray[np.uint8] | None = None  # the picture before `_next`, where it was asked for
        self._stamps: list[int] = []  # when each picture is shown, in units of the stream; none: it is not known
        self._open()
        context = self._container.streams.video[0].codec_context
        self._stored = (context.width, context.height)

    def check(self, size: tuple[int, int]) -> None:
        """Raise SceneError unless upright pictures have a size (width, height); no other one is decoded."""
        found = self.size if set(size) == set(self._stored) else self._stored
        if found != size:
            raise SceneError(f"{self._path}: expected pictures of {size[0]}x{size[1]}, got {found[0]}x{found[1]}")

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height of upright pictures. Raises what `read` does."""
        height, width = self.read(0).shape[:2]
        return width, height

    @cached_property
    def clock(self) -> Clock:
        """When all pictures are shown. Raises SceneError for a broken video, or two pictures at one time."""
        first, found = None, list[int | None]()
        try:
            with av.open(str(self._path.absolute())) as container:
                stream = container.streams.video[0]
                for packet in container.demux(stream):
                    if packet.is_corrupt:
                        raise SceneError(f"{self._path}: expected a whole video, picture {len(found)} is cut off")
                    first = first or next(iter(packet.decode()), None)
                    if packet.size and not packet.is_discard:
                        found.append(packet.pts)
                rates, unit = (stream.average_rate, stream.base_rate, stream.guessed_rate), stream.time_base
        except av.FFmpegError as error:
            raise SceneError(f"{self._path}: cannot read picture {len(found)}: {error}") from error
        if first is None:
            raise SceneError(f"{self._path}: expected a video, no picture of it can be decoded")
        remarks = ("turned upright",) if (_turn(first) != np.eye(2)).any() else ()
        stamps = [stamp for stamp in found if stamp is not None]
        if unit is None or first.pts is None or len(stamps) < len(found):
            counted = {number: number for number in range(len(found))}
            return Clock(rates[0], Fraction(0), counted, (*remarks, "no times, pictures are counted"))
        # Decoders leave out pictures before the first that they can decode, as where a video was cut.
        self._stamps = sorted(stamp for stamp in stamps if stamp >= first.pts)
        if len(set(self._stamps)) < len(self._stamps):
            raise SceneError(f"{self._path}: expected pictures at times of their own, got several at one")
        clock = Clock.of(self._stamps, unit, rates)
        return replace(clock, remarks=(*remarks, *clock.remarks))

    def read(self, number: int) -> NDArray[np.uint8]:
        """Return (H, W, 3) picture `number`; threads wait for each other.

        Raises SceneError when the video ends before it, cannot be decoded, or has a picture of another size.
        """
        with self._reading:
            if number == self._next - 1 and self._last is not None:
                return self._last
            if number < self._next:
                self.close()
                self._open()
            try:
                while self._next <= number:
                    frame = next(self._decoded)
                    if (found := (frame.width, frame.height)) != self._stored:
                        expected, got = (f"{width}x{height}" for width, height in (self._stored, found))
                        raise SceneError(f"{self._path}: expected frames of {expected}, got {got} at {self._next}")
                    self._next += 1
            except StopIteration:
                raise SceneError(f"{self._path}: expected frame {number}, the video ends after {self._next}") from None
            except av.FFmpegError as error:
                raise SceneError(f"{self._path}: cannot decode frame {self._next}: {error}") from error
            if self._stamps and frame.pts != self._stamps[number]:
                raise SceneError(f"{self._path}: expected frame {number}, it or one before cannot be decoded")
            self._last = self._upright(frame)
            return self._last

    def close(self) -> None:
        self._container.close()

    def _open(self) -> None:
        try:
            if not self._path.is_file():
                raise SceneError(f"{self._path}: expected a video, got no file")
            self._container = av.open(str(self._path.absolute()))  # "concat:a|b" would be a protocol of FFmpeg's
            if not self._container.streams.video:
                raise SceneError(f"{self._path}: expected a video, got a file without a picture stream")
            self._decoded = self._container.decode(video=0)
        except (av.FFmpegError, OSError) as error:
            raise SceneError(f"{self._path}: expected a video: {error}") from error
        self._next = 0
        self._last = None

    def _upright(self, frame: av.VideoFrame) -> NDArray[np.uint8]:
        """Return (H, W, 3) a picture as players show it. Raises SceneError where that is not turned by right angles."""
        picture, turn = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8), _turn(frame)
        if not turn.diagonal().any():
            picture, turn = picture.transpose(1, 0, 2), turn[::-1]
        if (abs(turn) != np.eye(2)).any():
            raise SceneError(f"{self._path}: expected pictures turned by right angles, got {frame.rotation} degrees")
        return np.ascontiguousarray(picture[:: turn[1, 1], :: turn[0, 0]])


def _turn(frame: av.VideoFrame) -> NDArray[np.intp]:
    """Return (2, 2) the signs of x and y where players show a step to the right of a picture, and one down."""
    data: Any = frame.side_data.get("DISPLAYMATRIX")
    matrix = np.eye(3) if data is None else np.frombuffer(bytes(data), np.int32).reshape(3, 3)
    return np.sign(matrix[:2, :2]).astype(np.intp)


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
    """Encode the first sound of a file for a sequence of `seconds`, cut or followed by silence.

    Raises SceneError for a file without sound and a sequence longer than MOST_S, CodecError when the encoder fails.
    """
    if seconds > MOST_S:
        raise SceneError(f"{path}: expected at most {MOST_S} s of pictures with sound, got {float(seconds):.0f}")
    count = math.ceil(seconds * SOUND_RATE / PACKET_TICKS)
    samples, end = _read_sound(path, count * PACKET_TICKS)
    channels, note, packets = samples.shape[1], "", list[bytes]()
    if end - len(samples) > TOLERANCE_S * SOUND_RATE:
        note = f"cut after {float(seconds):.2f} s, where the pictures end"
    elif end < (seconds - TOLERANCE_S) * SOUND_RATE:
        note = f"silent after {end / SOUND_RATE:.2f} of {float(seconds):.2f} s"
    encoder = _opus("w", channels)
    encoder.bit_rate, encoder.format = BITS_S[channels], "s16"
    try:
        for at in range(0, len(samples), SOUND_RATE):
            packets += map(bytes, encoder.encode(_audio_frame(samples[at : at + SOUND_RATE], at)))
        packets += map(bytes, encoder.encode(None))
    except av.FFmpegError as error:
        raise CodecError(f"{path}: cannot encode the sound: {error}") from error
    pre_skip = int.from_bytes((encoder.extradata or b"")[10:12], "little")  # of OpusHead
    return SoundTrack(tuple(packets[:count]), channels, pre_skip, note)


def decode_sound(packets: Iterable[bytes], channels: int) -> NDArray[np.int16]:
    """Decode (n, C) samples, PACKET_TICKS a packet; mid-track the first WARM_UP are wrong. Raises CodecError."""
    decoder = _opus("r", channels)
    parts = [np.zeros((0, channels), np.int16)]
    try:
        for packet in packets:
            parts += [_samples(frame, channels) for frame in decoder.decode(av.Packet(packet))]
    except av.FFmpegError as error:
        raise CodecError(f"a packet of sound cannot be decoded: {error}") from error
    return np.concatenate(parts)


def _samples(frame: av.AudioFrame, channels: int) -> NDArray[np.int16]:
    return np.asarray(frame.to_ndarray(), np.int16).reshape(-1, channels)


def _opus(mode: Literal["r", "w"], channels: int) -> av.AudioCodecContext:
    coder = av.CodecContext.create("libopus", mode)
    assert isinstance(coder, av.AudioCodecContext)
    coder.sample_rate, coder.layout = SOUND_RATE, LAYOUTS[channels]
    return coder


def _read_sound(path: Path, count: int) -> tuple[NDArray[np.int16], int]:
    """Return (count, C) samples of a file, with silence where it has none, and where its own end.

    What comes more than TOLERANCE_S later is not read. Raises SceneError.
    """
    try:
        expect_plain(path)
        container = av.open(str(path), "r")
    except (av.FFmpegError, OSError) as error:
        raise SceneError(f"{path}: expected a file with sound: {error}") from error
    with container:
        if not container.streams.audio:
            raise SceneError(f"{path}: expected a file with sound, got one without")
        stream = container.streams.audio[0]
        channels = min(2, stream.codec_context.layout.nb_channels)
        if not channels:
            raise SceneError(f"{path}: expected a file with sound, got a track of no channels")
        samples, end = np.zeros((count, channels), np.int16), 0
        try:
            for at, part in _placed(container, stream, channels):
                end = max(end, at + len(part))
                part = part[max(0, -at) :][: max(0, count - max(0, at))]
                samples[max(0, at) :][: len(part)] = part
                if end - count > TOLERANCE_S * SOUND_RATE:
                    break
        except av.FFmpegError as error:
            raise SceneError(f"{path}: cannot decode the sound: {error}") from error
    return samples, end


def _placed(
    container: av.container.InputContainer, stream: av.AudioStream, channels: int
) -> Iterator[tuple[int, NDArray[np.int16]]]:
    """Yield samples with their places in the file, counted from where all of its streams begin."""
    resampler = av.AudioResampler("s16", LAYOUTS[channels], SOUND_RATE)
    begins = Fraction(container.start_time or 0, av.time_base)
    at: int | None = None
    for frame in itertools.chain(container.decode(stream), [None]):
        if frame and frame.pts is not None and frame.time_base:
            stamp = round((frame.pts * frame.time_base - begins) * SOUND_RATE)
            if stamp - (at or 0) > TOLERANCE_S * SOUND_RATE or (at is None and stamp < 0):
                at = stamp
        for part in resampler.resample(frame):
            samples = _samples(part, channels)
            yield at or 0, samples
            at = (at or 0) + len(samples)
