"""A camera with its picture, to which every form is read; what all readers share, and what all of them refuse."""

from __future__ import annotations

import json
import mmap
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import Lens, fit_lens
from airgs_codec.scene.camera import Camera

MOST_PIXELS = 32_768  # along a side of a picture
ROTATION_TOLERANCE = 1e-2  # for what files round; axes of another length or not at right angles are something else


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """A camera as a file describes it, and the picture that it belongs to.

    Raises ValueError for a camera that is none: of no size, without focal length, at no place.
    """

    camera: Camera  # of the undistorted picture
    picture: str = ""  # path of the picture as the file has it; empty: it names none
    lens: Lens | None = None  # None: the picture is that of a pinhole camera already
    time: float = 0.0  # of the picture, in any unit: equal within a frame, ascending
    mask: str | None = None  # path of the picture's mask as the file has it
    fixed: bool = False  # the camera has one name at all times: its first pose counts

    def __post_init__(self) -> None:
        _check(self.camera)


class Cursor:
    """A place in bytes, which are read piece by piece, little-endian.

    Every method raises ValueError where the bytes end before what is asked for.
    """

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self.data = data
        self.at = 0

    @classmethod
    def open(cls, path: Path) -> Cursor:
        """At the start of a file, which is mapped, not read. Raises OSError."""
        if path.stat().st_size == 0:  # cannot be mapped
            return cls(b"")
        with path.open("rb") as file:
            return cls(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))

    def skip(self, count: int) -> int:
        """Pass over `count` bytes; gives the place before them."""
        start, self.at = self.at, self.at + count
        if self.at > len(self.data):
            raise ValueError(f"it ends after {len(self.data)} bytes")
        return start

    def take(self, form: str) -> tuple[Any, ...]:
        """Values in the form that `struct` knows."""
        return struct.unpack_from(f"<{form}", self.data, self.skip(struct.calcsize(f"<{form}")))

    def piece(self, count: int) -> bytes:
        """The next `count` bytes."""
        start = self.skip(count)
        return self.data[start : self.at]

    def text(self) -> str:
        """UTF-8 up to a zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise ValueError("a name has no end")
        return self.piece(end + 1 - self.at)[:-1].decode()


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
    _check(camera)
    if not np.isfinite(coefficients).all():
        raise ValueError(f"camera {camera.name} has a lens that is not finite")
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    lens = fit_lens((camera.width, camera.height), matrix, coefficients, fisheye)
    (fx, _, cx), (_, fy, cy), _ = lens.pinhole
    return replace(camera, fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy)), lens


def inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """World-to-camera of (4, 4) camera-to-world. Raises ValueError where there is none."""
    return np.linalg.inv(matrix).astype(np.float64)


@contextmanager
def expecting(path: Path, what: str) -> Iterator[None]:
    """Turns what goes wrong while `path` is read as `what` into a SceneError of one line."""
    try:
        with np.errstate(all="ignore"):  # what is not finite in the end is refused
            yield
    except SceneError:
        raise
    except OSError as error:
        raise SceneError(f"{path}: expected {what}: {error.strerror}") from error
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, struct.error) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise SceneError(f"{path}: expected {what}: {reason}") from error


def read_json(path: Path) -> Any:
    """Return what a JSON file holds. Raises SceneError when it is not JSON or cannot be read."""
    with expecting(path, "JSON"):
        return json.loads(path.read_text(encoding="utf-8-sig"))


def read_object(path: Path) -> dict[str, Any]:
    """The object in a JSON file. Raises SceneError when there is none."""
    data = read_json(path)
    if not isinstance(data, dict):
        raise SceneError(f"{path}: expected a JSON object, got {type(data).__name__}")
    return data


def _check(c: Camera) -> None:
    numbers = np.array([c.fx, c.fy, c.cx, c.cy, *c.world_to_camera.ravel()])
    if not np.isfinite(numbers).all():
        raise ValueError(f"camera {c.name} has numbers that are not finite")
    if not (1 <= c.width <= MOST_PIXELS and 1 <= c.height <= MOST_PIXELS):
        raise ValueError(f"camera {c.name} has size {c.width}x{c.height}, not of 1 to {MOST_PIXELS} pixels")
    if c.fx <= 0 or c.fy <= 0:
        raise ValueError(f"camera {c.name} has focal lengths {c.fx:g} and {c.fy:g}, not above 0")
    if not 0 < c.near < np.inf:
        raise ValueError(f"camera {c.name} has near {c.near}")
    axes = c.world_to_camera[:3, :3]
    if np.abs(axes @ axes.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(axes) < 0:
        raise ValueError(f"camera {c.name} has a matrix that is not a rotation and a translation")


def _sight(c: Camera) -> tuple[object, ...]:
    return c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera.tobytes()
