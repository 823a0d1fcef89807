"""Reader of nerfstudio's transforms.json: OpenGL camera-to-world matrices, one entry for each picture.

An entry has `time_index` or `time` in a dynamic scene, `camera` and `split`; its `file_path` may name a video.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.media.image import Lens, fit_lens
from airgs_codec.scene.camera import Camera, camera_from_transforms
from airgs_codec.scene.sequence import DEFAULT_FPS
from airgs_codec.train.data.json_file import read_object
from airgs_codec.train.data.multiview import MultiviewScene, PictureFile, Shot
from airgs_codec.train.data.videos import VIDEO_SUFFIXES, CameraFilm, scene_from_films

NAME = "transforms.json"


def has_transforms(folder: Path) -> bool:
    """Whether the folder has a transforms.json."""
    return (folder / NAME).is_file()


def read_transforms(folder: Path) -> MultiviewScene:
    """The scene of a transforms.json. Frames are the distinct `time_index`, or the distinct `time` without it.

    Raises SceneError.
    """
    path = folder / NAME
    data = read_object(path)
    try:
        entries = data["frames"]
        shots = [_shot(folder, data, entry, number) for number, entry in enumerate(entries)]
        times = [_time(entry) for entry in entries]
        fps = Fraction(str(data.get("fps", DEFAULT_FPS)))
    except (ValueError, KeyError, TypeError, AttributeError, np.linalg.LinAlgError) as error:
        raise SceneError(
            f"{path}: expected a nerfstudio transforms.json, got {type(error).__name__}: {error}"
        ) from error
    if not shots:
        raise SceneError(f"{path}: expected at least one picture under 'frames', got none")
    paths = [folder / str(entry["file_path"]) for entry in entries]
    films = {shot.camera.name: CameraFilm(shot, path) for shot, path in zip(shots, paths, strict=True)}
    if all(film.path.suffix.lower() in VIDEO_SUFFIXES for film in films.values()):
        return scene_from_films(folder, list(films.values()))
    at = list(zip(times, shots, strict=True))
    frames = tuple(tuple(shot for time, shot in at if time == moment) for moment in sorted(set(times)))
    return MultiviewScene(folder, fps, frames)


def _shot(folder: Path, shared: dict[str, Any], entry: dict[str, Any], number: int) -> Shot:
    relative = Path(str(entry["file_path"]))
    name = str(entry.get("camera", relative.parent.name if _time(entry) else relative.stem or f"view{number:03d}"))
    camera = camera_from_transforms(name, shared, entry)
    lens = _lens(camera, {**shared, **entry})
    mask = folder / str(entry["mask_path"]) if "mask_path" in entry else None
    picture = folder / relative
    source = PictureFile(picture if picture.suffix else picture.with_suffix(".png"))
    return Shot(_seen_through(camera, lens), source, lens, mask)


def _lens(camera: Camera, entry: dict[str, Any]) -> Lens | None:
    """The lens of an entry joined with what all share; None for a pinhole camera."""
    size = (camera.width, camera.height)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])

    def coefficients(*names: str) -> np.ndarray:
        return np.array([float(entry.get(name, 0)) for name in names])

    if str(entry.get("camera_model", "OPENCV")) == "OPENCV_FISHEYE":
        return fit_lens(size, matrix, coefficients("k1", "k2", "k3", "k4"), fisheye=True)
    perspective = coefficients("k1", "k2", "p1", "p2", "k3")
    return fit_lens(size, matrix, perspective) if perspective.any() else None


def _seen_through(camera: Camera, lens: Lens | None) -> Camera:
    """The pinhole camera of the undistorted picture."""
    if lens is None:
        return camera
    m = lens.pinhole
    return replace(camera, fx=m[0, 0], fy=m[1, 1], cx=m[0, 2], cy=m[1, 2])


def _time(entry: dict[str, Any]) -> float:
    return float(entry.get("time_index", entry.get("time", 0)))
