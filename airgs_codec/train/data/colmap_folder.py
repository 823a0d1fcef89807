"""Reader of a COLMAP reconstruction with pictures: sparse/ and videos/CAM.mp4, images/CAM/* or one picture each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.cameras import colmap
from airgs_codec.scene.cameras.posed import Posed
from airgs_codec.scene.sequence_json import DEFAULT_FPS
from airgs_codec.train.data.colmap import read_points3d
from airgs_codec.train.data.multiview import MultiviewScene, PictureFile, Shot
from airgs_codec.train.data.videos import CameraFilm, find_pictures, find_videos, scene_from_films


def has_colmap(folder: Path) -> bool:
    """Whether there is a reconstruction in the folder."""
    return colmap.find_model(folder) is not None


def read_colmap(folder: Path) -> MultiviewScene:
    """The scene of a reconstruction; an image CAM.ext or CAM/any.ext belongs to the camera CAM.

    A camera's pictures over time are a video or a folder; where no camera has any, the scene is one frame of all
    images.

    Raises SceneError.
    """
    model = colmap.find_model(folder)
    if model is None:
        raise SceneError(f"{folder}: expected a COLMAP reconstruction, got none")
    posed, points = colmap.read(model), read_points3d(model)
    shots = _first_shots(folder, posed)
    films = {name: _film(folder, name) for name in shots}
    if not any(films.values()):
        frame = tuple(_shot(folder, image, image.picture) for image in posed)
        return MultiviewScene(folder, DEFAULT_FPS, (frame,), points)
    if missing := [name for name, film in films.items() if film is None]:
        raise SceneError(f"{folder}: expected a video or a folder of frames of {', '.join(missing)}")
    scene = scene_from_films(folder, [CameraFilm(shots[name], film) for name, film in films.items() if film])
    return replace(scene, points=points)


def _first_shots(folder: Path, posed: Sequence[Posed]) -> dict[str, Shot]:
    """The first image of every camera, by the camera's name: cameras stand still."""
    shots: dict[str, Shot] = {}
    for image in posed:
        relative = Path(image.picture)
        name = relative.parent.name or relative.stem
        if name not in shots:
            shots[name] = _shot(folder, image, name)
    return shots


def _shot(folder: Path, image: Posed, name: str) -> Shot:
    return Shot(replace(image.camera, name=name), PictureFile(folder / "images" / image.picture), image.lens)


def _film(folder: Path, name: str) -> Path | None:
    """A camera's pictures over time: a video, or a folder of more than one picture."""
    for video in (*find_videos(folder / "videos"), *find_videos(folder)):
        if video.stem == name:
            return video
    for place in (folder / "frames" / name, folder / "images" / name):
        if len(find_pictures(place)) > 1:
            return place
    return None
