"""Ordinary films: camera videos that are read, and films that are written for people to watch. H x W pixels."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.container import OutputContainer
from numpy.typing import NDArray

from airgs_codec.errors import CodecError, SceneError
from airgs_codec.media.mp4 import SOUND_RATE
from airgs_codec.media.sound import LAYOUTS
from airgs_codec.places.whole import atomic_path

X264_OPTIONS = {"crf": "18", "preset": "medium"}  # nearly without visible loss


def write_movie(
    path: Path, frames: Iterable[NDArray[np.uint8]], fps: Fraction, sound: NDArray[np.int16] | None = None
) -> None:
    """Write (H, W, 3) RGB frames as an H.264 film; an odd last row or column is cut off, as 4:2:0 asks.

    `sound`: (n, C) samples, 48,000 a second, which go with them as AAC. The film is whole or not there. Raises
    CodecError when there is no frame or it cannot be written.
    """
    try:
        with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
            stream = voice = None
            for number, picture in enumerate(frames, 1):
                if stream is None:
                    stream = container.add_stream("libx264", rate=fps, options=X264_OPTIONS)
                    stream.height, stream.width = (side - side % 2 for side in picture.shape[:2])
                    stream.pix_fmt = "yuv420p"
                    voice = None if sound is None else _Voice(container, sound)
                even = np.ascontiguousarray(picture[: stream.height, : stream.width])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(even, "rgb24")))
                if voice:
                    voice.go_on(round(number / fps * SOUND_RATE))
            if stream is None:
                raise CodecError(f"{path}: expected at least one frame")
            container.mux(stream.encode(None))
            if voice:
                voice.end()
    except (av.FFmpegError, OSError) as error:
        raise CodecError(f"{path}: cannot write the film: {error}") from error


class _Voice:
    """The sound of a film on its way, beside the pictures of its time."""

    def __init__(self, container: OutputContainer, samples: NDArray[np.int16]) -> None:
        self._container, self._samples, self._given = container, samples, 0
        self._stream = container.add_stream("aac", rate=SOUND_RATE, layout=LAYOUTS[samples.shape[1]])

    def go_on(self, stop: int) -> None:
        part = np.ascontiguousarray(self._samples[self._given : stop])
        if not len(part):
            return
        frame = av.AudioFrame.from_ndarray(part.reshape(1, -1), "s16", LAYOUTS[part.shape[1]])
        frame.sample_rate, frame.pts = SOUND_RATE, self._given
        self._given += len(part)
        self._container.mux(self._stream.encode(frame))

    def end(self) -> None:
        self._container.mux(self._stream.encode(None))


class VideoReader:
    """Frames of any video that FFmpeg reads, by number, as RGB; fast when read forward, or the last one again."""

    def __init__(self, path: Path) -> None:
        """Opens the first video stream. Raises SceneError, also where more frames are promised than there are bytes."""
        self._path = path
        self._reading = threading.Lock()
        self._last: NDArray[np.uint8] | None = None  # the frame before `_next`, where it was asked for
        self._open()
        stream = self._container.streams.video[0]
        self.size = (stream.codec_context.width, stream.codec_context.height)
        self.fps = stream.average_rate
        self.frames = stream.frames or self._count()
        if self.frames > (size := path.stat().st_size):
            raise SceneError(f"{path}: expected as many frames as {size} bytes can hold, got {self.frames}")

    def read(self, number: int) -> NDArray[np.uint8]:
        """(H, W, 3) frame `number`; threads wait for each other.

        Raises SceneError when the video ends before it, cannot be decoded, or has a frame of another size.
        """
        with self._reading:
            return self._read(number)

    def _read(self, number: int) -> NDArray[np.uint8]:
        if number == self._next - 1 and self._last is not None:
            return self._last
        if number < self._next:
            self._container.close()
            self._open()
        try:
            while True:
                frame = next(self._decoded)
                if (frame.width, frame.height) != self.size:
                    expected, got = (f"{width}x{height}" for width, height in (self.size, (frame.width, frame.height)))
                    raise SceneError(f"{self._path}: expected frames of {expected}, got {got} at {self._next}")
                self._next += 1
                if self._next > number:
                    self._last = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
                    return self._last
        except StopIteration:
            raise SceneError(f"{self._path}: expected frame {number}, the video ends after {self._next}") from None
        except av.FFmpegError as error:
            raise SceneError(f"{self._path}: cannot decode frame {self._next}: {error}") from error

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

    def _count(self) -> int:
        """Frames of a container that does not say."""
        count = sum(1 for packet in self._container.demux(video=0) if packet.size)
        self._container.close()
        self._open()
        return count
