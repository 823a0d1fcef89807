"""nerfstudio's transforms.json: OpenGL camera-to-world matrices, one entry for each picture; sizes in pixels.

What all entries share may stand beside `frames`, but for the matrix. Pictures, masks and points may lie anywhere, as
nerfstudio has it: an absolute path is taken as it is, and another may leave the folder. Beside nerfstudio's fields an
entry may have `camera`, a name that is the same at all times, `time_index` or `time`, `near` in world units, and
`split`, "test" for a held-out camera; nerfstudio's own lists `test_filenames` and `val_filenames` mark held-out
pictures, too.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from airgs_codec.media.image import Lens
from airgs_codec.scene.camera import NEAR, OPENGL_TO_OPENCV, Camera
from airgs_codec.scene.cameras.posed import Posed, expect_any, inverse, undistorted
from airgs_codec.scene.files import expecting, read_object

NAME = "transforms.json"
_Entry = ChainMap[str, Any]  # of a picture, over what all share
FISHEYE = "OPENCV_FISHEYE"
NO_LENS = (
    "EQUIRECTANGULAR",
    "OMNIDIRECTIONAL",
    "VR180",
    "ORTHO",
    "FISHEYE624",
)  # beginnings of models that no pinhole stands for


def fits(data: Any) -> bool:
    """Return whether JSON data is a transforms.json."""
    return isinstance(data, dict) and "frames" in data


def read(path: Path) -> list[Posed]:
    """One for each entry, in the order of the file. Raises SceneError."""
    data = read_object(path)
    with expecting(path, f"a nerfstudio {NAME}"):
        entries = [ChainMap(entry, data) for entry in data["frames"]]
        names = _names(entries)
        held_out = {*data.get("test_filenames", ()), *data.get("val_filenames", ())}
        posed = [_posed(name, entry, held_out) for name, entry in zip(names, entries, strict=True)]
    return expect_any(posed, path, "at least one picture under 'frames'")


def _names(entries: Sequence[_Entry]) -> list[str]:
    """A name for each entry: its `camera`, else its picture's, or its picture's folder where there are pictures over
    time in several folders."""
    paths = [PurePosixPath(str(entry.get("file_path", ""))) for entry in entries]
    moving = len({_time(entry) for entry in entries}) > 1 and len({path.parent for path in paths}) > 1
    given = [path.parent.name if moving else path.stem for path in paths]
    return [str(entry.get("camera", given[i] or f"view{i:03d}")) for i, entry in enumerate(entries)]


def _posed(name: str, entry: _Entry, held_out: set[str]) -> Posed:
    picture = str(entry.get("file_path", ""))
    camera, lens = _without_lens(_camera(name, entry, "test" if picture in held_out else "train"), entry)
    mask = str(entry["mask_path"]) if "mask_path" in entry else None
    return Posed(camera, picture, lens, _time(entry), mask, "camera" in entry)


def _camera(name: str, entry: _Entry, split: str) -> Camera:
    """Of the picture as it was taken."""
    to_world = np.asarray(entry.maps[0]["transform_matrix"], np.float64).reshape(4, 4)
    width, height, fx, fy, cx, cy = (float(entry[key]) for key in ("w", "h", "fl_x", "fl_y", "cx", "cy"))
    to_camera = inverse(to_world @ OPENGL_TO_OPENCV)
    split, near = str(entry.get("split", split)), float(entry.get("near", NEAR))
    return Camera(name, int(width), int(height), fx, fy, cx, cy, to_camera, split, near)


def _without_lens(camera: Camera, entry: _Entry) -> tuple[Camera, Lens | None]:
    """The camera of the undistorted picture, and the lens; None for a pinhole camera."""
    model = str(entry.get("camera_model", "OPENCV")).upper()
    if model.startswith(NO_LENS):
        raise ValueError(f"camera {camera.name} has camera_model {model}, which is no perspective")
    if model != FISHEYE and float(entry.get("k4", 0)):
        raise ValueError(f"camera {camera.name} has k4 of {entry['k4']}, which no lens model of OpenCV's has")
    names = ("k1", "k2", "k3", "k4") if model == FISHEYE else ("k1", "k2", "p1", "p2", "k3")
    coefficients = np.array([float(entry.get(name, 0)) for name in names])
    return undistorted(camera, coefficients, fisheye=model == FISHEYE)


def _time(entry: _Entry) -> float:
    return float(entry["time_index"] if "time_index" in entry else entry.get("time", 0))
