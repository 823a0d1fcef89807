"""The state channels of a group in a file, which is read by channels, by rows or by frames as each step needs them.

T frames and N rows of a group, C colour channels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import Canonical, frame_channels, hold_undrawn
from airgs_codec.coding.chunks import row_chunks
from airgs_codec.package.layout import STATE
from airgs_codec.package.tables import StateSteps
from airgs_codec.scene.gaussians import Gaussians

_BYTES = np.dtype(np.float64).itemsize


@dataclass(frozen=True, slots=True, eq=False)
class StateValues:
    """`coding.channels.state_channels` of all frames of a group: one plane of T x N float64 after the other."""

    path: Path
    frames: int  # T
    channels: int  # 10 + C
    rows: int  # N

    @staticmethod
    def write(
        path: Path, frames: Sequence[Gaussians], rows: NDArray[np.intp], base: Canonical, steps: StateSteps
    ) -> StateValues:
        """Differences of some `rows` (N,) of frames, which are looked at one by one, to a decoded canonical space."""
        values = StateValues(path, len(frames), STATE.width(base.colours.shape[1]), len(rows))
        drawn = np.empty((values.frames, values.rows), bool)
        with path.open("wb") as file:
            for t, frame in enumerate(frames):
                found = np.empty((values.channels, values.rows))
                for part in row_chunks(values.rows, values.channels):
                    found[:, part], drawn[t, part] = frame_channels(frame.take(rows[part]), base.part(part), steps)
                for channel, plane in enumerate(found):
                    file.seek(values._offset(channel, t))
                    file.write(plane.data)
        values._hold(drawn)
        return values

    def _hold(self, drawn: NDArray[np.bool_]) -> None:
        """Hold the last drawn value of every channel but opacity; `drawn` is (T, N)."""
        rows = np.flatnonzero(~drawn.all(axis=0))
        if not len(rows):
            return
        opacity = STATE.slice("opacity")
        with self.path.open("r+b") as file:
            for channel in np.delete(np.arange(self.channels), opacity).tolist():
                plane = self.channel(channel, slice(None))
                held = plane[:, rows]
                hold_undrawn(held[:, None], drawn[:, rows])
                plane[:, rows] = held
                file.seek(self._offset(channel, 0))
                file.write(plane.data)

    def chunks(self) -> Iterator[slice]:
        """Rows that may be in memory together in all frames."""
        return row_chunks(self.rows, self.frames * self.channels)

    def channel(self, channel: int, rows: NDArray[np.intp] | slice) -> NDArray[np.float64]:
        """(T, n) values of some rows in one channel."""
        places = np.arange(self.rows)[rows]
        if not len(places):
            return np.empty((self.frames, 0))
        first, stop = int(places.min()), int(places.max()) + 1
        plane = np.empty(stop - first)
        out = np.empty((self.frames, len(places)))
        with self.path.open("rb") as file:
            for t in range(self.frames):
                file.seek(self._offset(channel, t) + _BYTES * first)
                file.readinto(plane.data)
                out[t] = plane[places - first]
        return out

    def part(self, rows: slice, frames: slice = slice(None)) -> NDArray[np.float64]:
        """(t, 10 + C, n) values of some rows in some frames."""
        start, stop, _ = rows.indices(self.rows)
        times = range(self.frames)[frames]
        out = np.empty((len(times), self.channels, stop - start))
        with self.path.open("rb") as file:
            for place, t in enumerate(times):
                for channel in range(self.channels):
                    file.seek(self._offset(channel, t) + _BYTES * start)
                    file.readinto(out[place, channel].data)
        return out

    def frame(self, t: int) -> NDArray[np.float64]:
        """(10 + C, N) values of one frame."""
        return self.part(slice(0, self.rows), slice(t, t + 1))[0]

    def _offset(self, channel: int, t: int) -> int:
        return _BYTES * self.rows * (channel * self.frames + t)
