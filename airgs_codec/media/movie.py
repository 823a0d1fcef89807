"""Ordinary films: camera videos that are read, and films that are written for people to watch. H x W pixels."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import CodecError, SceneError

X264_OPTIONS = {"crf": "18", "preset": "medium"}  # nearly without visible loss


def write_movie(path: Path, frames: Iterable[NDArray[np.uint8]], fps: Fraction) -> None:
    """Write (H, W, 3) RGB frames as an H.264 film; an odd last row or column is cut off, as 4:2:0 asks.

    Raises CodecError when there is no frame or the film cannot be written.
    """
    try:
        with av.open(str(path), "w") as container:
            stream = None
            for picture in frames:
                if stream is None:
                    stream = container.add_stream("libx264", rate=fps, options=X264_OPTIONS)
                    stream.height, stream.width = (side - side % 2 for side in picture.shape[:2])
                    stream.pix_fmt = "yuv420p"
                even = np.ascontiguousarray(picture[: stream.height, : stream.width])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(even, "rgb24")))
            if stream is None:
                raise CodecError(f"{path}: expected at least one frame")
            container.mux(stream.encode(None))
    except (av.FFmpegError, OSError) as error:
        raise CodecError(f"{path}: cannot write the film: {error}") from error


class VideoReader:
    """Frames of any video that FFmpeg reads, by number, as RGB; fast when read forward, or the last one again."""

    def __init__(self, path: Path) -> None:
        """Opens the first video stream. Raises SceneError."""
        self._path = path
        self._reading = threading.Lock()
        self._last: NDArray[np.uint8] | None = None  # the frame before `_next`, where it was asked for
        self._open()
        stream = self._container.streams.video[0]
        self.size = (stream.codec_context.width, stream.codec_context.height)
        self.fps = stream.average_rate
        self.frames = stream.frames or self._count()

    def read(self, number: int) -> NDArray[np.uint8]:
        """(H, W, 3) frame `number`; threads wait for each other.

        Raises SceneError when the video ends before it or cannot be decoded.
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
                self._next += 1
                if self._next > number:
                    self._last = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
                    return self._last
        except StopIteration:
            raise SceneError(f"{self._path}: expected frame {number}, the video ends after {self._next}") from None
        except av.FFmpegError as error:
            raise SceneError(f"{self._path}: cannot decode frame {self._next}: {error}") from error

    def close(self) -> None:
        """Free the decoder."""
        self._container.close()

    def _open(self) -> None:
        try:
            self._container = av.open(str(self._path))
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
