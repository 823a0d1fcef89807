"""COLMAP reconstructions, text or binary: cameras.{bin,txt} and images.{bin,txt} of a sparse/ folder.

Files as COLMAP documents them under "Output Format", camera models as in its sensor/models.h. Poses are world-to-camera
in OpenCV's axes, the centre of the first pixel is at (0.5, 0.5). test.txt lists pictures that are held out, as INRIA's
gaussian-splatting reads it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from airgs_codec.media.image import Lens
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.cameras.posed import Posed, as_path, expect_any, undistorted
from airgs_codec.scene.files import Cursor, expecting

WORDS = "a COLMAP reconstruction"
TEST_NAME = "test.txt"
PARTS = tuple(f"{name}.{suffix}" for name in ("cameras", "images", "points3D") for suffix in ("bin", "txt"))
POINT2D_BYTES = 24  # x, y as doubles and the number of a point


@dataclass(frozen=True, slots=True)
class _Model:
    """A camera model: parameters are one or two focal lengths, the principal point and coefficients."""

    name: str
    parameters: int
    focals: int = 0  # 0: a model that is neither perspective nor a plain fisheye
    # Where in the parameters OpenCV's coefficients are; -1: the coefficient is 0.
    coefficients: tuple[int, ...] = ()
    fisheye: bool = False


MODELS = (  # by COLMAP's number
    _Model("SIMPLE_PINHOLE", 3, 1),
    _Model("PINHOLE", 4, 2),
    _Model("SIMPLE_RADIAL", 4, 1, (3, -1, -1, -1)),
    _Model("RADIAL", 5, 1, (3, 4, -1, -1)),
    _Model("OPENCV", 8, 2, (4, 5, 6, 7)),
    _Model("OPENCV_FISHEYE", 8, 2, (4, 5, 6, 7), fisheye=True),
    _Model("FULL_OPENCV", 12, 2, (4, 5, 6, 7, 8, 9, 10, 11)),
    _Model("FOV", 5),
    _Model("SIMPLE_RADIAL_FISHEYE", 4, 1, (3, -1, -1, -1), fisheye=True),
    _Model("RADIAL_FISHEYE", 5, 1, (3, 4, -1, -1), fisheye=True),
    _Model("THIN_PRISM_FISHEYE", 12),
    _Model("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    _Model("SIMPLE_DIVISION", 4),
    _Model("DIVISION", 5),
    _Model("SIMPLE_FISHEYE", 3, 1, (-1, -1, -1, -1), fisheye=True),
    _Model("FISHEYE", 4, 2, (-1, -1, -1, -1), fisheye=True),
    _Model("EUCM", 6),
    _Model("EQUIRECTANGULAR", 2),
)


@dataclass(frozen=True, slots=True, eq=False)
class _Sensor:
    model: _Model
    size: tuple[int, int]  # width, height
    parameters: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    name: str  # relative to the folder of images
    sensor: int
    pose: tuple[float, ...]  # a quaternion (w, x, y, z) and a translation


def find_model(folder: Path) -> Path | None:
    """The folder of a reconstruction under `folder`: of those in sparse/0, sparse/1, … the one of most images, or
    sparse, or itself.
    """
    parts = sorted(filter(is_model, (folder / "sparse").glob("[0-9]*")), key=lambda part: (len(part.name), part.name))
    if parts:
        return max(parts, key=_images)  # the first of them where several have as many
    return next(filter(is_model, (folder / "sparse", folder)), None)


def _images(model: Path) -> int:
    """How many images a reconstruction has, 0 where its file is broken, which is told when it is read."""
    binary = model / "images.bin"
    try:
        if binary.is_file():
            return int(Cursor.open(binary).take("Q")[0])
        return len(list(_images_of_text(model)))
    except (OSError, ValueError, LookupError, struct.error):
        return 0


def is_model(folder: Path) -> bool:
    """Return whether a reconstruction lies in this very folder."""
    return any((folder / f"images.{suffix}").is_file() for suffix in ("bin", "txt"))


def is_part(path: Path) -> bool:
    """Return whether a file is one of those that a reconstruction consists of."""
    return path.name in PARTS and is_model(path.parent)


def read(folder: Path) -> list[Posed]:
    """One for each image, in the order of their names; cameras are named by images without their endings.

    A distorted camera is that of the undistorted picture. Raises SceneError.
    """
    binary = (folder / "images.bin").is_file() and (folder / "cameras.bin").is_file()
    suffix = "bin" if binary else "txt"
    with expecting(folder / f"cameras.{suffix}", WORDS):
        sensors = _sensors_of_binary(folder) if binary else _sensors_of_text(folder)
        cameras = {number: _at_origin(sensor) for number, sensor in sensors}
    with expecting(folder / f"images.{suffix}", WORDS):
        images = sorted(_images_of_binary(folder) if binary else _images_of_text(folder), key=lambda image: image.name)
        held_out = _held_out(folder)
        posed = [_posed(image, *cameras[image.sensor], held_out) for image in images]
    return expect_any(posed, folder, "images with poses")


def _at_origin(sensor: _Sensor) -> tuple[Camera, Lens | None]:
    """The camera of undistorted pictures, nowhere yet, and the lens that they are undistorted for."""
    model, values = sensor.model, np.append(sensor.parameters, 0.0)  # the last is at -1
    if not model.focals:
        raise ValueError(f"expected a perspective or fisheye camera model, got {model.name}")
    fx, fy, cx, cy = map(float, values[[0, model.focals - 1, model.focals, model.focals + 1]])
    camera = Camera(model.name, *sensor.size, fx, fy, cx, cy, np.eye(4))
    return undistorted(camera, values[list(model.coefficients)], model.fisheye)


def _posed(image: _Image, camera: Camera, lens: Lens | None, held_out: set[str]) -> Posed:
    w, *xyz = image.pose[:4]
    view = np.eye(4)
    view[:3, :3] = Rotation.from_quat([*xyz, w]).as_matrix()  # of any norm but 0, for which it raises ValueError
    view[:3, 3] = image.pose[4:]
    name = Path(image.name).with_suffix("").as_posix()
    split = "test" if {image.name, name} & held_out else "train"
    return Posed(replace(camera, name=name, world_to_camera=view, split=split), image.name, lens)


def _held_out(folder: Path) -> set[str]:
    path = folder / TEST_NAME
    return (
        {as_path(line.strip()) for line in path.read_text(encoding="utf-8-sig").splitlines()}
        if path.is_file()
        else set()
    )


def _sensors_of_binary(folder: Path) -> Iterator[tuple[int, _Sensor]]:
    cursor = Cursor.open(folder / "cameras.bin")
    for _ in range(*cursor.take("Q")):
        number, model, width, height = cursor.take("IiQQ")
        if not 0 <= model < len(MODELS):
            raise ValueError(f"expected a camera model of 0 to {len(MODELS) - 1}, got {model}")
        yield number, _Sensor(MODELS[model], (width, height), cursor.take(f"{MODELS[model].parameters}d"))


def _sensors_of_text(folder: Path) -> Iterator[tuple[int, _Sensor]]:
    by_name = {model.name: model for model in MODELS}
    for line in _lines(folder / "cameras.txt"):
        if _is_empty(line):
            continue
        number, name, width, height, *parameters = line.split()
        if name not in by_name or len(parameters) != by_name[name].parameters:
            raise ValueError(f"expected a camera model and its parameters, got {name} with {len(parameters)}")
        yield int(number), _Sensor(by_name[name], (int(width), int(height)), tuple(map(float, parameters)))


def _images_of_binary(folder: Path) -> Iterator[_Image]:
    cursor = Cursor.open(folder / "images.bin")
    for _ in range(*cursor.take("Q")):
        _, *pose, sensor = cursor.take("I7dI")
        name = as_path(cursor.text())
        cursor.skip(POINT2D_BYTES * cursor.take("Q")[0])
        yield _Image(name, sensor, tuple(pose))


def _images_of_text(folder: Path) -> Iterator[_Image]:
    lines = _lines(folder / "images.txt")
    for line in lines:
        if _is_empty(line):
            continue
        _, *pose, sensor, name = line.split(maxsplit=9)
        yield _Image(as_path(name.strip()), int(sensor), tuple(map(float, pose)))
        next(lines, None)  # its points in the picture, which may be an empty line


def _lines(path: Path) -> Iterator[str]:
    with path.open(encoding="utf-8-sig") as file:
        yield from file


def _is_empty(line: str) -> bool:
    return not line.strip() or line.startswith("#")
