"""Multi-view scenes of a transforms.json: an entry for each picture, or for each camera where entries name videos."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from pathlib import Path

from airgs_codec.scene.cameras import transforms
from airgs_codec.scene.cameras.posed import Posed, expecting, read_object
from airgs_codec.scene.sequence import DEFAULT_FPS
from airgs_codec.train.data.multiview import MultiviewScene, PictureFile, Shot, in_frames
from airgs_codec.train.data.videos import VIDEO_SUFFIXES, CameraFilm, scene_from_films


def has_transforms(folder: Path) -> bool:
    """Whether the folder has a transforms.json."""
    return (folder / transforms.NAME).is_file()


def read_transforms(folder: Path) -> MultiviewScene:
    """The scene of a transforms.json. Frames are the distinct `time_index`, or the distinct `time` without it.

    Raises SceneError.
    """
    path = folder / transforms.NAME
    posed = transforms.read(path)
    with expecting(path, "a frame rate"):
        fps = Fraction(str(read_object(path).get("fps", DEFAULT_FPS)))
    films = {p.camera.name: CameraFilm(_shot(folder, p), folder / p.picture) for p in posed}
    if all(film.path.suffix.lower() in VIDEO_SUFFIXES for film in films.values()):
        return scene_from_films(folder, list(films.values()))
    return MultiviewScene(folder, fps, in_frames(posed, partial(_shot, folder)))


def _shot(folder: Path, posed: Posed) -> Shot:
    picture = folder / posed.picture
    source = PictureFile(picture if picture.suffix else picture.with_suffix(".png"))
    return Shot(posed.camera, source, posed.lens, folder / posed.mask if posed.mask else None)
