"""Camera paths: what a camera does over time, as keyframes in JSON; web/src/play/keyframes.ts is the same.

`{"loop": false, "keyframes": [{"t": 0, "position": [x, y, z], "focus": [x, y, z], "up": [x, y, z], "fov_y": 40}, …]}`:
seconds from the start, world units, degrees; `loop`, `up` and `fov_y` may be left out. nerfstudio's camera_path.json is
read as well: OpenGL matrices, one for each picture. K keyframes; T times; the ten values of a view are position, focus,
up and fov_y.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from airgs_codec.scene.camera import UP
from airgs_codec.scene.files import expecting, read_object

VALUES = 10
MOST_DEGREES = 170.0  # of a field of view
LEAST_SLANT = 1e-6  # sine of the angle between a view and what is up in it
WORDS = "a camera path: keyframes with t, position and focus, or nerfstudio's camera_path.json"

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CameraPath:
    """A line through keyframes: at each the camera goes the way from the one before to the one after it (Catmull and
    Rom 1974); at both ends it goes straight on, or, where the last is the first again, round.
    """

    times: Floats  # (K,) ascending from 0, seconds
    values: Floats  # (K, 10)
    loop: bool

    @property
    def duration(self) -> float:
        """Seconds from the first keyframe to the last."""
        return float(self.times[-1])

    def at(self, times: Floats) -> Floats:
        """(T, 10) the views at some seconds; after its end a loop begins again, and any other path stays there."""
        if self.duration == 0:
            return np.repeat(self.values[:1], len(times), axis=0)
        within = times % self.duration if self.loop else np.clip(times, 0, self.duration)
        return np.asarray(CubicHermiteSpline(self.times, self.values, self._speeds())(within))

    def _speeds(self) -> Floats:
        """(K, 10) of the values at the keyframes, a second."""
        times, values = self.times, self.values
        if self.loop and np.array_equal(values[0], values[-1]):
            times = np.array([times[-2] - times[-1], *times, times[-1] + times[1]])
            values = np.concatenate([values[-2:-1], values, values[1:2]])
            return (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None]
        steps, seconds = np.diff(values, axis=0), np.diff(times)
        inner = (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None]
        return np.concatenate([steps[:1] / seconds[0], inner, steps[-1:] / seconds[-1]])


def read_camera_path(path: Path, up: Floats = UP, fov_y: float = 50.0) -> CameraPath:
    """The camera path in a file; `up` (3,) and `fov_y`, degrees, are those of keyframes without. Raises SceneError."""
    data = read_object(path)
    with expecting(path, WORDS):
        if "camera_path" in data:
            return _nerfstudio(data)
        rows = [_row(number, frame, up, fov_y) for number, frame in enumerate(data["keyframes"])]
        return _path(rows, data.get("loop", False))


def _row(number: int, frame: dict[str, Any], up: Floats, fov_y: float) -> list[float]:
    where = f"keyframe {number}"
    unknown = frame.keys() - {"t", "position", "focus", "up", "fov_y", "name"}
    if unknown:
        raise ValueError(f"{where} has {', '.join(sorted(unknown))}, which means nothing")
    vectors = [frame["position"], frame["focus"], frame.get("up", list(up))]
    if any(len(vector) != 3 for vector in vectors):
        raise ValueError(f"{where} has a vector that is not three numbers")
    return _checked(where, [frame["t"], *vectors[0], *vectors[1], *vectors[2], frame.get("fov_y", fov_y)])


def _nerfstudio(data: dict[str, Any]) -> CameraPath:
    """One entry a picture: 16 numbers of a camera-to-world matrix row by row, and degrees from bottom to top."""
    rows = []
    for number, entry in enumerate(data["camera_path"]):
        matrix = np.array(entry["camera_to_world"], np.float64).reshape(4, 4)
        position = matrix[:3, 3]
        row = [number / data["fps"], *position, *(position - matrix[:3, 2]), *matrix[:3, 1], entry["fov"]]
        rows.append(_checked(f"picture {number}", row))
    return _path(rows, data.get("is_cycle", False))


def _checked(where: str, row: list[Any]) -> list[float]:
    """Numbers that make a camera, with `up` of length 1."""
    if any(isinstance(x, bool) or not isinstance(x, int | float) or not np.isfinite(x) for x in row):
        raise ValueError(f"{where} has what is no finite number")
    numbers = np.array(row, np.float64)
    position, focus, up, fov_y = numbers[1:4], numbers[4:7], numbers[7:10], float(numbers[10])
    away, high = float(np.linalg.norm(focus - position)), float(np.linalg.norm(up))
    if away == 0 or high == 0 or np.linalg.norm(np.cross((focus - position) / away, up / high)) <= LEAST_SLANT:
        raise ValueError(f"{where} looks nowhere, or along what is up")
    if not 0 < fov_y <= MOST_DEGREES:
        raise ValueError(f"{where} has a fov_y of {fov_y:g}, expected more than 0 and at most {MOST_DEGREES:g} degrees")
    return [float(numbers[0]), *position.tolist(), *focus.tolist(), *(up / high).tolist(), fov_y]


def _path(rows: list[list[float]], loop: Any) -> CameraPath:
    if not rows:
        raise ValueError("there is no keyframe")
    if not isinstance(loop, bool):
        raise ValueError(f"loop is true or false, got {loop!r}")
    table = np.array(rows)
    times, values = table[:, 0], table[:, 1:]
    if times[0] != 0 or (np.diff(times) <= 0).any():
        raise ValueError("the times of keyframes begin at 0 and ascend")
    return CameraPath(times, values, loop)
