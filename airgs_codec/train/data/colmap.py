"""COLMAP reconstructions, text or binary: cameras, poses and points. The only importer of pycolmap."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.media.image import Lens, fit_lens
from airgs_codec.scene.camera import Camera
from airgs_codec.train.data.multiview import Points

# Where in COLMAP's parameters OpenCV's coefficients are; -1: the coefficient is 0.
_PERSPECTIVE = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": (3, -1, -1, -1),
    "RADIAL": (3, 4, -1, -1),
    "OPENCV": (4, 5, 6, 7),
    "FULL_OPENCV": (4, 5, 6, 7, 8, 9, 10, 11),
}
_FISHEYE = {
    "SIMPLE_RADIAL_FISHEYE": (3, -1, -1, -1),
    "RADIAL_FISHEYE": (3, 4, -1, -1),
    "OPENCV_FISHEYE": (4, 5, 6, 7),
}


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """An image of a reconstruction."""

    name: str  # as COLMAP has it, relative to the image folder
    camera: Camera  # undistorted
    lens: Lens | None


def find_model(folder: Path) -> Path | None:
    """The folder of a reconstruction under `folder`: sparse/0, sparse, or itself."""
    for candidate in (folder / "sparse" / "0", folder / "sparse", folder):
        if any((candidate / f"images.{suffix}").is_file() for suffix in ("bin", "txt")):
            return candidate
    return None


def read_model(folder: Path) -> tuple[list[Posed], Points]:
    """Images in the order of their names, and the points. Raises SceneError, or ConfigError without pycolmap."""
    try:
        import pycolmap
    except ImportError as error:
        raise ConfigError(f"{folder}: reading COLMAP needs pycolmap: pip install 'airgs-codec[train]'") from error
    try:
        model = pycolmap.Reconstruction(str(folder))
    except (ValueError, RuntimeError, OSError, IndexError) as error:
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__
        raise SceneError(f"{folder}: expected a COLMAP reconstruction: {reason}") from error
    posed = [
        _posed(folder, image.name, image.camera, image.cam_from_world().matrix())
        for image in sorted(model.images.values(), key=lambda image: image.name)
        if image.has_pose
    ]
    if not posed:
        raise SceneError(f"{folder}: expected images with poses, got none")
    found = list(model.points3D.values())
    positions = np.array([point.xyz for point in found], np.float32).reshape(-1, 3)
    colours = np.array([point.color for point in found], np.float32).reshape(-1, 3) / np.float32(255)
    return posed, Points(positions, colours)


def _posed(folder: Path, name: str, camera: object, pose: NDArray[np.float64]) -> Posed:
    model = camera.model.name  # type: ignore[attr-defined]  # pycolmap's types are not ours to describe
    size = (int(camera.width), int(camera.height))  # type: ignore[attr-defined]
    params = np.append(np.asarray(camera.params, np.float64), 0.0)  # type: ignore[attr-defined]
    matrix = np.asarray(camera.calibration_matrix(), np.float64)  # type: ignore[attr-defined]
    if model not in _PERSPECTIVE and model not in _FISHEYE:
        raise SceneError(f"{folder}: {name}: expected a perspective or fisheye camera model, got {model}")
    coefficients = params[list(_PERSPECTIVE.get(model, _FISHEYE.get(model, ())))]
    lens = None
    if model in _FISHEYE or coefficients.any():
        lens = fit_lens(size, matrix, coefficients, fisheye=model in _FISHEYE)
        matrix = lens.pinhole
    view = np.eye(4)
    view[:3] = pose
    return Posed(name, Camera(name, *size, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], view), lens)
