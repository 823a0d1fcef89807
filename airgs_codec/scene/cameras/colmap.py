"""COLMAP reconstructions, text or binary: cameras.{bin,txt} and images.{bin,txt} of a sparse/ folder.

Files as COLMAP documents them under "Output Format", camera models as in its sensor/models.h. Poses are world-to-camera
in OpenCV's axes, the centre of the first pixel is at (0.5, 0.5). test.txt lists pictures that are held out, as INRIA's
gaussian-splatting reads it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from airgs_codec.media.image import Lens
from airgs_codec.scene.camera import Camera, rigid
from airgs_codec.scene.cameras.forms import Posed, as_path, undistorted
from airgs_codec.scene.files import Cursor, expecting, require

_RECONSTRUCTION = "a COLMAP reconstruction"
PARTS = tuple(f"{name}.{suffix}" for name in ("cameras", "images", "points3D") for suffix in ("bin", "txt"))
POINT2D_BYTES = 24  # x, y as doubles and the number of a point


class Model(NamedTuple):
    """A camera model: parameters are one or two focal lengths, the principal point and coefficients."""

    name: str
    parameters: int
    focals: int = 0  # 0: a model that is neither perspective nor a plain fisheye
    # Where in the parameters OpenCV's coefficients are; -1: the coefficient is 0.
    coefficients: tuple[int, ...] = ()
    fisheye: bool = False


MODELS = (  # by COLMAP's number
    Model("SIMPLE_PINHOLE", 3, 1),
    Model("PINHOLE", 4, 2),
    Model("SIMPLE_RADIAL", 4, 1, (3, -1, -1, -1)),
    Model("RADIAL", 5, 1, (3, 4, -1, -1)),
    Model("OPENCV", 8, 2, (4, 5, 6, 7)),
    Model("OPENCV_FISHEYE", 8, 2, (4, 5, 6, 7), fisheye=True),
    Model("FULL_OPENCV", 12, 2, (4, 5, 6, 7, 8, 9, 10, 11)),
    Model("FOV", 5),
    Model("SIMPLE_RADIAL_FISHEYE", 4, 1, (3, -1, -1, -1), fisheye=True),
    Model("RADIAL_FISHEYE", 5, 1, (3, 4, -1, -1), fisheye=True),
    Model("THIN_PRISM_FISHEYE", 12),
    Model("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    Model("SIMPLE_DIVISION", 4),
    Model("DIVISION", 5),
    Model("SIMPLE_FISHEYE", 3, 1, (-1, -1, -1, -1), fisheye=True),
    Model("FISHEYE", 4, 2, (-1, -1, -1, -1), fisheye=True),
    Model("EUCM", 6),
    Model("EQUIRECTANGULAR", 2),
)
Sensor = tuple[int, Model, int, int, tuple[float, ...]]  # number, model, width, height, parameters
Image = tuple[str, int, tuple[float, ...]]  # name below the folder of images, sensor; quaternion w, x, y, z and shift


def find_model(folder: Path) -> Path | None:
    """Return the folder of a reconstruction in a folder: sparse/0, sparse, or itself."""
    return next(filter(is_model, (folder / "sparse" / "0", folder / "sparse", folder)), None)


def is_model(folder: Path) -> bool:
    return any((folder / f"images.{suffix}").is_file() for suffix in ("bin", "txt"))


def read(folder: Path) -> list[Posed]:
    """Return one for each image, in the order of their names; cameras are named by images without their endings.

    A distorted camera is that of the undistorted picture. Raises SceneError.
    """
    binary = (folder / "images.bin").is_file() and (folder / "cameras.bin").is_file()
    sensors, images = (folder / f"{name}.{'bin' if binary else 'txt'}" for name in ("cameras", "images"))
    with expecting(sensors, _RECONSTRUCTION):
        found = _sensors_of_binary(sensors) if binary else _sensors_of_text(sensors)
        cameras = {sensor[0]: _at_origin(*sensor) for sensor in found}
    with expecting(images, _RECONSTRUCTION):
        rows = sorted(_images_of_binary(images) if binary else _images_of_text(images), key=lambda image: image[0])
        listed = folder / "test.txt"
        lines = listed.read_text(encoding="utf-8-sig").splitlines() if listed.is_file() else []
        held_out = {as_path(line.strip()) for line in lines}
        posed = [_posed(name, pose, *cameras[sensor], held_out) for name, sensor, pose in rows]
    require(posed, folder, "expected images with poses, got none")
    return posed


def _at_origin(_: int, model: Model, width: int, height: int, given: tuple[float, ...]) -> tuple[Camera, Lens | None]:
    if not model.focals:
        raise ValueError(f"expected a perspective or fisheye camera model, got {model.name}")
    values = np.append(given, 0.0)  # the last is at -1
    fx, fy, cx, cy = map(float, values[[0, model.focals - 1, model.focals, model.focals + 1]])
    camera = Camera(model.name, width, height, fx, fy, cx, cy, np.eye(4))
    return undistorted(camera, values[list(model.coefficients)], model.fisheye)


def _posed(image: str, pose: tuple[float, ...], camera: Camera, lens: Lens | None, held_out: set[str]) -> Posed:
    w, *xyz = pose[:4]
    view = rigid(Rotation.from_quat([*xyz, w]).as_matrix(), pose[4:])  # of any norm but 0: that raises ValueError
    name = Path(image).with_suffix("").as_posix()
    split = "test" if {image, name} & held_out else "train"
    return Posed(replace(camera, name=name, world_to_camera=view, split=split), image, lens)


def _sensors_of_binary(path: Path) -> Iterator[Sensor]:
    cursor = Cursor.open(path)
    for _ in range(*cursor.take("Q")):
        number, model, width, height = cursor.take("IiQQ")
        if not 0 <= model < len(MODELS):
            raise ValueError(f"expected a camera model of 0 to {len(MODELS) - 1}, got {model}")
        yield number, MODELS[model], width, height, cursor.take(f"{MODELS[model].parameters}d")


def _sensors_of_text(path: Path) -> Iterator[Sensor]:
    by_name = {model.name: model for model in MODELS}
    for line in filter(_is_filled, _lines(path)):
        number, name, width, height, *parameters = line.split()
        if name not in by_name or len(parameters) != by_name[name].parameters:
            raise ValueError(f"expected a camera model and its parameters, got {name} with {len(parameters)}")
        yield int(number), by_name[name], int(width), int(height), tuple(map(float, parameters))


def _images_of_binary(path: Path) -> Iterator[Image]:
    cursor = Cursor.open(path)
    for _ in range(*cursor.take("Q")):
        _, *pose, sensor = cursor.take("I7dI")
        name = as_path(cursor.text())
        cursor.skip(POINT2D_BYTES * cursor.take("Q")[0])
        yield name, sensor, tuple(pose)


def _images_of_text(path: Path) -> Iterator[Image]:
    lines = _lines(path)
    for line in filter(_is_filled, lines):
        _, *pose, sensor, name = line.split(maxsplit=9)
        yield as_path(name.strip()), int(sensor), tuple(map(float, pose))
        next(lines, None)  # its points in the picture, which may be an empty line


def _lines(path: Path) -> Iterator[str]:
    with path.open(encoding="utf-8-sig") as file:
        yield from file


def _is_filled(line: str) -> bool:
    return bool(line.strip()) and not line.startswith("#")
