"""A camera with its picture, to which every form is read; what all readers share, and what all of them refuse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import Lens, fit_lens
from airgs_codec.scene.camera import Camera, check_camera

MOST_LETTERS = 255  # of a name in any file system


def as_path(text: object) -> str:
    """A path as a file has it, with the separators of every system as "/"."""
    return str(text).replace("\\", "/")


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """A camera as a file describes it, and the picture that it belongs to.

    Raises ValueError for a camera that is none, of no size, without focal length, at no place, and for a path that can
    be none of a file.
    """

    camera: Camera  # of the undistorted picture
    picture: str = ""  # path of the picture as the file has it; empty: it names none
    lens: Lens | None = None  # None: the picture is that of a pinhole camera already
    time: float = 0.0  # of the picture, in any unit: equal within a frame, ascending
    mask: str | None = None  # path of the picture's mask as the file has it
    fixed: bool = False  # the camera has one name at all times: its first pose counts

    def __post_init__(self) -> None:
        check_camera(self.camera)
        for path in filter(None, (self.picture, self.mask)):
            parts = Path(path).parts
            if not (Path(path).name and path.isprintable() and max(map(len, parts)) <= MOST_LETTERS):
                raise ValueError(f"{path!r} is no name of a picture")


def expect_any(posed: list[Posed], path: Path, what: str) -> list[Posed]:
    """Return what was read, at least one. Raises SceneError."""
    if not posed:
        raise SceneError(f"{path}: expected {what}, got none")
    return posed


def distinct(posed: Iterable[Posed]) -> list[Camera]:
    """The cameras, in the order in which they first appear: fixed ones once a name, others once a sight."""
    found: dict[object, Camera] = {}
    for p in posed:
        found.setdefault(p.camera.name if p.fixed else _sight(p.camera), p.camera)
    return list(found.values())


def undistorted(camera: Camera, coefficients: NDArray[np.float64], fisheye: bool = False) -> tuple[Camera, Lens | None]:
    """The camera of undistorted pictures, and the lens that they are undistorted for; None for a pinhole camera.

    `camera` has the intrinsics of pictures as they were taken, `coefficients` are OpenCV's of the model. Raises
    ValueError for a camera that is none.
    """
    if not fisheye and not coefficients.any():
        return camera, None
    check_camera(camera)
    if not np.isfinite(coefficients).all():
        raise ValueError(f"camera {camera.name} has a lens that is not finite")
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    try:
        lens = fit_lens((camera.width, camera.height), matrix, coefficients, fisheye)
    except ValueError as error:
        numbers = ", ".join(f"{number:g}" for number in (camera.fx, camera.fy, camera.cx, camera.cy, *coefficients))
        raise ValueError(
            f"camera {camera.name}: {error}, got {'a fisheye' if fisheye else 'one'} of {numbers}"
        ) from error
    (fx, _, cx), (_, fy, cy), _ = lens.pinhole
    return replace(camera, fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy)), lens


def told_of_lenses(posed: Iterable[Posed]) -> tuple[str, ...]:
    """What people should know of the lenses of cameras: a line, or none."""
    cut = {p.camera.name: p.camera for p in posed if p.lens and p.lens.cut}
    angles = [np.degrees(2 * np.arctan(max(c.width / 2 / c.fx, c.height / 2 / c.fy))) for c in cut.values()]
    if not cut:
        return ()
    left = f"the middle {min(angles):.0f} degrees of what they see are used, the rest is cut off"
    return (f"{len(cut)} cameras, such as {next(iter(cut))}, have wide or strongly bending lenses: {left}",)


def inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """World-to-camera of (4, 4) camera-to-world. Raises ValueError where there is none."""
    return np.linalg.inv(matrix).astype(np.float64)


def _sight(c: Camera) -> tuple[object, ...]:
    return c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera.tobytes()
