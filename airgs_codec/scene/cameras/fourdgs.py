""".4dgs, version 1 (avala-ai/4dgs): records of an opcode, a 64-bit length and so many bytes, little-endian.

Sensor Calibration records (0x21) are the cameras that the scene was filmed with; without any, the Camera record (0x0A)
has a viewpoint and points of a path to look from. The specification calls these records provisional, and leaves two
things open: a sensor's axes are taken to be OpenCV's, as its lens models and its principal point from the top left
corner are, and a viewpoint's up is the Coordinate Frame record's (0x20), or -y without one, as in scenes that COLMAP
was the first to see.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from airgs_codec._sampling import evenly_spaced
from airgs_codec.scene.camera import Camera, look_at
from airgs_codec.scene.cameras.posed import Posed, expect_any, inverse, undistorted
from airgs_codec.scene.files import Cursor, expecting

MAGIC = b"\x894DGS"
VERSION = b"1\r\n"
FOOTER, CAMERA, FRAME, SENSOR, RIG = 0x02, 0x0A, 0x20, 0x21, 0x22
NO_CAMERA, FISHEYE = 0, 3  # camera models; 1 and 2 are perspective
LENSES = {1: (0,), 2: (5, 8), FISHEYE: (4,)}  # how many coefficients a camera model may have, in OpenCV's order
MOST_PLACES = 16  # of a rig that moves
VIEW_SIZE = 512  # pixels of both axes: a viewpoint comes without
UP = np.array([0.0, -1.0, 0.0])

Pose = NDArray[np.float64]  # (4, 4) from a camera or a rig to the scene


def read(path: Path) -> list[Posed]:
    """One for each sensor and place of its rig, or one for each viewpoint. Raises SceneError."""
    with expecting(path, "a .4dgs file"):
        records = list(_records(Cursor.open(path)))
        rigs = dict(_rig(content) for opcode, content in records if opcode == RIG)
        sensors = [posed for opcode, content in records if opcode == SENSOR for posed in _sensor(content, rigs)]
        up = next((_up(content) for opcode, content in records if opcode == FRAME), UP)
        posed = sensors or [posed for opcode, content in records if opcode == CAMERA for posed in _views(content, up)]
    return expect_any(posed, path, "sensors or a viewpoint in a .4dgs file")


def _records(cursor: Cursor) -> Iterator[tuple[int, Cursor]]:
    """The records that say something of cameras; others, of unknown kinds too, are passed over."""
    cursor.skip(len(MAGIC))
    if (version := cursor.piece(len(VERSION))) != VERSION:
        raise ValueError(f"expected version 1, got {version!r}")
    opcode = 0
    while opcode != FOOTER:
        opcode, length = cursor.take("BQ")
        if opcode in (CAMERA, FRAME, SENSOR, RIG):
            yield opcode, Cursor(cursor.piece(length))
        else:
            cursor.skip(length)


def _string(cursor: Cursor) -> str:
    return cursor.piece(cursor.take("I")[0]).decode()


def _pose(values: tuple[float, ...]) -> Pose:
    """Of a quaternion (x, y, z, w) and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(values[:4]).as_matrix()
    matrix[:3, 3] = values[4:]
    return matrix


def _up(cursor: Cursor) -> NDArray[np.float64]:
    """Unit vector that points up in the scene."""
    _string(cursor)
    _, axis = cursor.take("BB")
    up = np.zeros(3)
    up[axis % 3] = 1 if axis < 3 else -1
    return up


def _rig(cursor: Cursor) -> tuple[str, list[Pose]]:
    """The name of a rig and some of its places, evenly spaced over its path."""
    name = _string(cursor)
    _, count = cursor.take("BI")
    start = cursor.skip(64 * count)
    poses = []
    for number in evenly_spaced(count, MOST_PLACES):
        cursor.at = start + 64 * number
        poses.append(_pose(cursor.take("8d")[1:]))
    return name, poses


def _sensor(cursor: Cursor, rigs: dict[str, list[Pose]]) -> Iterator[Posed]:
    name, _ = _string(cursor), _string(cursor)
    model, width, height, fx, fy, cx, cy = cursor.take("BII4d")
    coefficients = np.array(cursor.take(f"{cursor.take('B')[0]}d"))
    pose = _pose(cursor.take("7d"))
    (in_rig,), rig = cursor.take("B"), _string(cursor)
    if model == NO_CAMERA:
        return
    if len(coefficients) not in LENSES.get(model, ()):
        raise ValueError(f"sensor {name} has camera model {model} with {len(coefficients)} coefficients")
    places = [place @ pose for place in rigs[rig]] if in_rig else [pose]
    taken = Camera(name, width, height, fx, fy, cx, cy, np.eye(4))
    camera, lens = undistorted(taken, coefficients, fisheye=model == FISHEYE)
    yield from (Posed(replace(camera, world_to_camera=inverse(place)), lens=lens) for place in places)


def _views(cursor: Cursor, up: NDArray[np.float64]) -> Iterator[Posed]:
    """The default viewpoint, then those along its path."""
    fov_y, *first = cursor.take("7d")
    if not 0 < fov_y < 180:
        raise ValueError(f"expected a field of view of 0 to 180 degrees, got {fov_y:g}")
    path = [cursor.take("7d")[1:] for _ in range(*cursor.take("I"))]
    for number, view in enumerate([tuple(first), *path]):
        place, target = np.array(view[:3]), np.array(view[3:])
        if not np.linalg.norm(target - place) > 0:
            raise ValueError("a viewpoint looks at itself")
        name = f"view{number:03d}"
        yield Posed(look_at(place, target, up, size=VIEW_SIZE, fov_y=np.radians(fov_y), name=name))
