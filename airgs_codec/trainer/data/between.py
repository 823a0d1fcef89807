"""Cameras that were not in step, brought into step: their pictures are those of other frames.

What is left of a frame is told with a picture: a fit moves its Gaussians to when that was taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.files import expecting, read_object
from airgs_codec.trainer.data.multiview import MultiviewScene, Shot, frames_of
from airgs_codec.trainer.data.plates import stands_still

WHOLE = 1e-3  # frames: an offset that is as near to a whole number is one


def in_step(
    scene: MultiviewScene, offsets: Mapping[str, float], span: tuple[int, int | None] = (0, None)
) -> MultiviewScene:
    """The frames [A, B) of a scene, in whose frame t each camera shows what it took nearest to t + its offset.

    An offset is in frames, positive where a camera is late, and 0 unless named. Frames that not all cameras have are
    left out, and as many behind them taken in, where they are there. Points are those of the first frame of the scene.

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
    """What a camera took nearest to a time in frames; of two that are as near, the earlier one."""
    nearest = math.ceil(time - 0.5 - WHOLE)
    after = round(nearest - time, 6)
    shot = scene.frames[nearest][index]
    return replace(shot, after=after) if abs(after) > WHOLE else shot


def read_offsets(path: Path) -> dict[str, float]:
    """The offsets in a JSON file, an object of cameras' names and frames. Raises SceneError."""
    table = read_object(path)
    with expecting(path, "an object of cameras and by how many frames each is late"):
        for name, offset in table.items():
            if isinstance(offset, bool) or not isinstance(offset, (int, float)) or not math.isfinite(offset):
                raise ValueError(f"got {offset!r} for {name}")
    return {name: float(offset) for name, offset in table.items()}
