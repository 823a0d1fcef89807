"""Cameras that were not in step, brought into step: their pictures are those of other times.

A whole number of frames picks another picture. Anything else is a picture between two, which optical flow makes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import between
from airgs_codec.scene.files import expecting, read_object
from airgs_codec.trainer.data.multiview import MultiviewScene, Readable, Shot, frames_of
from airgs_codec.trainer.data.plates import stands_still

WHOLE = 1e-3  # frames: an offset that is as near to a whole number is one


@dataclass(frozen=True, slots=True)
class Between:
    """A picture of a time between two that were taken, in place of a `Source`."""

    first: Readable
    second: Readable
    share: float  # of the time from the first to the second, above 0 and below 1

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of both."""
        return (*self.first.files, *self.second.files)

    @property
    def content(self) -> str:
        """What else names both, and the share."""
        return f"{self.first.content} {self.second.content} {self.share}"

    def read(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """(H, W, 3) or (H, W, 4), as both are. Raises SceneError, also where one of them alone has alpha."""
        first, second = self.first.read(size), self.second.read(size)
        if first.shape != second.shape:
            raise SceneError(f"{self.second}: expected alpha as in {self.first}, or none in both")
        return between(first, second, self.share)

    def check(self, size: tuple[int, int]) -> None:
        """Check both, as `Source` does. Raises SceneError."""
        self.first.check(size)
        self.second.check(size)

    def __str__(self) -> str:
        """Name the place in a message."""
        return f"{self.first} + {self.share:g}"


def in_step(
    scene: MultiviewScene, offsets: Mapping[str, float], span: tuple[int, int | None] = (0, None)
) -> MultiviewScene:
    """The frames [A, B) of a scene, in whose frame t each camera shows what it took at t + its offset, in frames.

    An offset is positive where a camera is late, and 0 unless named. Frames that not all cameras have are left out, and
    as many behind them taken in, where they are there. A mask between two frames is that of the nearer one. Points are
    those of the first frame of the scene.

    Raises SceneError for frames that are not there, a name that no camera has, cameras that move, and offsets that
    leave no frame.
    """
    first, end = frames_of(scene, span)
    late = {name: offset for name, offset in offsets.items() if offset}
    if not late:
        return replace(scene, frames=scene.frames[first:end], points=None if first else scene.points)
    names = [camera.name for camera in scene.cameras]
    if unknown := sorted(set(late) - set(names)):
        raise SceneError(f"{scene.path}: no camera {', '.join(unknown)}; there are {', '.join(names)}")
    if not stands_still(scene):
        raise SceneError(f"{scene.path}: expected cameras that stand still, where they are not in step")
    of = [late.get(name, 0.0) for name in names]
    start = max(first, math.ceil(-min(of) - WHOLE))
    stop = min(start + end - first, math.floor(len(scene) - 1 - max(of) + WHOLE) + 1)
    if start >= stop:
        raise SceneError(f"{scene.path}: expected offsets that leave a frame of {end - first} to all cameras")
    frames = tuple(
        tuple(_shot_at(scene, index, frame + offset) for index, offset in enumerate(of)) for frame in range(start, stop)
    )
    return replace(scene, frames=frames, offsets=late, points=None if first else scene.points)


def _shot_at(scene: MultiviewScene, index: int, time: float) -> Shot:
    """What a camera shows at a time in frames."""
    if abs(time - round(time)) <= WHOLE:
        return scene.frames[round(time)][index]
    frame, share = math.floor(time), round(time - math.floor(time), 6)
    first, second = scene.frames[frame][index], scene.frames[frame + 1][index]
    return replace(first if share < 0.5 else second, source=Between(first.source, second.source, share))


def read_offsets(path: Path) -> dict[str, float]:
    """The offsets in a JSON file, an object of cameras' names and frames. Raises SceneError."""
    table = read_object(path)
    with expecting(path, "an object of cameras and by how many frames each is late"):
        for name, offset in table.items():
            if isinstance(offset, bool) or not isinstance(offset, (int, float)) or not math.isfinite(offset):
                raise ValueError(f"got {offset!r} for {name}")
    return {name: float(offset) for name, offset in table.items()}
