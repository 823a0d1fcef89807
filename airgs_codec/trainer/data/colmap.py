"""Readers of scenes whose cameras are a COLMAP reconstruction.

On its own it is sparse/ and videos/CAM.mp4, images/CAM/* or one picture each; its points are in points3D.bin or
points3D.txt. Scenes of HiFi4G and DualGS are image_white_undistortion/FRAME/CAM.png and a reconstruction in
colmap/sparse/0, in the folder of the frames as it is downloaded or moved beside it; its images are named as the
pictures of a frame are. Frames are numbered folders, from any number on. The background is white.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import DEFAULT_FPS
from airgs_codec.scene.cameras import colmap
from airgs_codec.scene.cameras.posed import Posed
from airgs_codec.scene.files import Cursor, expecting
from airgs_codec.scene.formats.table import natural_key
from airgs_codec.trainer.data.multiview import MultiviewScene, Points, Shot, Source
from airgs_codec.trainer.data.videos import CameraFilm, find_pictures, find_videos, scene_from_films


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
    return Shot(replace(image.camera, name=name), Source(folder / "images" / image.picture), image.lens)


def _film(folder: Path, name: str) -> Path | None:
    """A camera's pictures over time: a video, or a folder of more than one picture."""
    for video in (*find_videos(folder / "videos"), *find_videos(folder)):
        if video.stem == name:
            return video
    for place in (folder / "frames" / name, folder / "images" / name):
        if len(find_pictures(place)) > 1:
            return place
    return None


TRACK_BYTES = 8  # for each picture that saw a point


def read_points3d(model: Path) -> Points | None:
    """The cloud of points in the folder of a reconstruction; None where it has no file of them. Raises SceneError."""
    for name, rows in (("points3D.bin", _rows_of_binary), ("points3D.txt", _rows_of_text)):
        path = model / name
        if path.is_file():
            with expecting(path, "points of a COLMAP reconstruction"):
                table = np.array(list(rows(path)), np.float32).reshape(-1, 6)
            return Points(table[:, :3], table[:, 3:] / np.float32(255))
    return None


def _rows_of_binary(path: Path) -> Iterator[tuple[float, ...]]:
    """Position and colour of each point, colours 0..255."""
    cursor = Cursor.open(path)
    for _ in range(*cursor.take("Q")):
        _, x, y, z, red, green, blue, _, track = cursor.take("Q3d3BdQ")
        cursor.skip(TRACK_BYTES * track)
        yield x, y, z, red, green, blue


def _rows_of_text(path: Path) -> Iterator[tuple[float, ...]]:
    with path.open(encoding="utf-8") as file:
        for line in file:
            if line.strip() and not line.startswith("#"):
                x, y, z, red, green, blue = map(float, line.split(maxsplit=7)[1:7])
                yield x, y, z, red, green, blue


WHITE = (1.0, 1.0, 1.0)
PICTURES = "image_white_undistortion"


def has_hifi4g(folder: Path) -> bool:
    """Whether the folder has the undistorted pictures of such a scene, or is the folder of them."""
    return (folder / PICTURES).is_dir() or (folder.name == PICTURES and _hifi4g_model(folder) is not None)


def read_hifi4g(folder: Path) -> MultiviewScene:
    """The scene; cameras are named by their pictures. Raises SceneError."""
    pictures = folder / PICTURES if (folder / PICTURES).is_dir() else folder
    model = _hifi4g_model(folder) or _hifi4g_model(pictures)
    if model is None:
        raise SceneError(f"{folder}: expected colmap/sparse in it or in {PICTURES}/, got none")
    numbered = [path for path in pictures.iterdir() if path.is_dir() and path.name.isdecimal()]
    if not numbered:
        raise SceneError(f"{pictures}: expected numbered folders, one a frame, got none")
    posed = sorted(colmap.read(model), key=lambda image: natural_key(Path(image.picture)))
    frames = tuple(_hifi4g_frame(path, posed) for path in sorted(numbered, key=natural_key))
    return MultiviewScene(folder, DEFAULT_FPS, frames, read_points3d(model), WHITE)


def _hifi4g_model(folder: Path) -> Path | None:
    return colmap.find_model(folder / "colmap") if (folder / "colmap").is_dir() else None


def _hifi4g_frame(folder: Path, posed: list[Posed]) -> tuple[Shot, ...]:
    """The shots of one frame, in the order of the cameras. Raises SceneError where one has no picture."""
    by_stem = {path.stem: path for path in find_pictures(folder)}
    names = [Path(image.picture).stem for image in posed]
    if missing := [name for name in names if name not in by_stem]:
        raise SceneError(f"{folder}: expected pictures of {len(names)} cameras, got none of {', '.join(missing[:8])}")
    return tuple(
        Shot(replace(image.camera, name=name), Source(by_stem[name]), image.lens)
        for image, name in zip(posed, names, strict=True)
    )
